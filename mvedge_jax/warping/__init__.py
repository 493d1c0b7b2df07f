"""Reprojection between views (Thesis 7.1.4)."""
