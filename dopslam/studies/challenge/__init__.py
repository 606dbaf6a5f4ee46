"""A frozen suite of detections on which any method is scored: made here, answered anywhere, judged here."""
