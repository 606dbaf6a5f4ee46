"""Worlds to draw tracks and detections from."""
