"""Where a receiver is from one scan and nothing else: candidates, robust refinement, several modes, and their chain."""
