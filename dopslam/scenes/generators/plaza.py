"""An open square with buildings around it, perhaps a kiosk in the middle: a car or bicycle drives a bend across it."""

from __future__ import annotations

import numpy as np

from dopslam.scenes.generators import draw
from dopslam.scenes.generators.draft import Box, Generated, Sheet, free

OPTIONS = {
    "radius": (28.0, 48.0),  # m, of the open space
    "buildings": (4, 7),
    "height": (7.0, 28.0),  # m, of buildings
    "kiosks": (0, 2),
    "objects": (4, 8),  # lamps, signs, trees' trunks
}
FACADES = ("brick", "concrete", "glass", "marble")


def plaza(rng: np.random.Generator, carrier: float | None, options: dict) -> Generated:
    """Buildings around the origin, each facing it to within some degrees."""
    band = draw.radio(rng, draw.OUTDOOR, carrier)
    radius = draw.within(rng, options["radius"])
    count = int(rng.integers(options["buildings"][0], options["buildings"][1] + 1))
    boxes = _around(rng, radius, count, options, band["carrier_frequency"])
    for number in range(int(rng.integers(options["kiosks"][0], options["kiosks"][1] + 1))):
        spot = radius * rng.uniform(0.15, 0.6) * _direction(rng.uniform(-np.pi, np.pi))
        size, yaw = tuple(rng.uniform(1.0, 2.5, 2)), float(rng.uniform(-np.pi, np.pi))
        wood = draw.material(rng, ("wood", "metal", "glass"), band["carrier_frequency"])
        boxes.append(Box(f"kiosk_{number}", wood, tuple(spot), size, yaw, float(rng.uniform(2.5, 4.0))))
    ground = Sheet("ground", "concrete", (0, 0, 0), (3 * radius, 0, 0), (0, 3 * radius, 0))
    station_array, receiver_array = draw.arrays(rng)
    for _ in range(draw.TRIES):
        station = radius * rng.uniform(0.5, 0.95) * _direction(rng.uniform(-np.pi, np.pi))
        if free(station, boxes, 0.5):
            break
    station = [round(float(v), 2) for v in station]

    def starts(rng):
        azimuth = rng.uniform(-np.pi, np.pi)
        return *(radius * rng.uniform(0.3, 0.8) * _direction(azimuth)), azimuth + np.pi + rng.uniform(-0.9, 0.9)

    drive = {
        "speed": (3.0, 8.0), "turn_rate": (-0.2, 0.2), "period": 0.2, "steps": (40, 60), "bias": (0.0, 20.0, 60.0),
    }  # fmt: skip
    road = draw.track(rng, starts, boxes, lambda p: np.hypot(*p.T).max() < 0.95 * radius, 2.0, drive)
    way = draw.turn(np.array(road["start"]), road["speed"], road["turn_rate"], road["period"], road["steps"])

    def place(rng):
        return *(radius * rng.uniform(0.3, 0.95) * _direction(rng.uniform(-np.pi, np.pi))), rng.uniform(1.5, 6.0)

    points = int(rng.integers(options["objects"][0], options["objects"][1] + 1))
    return Generated(
        (*boxes, ground),
        {
            "base_station": {
                "position": [*station, round(float(rng.uniform(5, 12)), 2)],
                "yaw_deg": draw.towards(rng, station, way[len(way) // 2]),
                "array": station_array,
            },
            "receiver": {"height": 1.5, "array": receiver_array},
            "radio": band,
            "track": road,
            "scatter_point": draw.points(rng, points, ("lamp", "sign", "pole"), place, boxes, None),
            "trace": {"max_depth": int(rng.choice([1, 2], p=[0.7, 0.3]))},
            "source": {"traced": {"transmit_power_dbm": draw.one_of(rng, (0.0, 10.0, 20.0))}},
        },
    )


def _direction(azimuth: float) -> np.ndarray:
    return np.array([np.cos(azimuth), np.sin(azimuth)])


def _around(rng, radius: float, count: int, options: dict, carrier: float) -> list[Box]:
    """Buildings at even azimuths, shaken, narrow enough not to meet."""
    boxes, turn = [], rng.uniform(-np.pi, np.pi)
    for number in range(count):
        azimuth = turn + 2 * np.pi * (number + rng.uniform(-0.15, 0.15)) / count
        deep, out = rng.uniform(8.0, 16.0), radius * rng.uniform(1.0, 1.25)
        half = out * np.tan(np.pi / count * rng.uniform(0.45, 0.7))
        facing = azimuth + np.deg2rad(rng.uniform(-8, 8))
        center = tuple((out + deep / 2 + half * np.sin(np.deg2rad(8))) * _direction(azimuth))
        height = draw.within(rng, options["height"])
        wall = draw.material(rng, FACADES, carrier)
        boxes.append(Box(f"building_{number}", wall, center, (deep / 2, half), float(facing), height))
    return boxes
