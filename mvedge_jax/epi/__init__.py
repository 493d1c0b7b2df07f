"""Multi-view edges from epipolar-plane images (Thesis 4.1)."""
