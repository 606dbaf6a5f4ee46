"""Whole-run smoothing: track, clock and map by robust sparse least squares over all detections of a run."""
