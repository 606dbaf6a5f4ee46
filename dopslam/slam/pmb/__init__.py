"""The EK-PMB filters of paper A: density, recursion, smoother and mixture."""
