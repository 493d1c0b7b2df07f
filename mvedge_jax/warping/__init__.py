"""Reprojection between views (Thesis 7.1.4)."""

from ._backward import backward_warp as backward_warp
