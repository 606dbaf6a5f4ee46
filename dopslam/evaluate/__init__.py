"""How good a run is: bounds, errors of tracks and maps, detections against the truth."""
