"""Scenes of one's own: drawn by a generator of a kind of place, or raised from a plan, map or picture."""
