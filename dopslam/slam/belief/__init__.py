"""Belief-propagation SLAM of paper B: agent, features of several types, and their association."""
