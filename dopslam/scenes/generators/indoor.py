"""What rooms, corridors and halls share: four walls, things that stand in them, a person or robot that walks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dopslam.scenes.generators import draw
from dopslam.scenes.generators.draft import Box, Generated, free, walls


@dataclass(frozen=True)
class Style:
    """How a kind of indoor space differs from the others.

    Attributes
    ----------
    furniture, furniture_height, furniture_half : names; m; m, half the edges
    furniture_material, wall, floor, ceiling : ITU types to choose from
    along : whether things stand along the walls only
    station_below : range below the ceiling [m]
    clearance : m, of the walk from walls and furniture
    depth_two : probability of two reflections
    points : names of small objects
    speed, turn_rate : ranges [m/s], [rad/s]
    """

    furniture: tuple[str, ...]
    furniture_height: draw.Range
    furniture_half: draw.Range
    furniture_material: tuple[str, ...]
    wall: tuple[str, ...]
    floor: tuple[str, ...]
    ceiling: tuple[str, ...]
    along: bool
    station_below: draw.Range
    clearance: float
    depth_two: float
    points: tuple[str, ...]
    speed: draw.Range
    turn_rate: draw.Range


def indoor(rng: np.random.Generator, carrier: float | None, options: dict, style: Style) -> Generated:
    """A rectangular space with a corner at the origin."""
    band = draw.radio(rng, draw.INDOOR, carrier)
    frequency = band["carrier_frequency"]
    length, width, height = (draw.within(rng, options[name]) for name in ("length", "width", "height"))
    materials = {name: draw.material(rng, getattr(style, name), frequency) for name in ("wall", "floor", "ceiling")}
    shell = walls((0.0, length), (0.0, width), height, materials)
    things = _things(rng, length, width, height, options, style, frequency)
    station_array, receiver_array = draw.arrays(rng)
    station = _station(rng, length, width, things)

    def starts(rng):
        return rng.uniform(0.08, 0.92) * length, rng.uniform(0.1, 0.9) * width, _heading(rng, length, width)

    def inside(places):
        room = np.minimum(np.array([length, width]) - places, places)
        return room.min() >= style.clearance and np.hypot(*(places - station).T).min() > 0.8

    drive = {
        "speed": style.speed, "turn_rate": style.turn_rate, "period": 0.2, "steps": (40, 60), "bias": (0.0, 10.0, 30.0),
    }  # fmt: skip
    walk: dict[str, Any] = draw.track(rng, starts, things, inside, style.clearance, drive) | {
        "start_std": [0.1, 0.1, 0.0052, 0.3]
    }
    way = draw.turn(np.array(walk["start"]), walk["speed"], walk["turn_rate"], walk["period"], walk["steps"])

    def place(rng):
        return rng.uniform(0.3, length - 0.3), rng.uniform(0.3, width - 0.3), rng.uniform(0.5, min(height, 4.0) - 0.3)

    count = int(rng.integers(options["objects"][0], options["objects"][1] + 1))
    top = height - draw.within(rng, style.station_below)
    return Generated(
        (*shell, *things),
        {
            "base_station": {
                "position": [*station, round(max(top, 1.9), 2)],
                "yaw_deg": draw.towards(rng, station, way[len(way) // 2]),
                "array": station_array,
            },
            "receiver": {"height": round(float(rng.uniform(1.2, 1.6)), 2), "array": receiver_array},
            "radio": band,
            "track": walk,
            "scatter_point": draw.points(rng, count, style.points, place, things, 1.0),
            "trace": {"max_depth": int(1 + (rng.uniform() < style.depth_two))},
            "source": {"traced": {"transmit_power_dbm": draw.one_of(rng, (-10.0, 0.0, 10.0))}},
        },
    )


def _heading(rng, length: float, width: float) -> float:
    """Any direction in a room; along it in a corridor."""
    if length > 4 * width:
        return float(draw.one_of(rng, (0.0, np.pi)) + rng.normal(0, 0.03))
    return float(rng.uniform(-np.pi, np.pi))


def _station(rng, length: float, width: float, things) -> list[float]:
    """On a wall or near a corner, some decimeters away from it."""
    for _ in range(draw.TRIES):
        edge = rng.uniform(0.2, 0.6)
        end = draw.one_of(rng, (edge, length - edge))
        spot = (
            [end, rng.uniform(0.25, 0.75) * width]
            if rng.uniform() < 0.6
            else [end, draw.one_of(rng, (edge, width - edge))]
        )
        if free(np.array(spot), things, 0.2):
            break
    return [round(float(v), 2) for v in spot]


def _things(rng, length, width, height, options, style: Style, carrier: float) -> list[Box]:
    """Furniture: along the walls with a hand's breadth behind it, or anywhere, none meeting another."""
    boxes: list[Box] = []
    for number in range(int(rng.integers(options["furniture"][0], options["furniture"][1] + 1))):
        for _ in range(50):
            half = rng.uniform(*style.furniture_half, 2)
            yaw = 0.0
            if style.along:
                half[1] = min(half[1], 0.35)
                side = half[1] + rng.uniform(0.03, 0.15)
                spot = rng.uniform(half[0] + 0.1, length - half[0] - 0.1), draw.one_of(rng, (side, width - side))
            else:
                yaw = float(draw.one_of(rng, (0.0, 0.0, np.pi / 2, rng.uniform(0, np.pi))))
                reach = float(np.hypot(*half)) + 0.1
                if 2 * reach > min(length, width):
                    continue
                spot = rng.uniform(reach, length - reach), rng.uniform(reach, width - reach)
            tall = min(draw.within(rng, style.furniture_height), height - 0.3)
            wood = draw.material(rng, style.furniture_material, carrier)
            box = Box(f"{draw.one_of(rng, style.furniture)}_{number}", wood, spot, tuple(half), yaw, tall)
            apart = all(other.clearance(np.array([spot]))[0] > np.hypot(*half) + 0.1 for other in boxes)
            if apart:
                boxes.append(box)
                break
    return boxes
