"""Data association: the γ best (Murty) and marginal probabilities (loopy belief propagation)."""
