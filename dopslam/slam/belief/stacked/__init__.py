"""Paper B's stacked particles, the form that reproduces the paper."""
