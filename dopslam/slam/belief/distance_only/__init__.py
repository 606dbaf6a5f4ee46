"""Distance-only belief propagation with several anchors, the setting of paper B's reference [1]."""
