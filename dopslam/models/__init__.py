"""What moves, what is measured and when it is detected: models shared by filters, bounds and simulation."""
