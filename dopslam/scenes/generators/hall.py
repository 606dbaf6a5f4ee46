"""A hall: a factory, a warehouse, a gymnasium."""

from __future__ import annotations

import numpy as np

from dopslam.scenes.generators.draft import Generated
from dopslam.scenes.generators.indoor import Style, indoor

OPTIONS = {
    "length": (24.0, 55.0),  # m
    "width": (14.0, 30.0),  # m
    "height": (5.0, 10.0),  # m
    "furniture": (2, 7),  # machines, racks
    "objects": (3, 7),  # small: lamps, hooks, signs
}
STYLE = Style(
    furniture=("machine", "rack", "crate"),
    furniture_height=(1.0, 3.5),
    furniture_half=(0.5, 2.0),
    furniture_material=("metal", "metal", "wood", "concrete"),
    wall=("concrete", "metal", "brick"),
    floor=("concrete",),
    ceiling=("metal", "concrete"),
    along=False,
    station_below=(1.0, 3.0),
    clearance=1.0,
    depth_two=0.4,
    points=("lamp", "hook", "sign"),
    speed=(0.6, 1.6),
    turn_rate=(-0.25, 0.25),
)


def hall(rng: np.random.Generator, carrier: float | None, options: dict) -> Generated:
    """A rectangular hall with machines."""
    return indoor(rng, carrier, options, STYLE)
