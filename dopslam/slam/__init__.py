"""From detections to a map: EK-PMB filters and belief propagation."""
