"""The Poisson system that turns sparse labels into dense maps (Thesis 4.2.2, 6.1, 7.1.1)."""
