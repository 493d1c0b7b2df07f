"""Surface vectors and depth-edge confidence (Thesis 4.2.2, 4.3)."""
