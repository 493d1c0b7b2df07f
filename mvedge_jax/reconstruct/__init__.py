"""Dense depth from multi-view edges (Thesis 6 and 7)."""
