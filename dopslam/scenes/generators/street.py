"""A street between two rows of houses, with gaps where other streets join: a car drives along one of its lanes."""

from __future__ import annotations

import numpy as np

from dopslam.scenes.generators import draw
from dopslam.scenes.generators.draft import Box, Generated, Sheet, free

OPTIONS = {
    "length": (90.0, 160.0),  # m
    "width": (14.0, 26.0),  # m, between the façades
    "house_length": (14.0, 40.0),  # m, along the street
    "height": (6.0, 25.0),  # m, of houses
    "gap": (0.0, 12.0),  # m, between neighbors
    "objects": (4, 8),  # lamps, signs, poles
}
FACADES = ("brick", "concrete", "glass", "marble")


def street(rng: np.random.Generator, carrier: float | None, options: dict) -> Generated:
    """Houses on both sides of the x axis."""
    band = draw.radio(rng, draw.OUTDOOR, carrier)
    length, width = draw.within(rng, options["length"]), draw.within(rng, options["width"])
    houses = [
        house for side, name in ((-1, "south"), (1, "north"))
        for house in _row(rng, side, name, length, width, options, band["carrier_frequency"])
    ]  # fmt: skip
    ground = Sheet("ground", "concrete", (0, 0, 0), (length, 0, 0), (0, length, 0))
    station_array, receiver_array = draw.arrays(rng)
    side = draw.one_of(rng, (-1, 1))
    station, height = _mast(rng, length, width, side, houses), draw.within(rng, (5.0, 11.0))
    ahead = draw.one_of(rng, (-1, 1))
    lane = -ahead * draw.within(rng, (1.5, width / 2 - 4.0))

    def starts(rng):
        along = rng.uniform(0.1, 0.45) * length - length / 2
        return ahead * along, lane + rng.normal(0, 0.2), (0.0 if ahead > 0 else np.pi) + rng.normal(0, 0.01)

    drive = {
        "speed": (5.0, 13.0), "turn_rate": (-0.01, 0.01), "period": 0.2, "steps": (40, 60), "bias": (0.0, 20.0, 60.0),
    }  # fmt: skip
    road = draw.track(
        rng, starts, houses, lambda p: np.all((np.abs(p[:, 1]) < width / 2 - 2) & (np.abs(p[:, 0]) < 0.6 * length)), 2.0,
        drive,
    )  # fmt: skip
    middle = draw.turn(np.array(road["start"]), road["speed"], road["turn_rate"], road["period"], road["steps"])
    middle = middle[len(middle) // 2]

    def place(rng):
        edge = draw.one_of(rng, (-1, 1)) * (width / 2 - rng.uniform(0.6, 2.0))
        return rng.uniform(-0.45, 0.45) * length, edge, rng.uniform(1.5, 6.0)

    count = int(rng.integers(options["objects"][0], options["objects"][1] + 1))
    return Generated(
        (*houses, ground),
        {
            "base_station": {
                "position": [*station, round(height, 2)],
                "yaw_deg": draw.towards(rng, station, middle),
                "array": station_array,
            },
            "receiver": {"height": 1.5, "array": receiver_array},
            "radio": band,
            "track": road,
            "scatter_point": draw.points(rng, count, ("lamp", "sign", "pole"), place, houses, None),
            "trace": {"max_depth": int(rng.choice([1, 2], p=[0.7, 0.3]))},
            "source": {"traced": {"transmit_power_dbm": draw.one_of(rng, (0.0, 10.0, 20.0))}},
        },
    )


def _row(rng, side: int, name: str, length: float, width: float, options: dict, carrier: float) -> list[Box]:
    """Houses of one side, their façades on a common line to within some decimeters and a degree."""
    houses, at = [], -length / 2 - rng.uniform(0, 15)
    while at < length / 2:
        along, deep = draw.within(rng, options["house_length"]), rng.uniform(10.0, 16.0)
        setback = rng.uniform(0.0, 0.8) + np.deg2rad(1.5) * along / 2
        houses.append(
            Box(
                f"house_{name}_{len(houses)}",
                draw.material(rng, FACADES, carrier),
                (at + along / 2, side * (width / 2 + setback + deep / 2)),
                (along / 2, deep / 2),
                float(np.deg2rad(rng.uniform(-1.5, 1.5))),
                draw.within(rng, options["height"]),
            )
        )
        at += along + max(0.6, draw.within(rng, options["gap"]))
    return houses


def _mast(rng, length: float, width: float, side: int, houses) -> tuple[float, float]:
    """Where the base station stands: a lamp post at the kerb."""
    for _ in range(draw.TRIES):
        spot = rng.uniform(-0.3, 0.3) * length, side * (width / 2 - rng.uniform(0.7, 2.0))
        if free(np.array(spot), houses, 0.5):
            break
    return round(spot[0], 2), round(spot[1], 2)
