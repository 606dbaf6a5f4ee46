"""A room: an office, a living room, a laboratory."""

from __future__ import annotations

import numpy as np

from dopslam.scenes.generators.draft import Generated
from dopslam.scenes.generators.indoor import Style, indoor

OPTIONS = {
    "length": (6.0, 13.0),  # m
    "width": (5.0, 10.0),  # m
    "height": (2.5, 3.5),  # m
    "furniture": (1, 5),
    "objects": (2, 5),  # small: lamps, handles, screens
}
STYLE = Style(
    furniture=("table", "shelf", "cabinet"),
    furniture_height=(0.7, 2.0),
    furniture_half=(0.25, 0.8),
    furniture_material=("wood", "metal", "chipboard"),
    wall=("plasterboard", "concrete", "brick"),
    floor=("concrete", "wood"),
    ceiling=("ceiling_board", "concrete", "plasterboard"),
    along=False,
    station_below=(0.2, 0.7),
    clearance=0.8,
    depth_two=0.5,
    points=("lamp", "handle", "screen"),
    speed=(0.4, 1.0),
    turn_rate=(-0.6, 0.6),
)


def room(rng: np.random.Generator, carrier: float | None, options: dict) -> Generated:
    """A rectangular room with some furniture."""
    return indoor(rng, carrier, options, STYLE)
