"""Belief propagation that keeps the correlation between agent and features."""
