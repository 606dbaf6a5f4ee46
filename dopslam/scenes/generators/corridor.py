"""A corridor: long and narrow, cabinets along its walls."""

from __future__ import annotations

import numpy as np

from dopslam.scenes.generators.draft import Generated
from dopslam.scenes.generators.indoor import Style, indoor

OPTIONS = {
    "length": (18.0, 40.0),  # m
    "width": (2.2, 3.8),  # m
    "height": (2.4, 3.2),  # m
    "furniture": (0, 3),
    "objects": (2, 5),  # small: door handles, lamps, extinguishers
}
STYLE = Style(
    furniture=("cabinet", "locker"),
    furniture_height=(0.8, 2.0),
    furniture_half=(0.2, 0.6),
    furniture_material=("wood", "metal"),
    wall=("plasterboard", "concrete", "brick"),
    floor=("concrete", "wood"),
    ceiling=("ceiling_board", "concrete"),
    along=True,
    station_below=(0.2, 0.6),
    clearance=0.7,
    depth_two=0.5,
    points=("handle", "lamp", "extinguisher"),
    speed=(0.6, 1.4),
    turn_rate=(-0.01, 0.01),
)


def corridor(rng: np.random.Generator, carrier: float | None, options: dict) -> Generated:
    """A straight corridor along x."""
    return indoor(rng, carrier, options, STYLE)
