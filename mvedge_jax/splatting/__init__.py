"""Differentiable splatting of points into label and weight maps (Thesis 7.1.2, 7.1.3)."""
