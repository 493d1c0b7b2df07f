"""Error measures of disparity maps (Thesis 5.2.3, 6.2.3)."""
