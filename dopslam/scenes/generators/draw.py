"""What every kind of scene draws alike: materials that exist at the carrier, radio, arrays, tracks, small objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dopslam.scenes.generators.draft import Box, free

Range = tuple[float, float]
HIGHEST_GHZ = {"brick": 40.0, "plywood": 40.0, "marble": 60.0}  # ITU-R P.2040; the other materials used here: 100
TRIES = 500  # of a place or a track before a layout counts as too crowded


class NoRoom(Exception):
    """Nothing was drawn that a drive fits into."""


@dataclass(frozen=True)
class Band:
    """A carrier [Hz] with a bandwidth [Hz] that is usual there."""

    carrier: float
    bandwidth: float


OUTDOOR = (Band(3.5e9, 100e6), Band(6.7e9, 200e6), Band(28e9, 200e6), Band(28e9, 400e6), Band(39e9, 400e6))
INDOOR = (Band(3.5e9, 100e6), Band(6.7e9, 400e6), Band(28e9, 400e6), Band(39e9, 400e6), Band(60e9, 800e6))


def one_of(rng: np.random.Generator, choices: Sequence):
    """One of them, all equally likely."""
    return choices[int(rng.integers(len(choices)))]


def within(rng: np.random.Generator, span: Range) -> float:
    """Uniform between the two."""
    return float(rng.uniform(*span))


def material(rng: np.random.Generator, choices: Sequence[str], carrier: float) -> str:
    """One of the materials that are defined at the carrier [Hz]."""
    return one_of(rng, [m for m in choices if carrier / 1e9 <= HIGHEST_GHZ.get(m, 100.0)] or ["concrete"])


def radio(rng: np.random.Generator, bands: Sequence[Band], carrier: float | None) -> dict:
    """``[radio]``: one of the bands, or the one whose carrier is nearest to the one asked for [Hz]."""
    band = one_of(rng, bands)
    if carrier is not None:
        band = min(bands, key=lambda b: abs(np.log(b.carrier / carrier)))
    return {"carrier_frequency": carrier or band.carrier, "bandwidth": band.bandwidth}


def arrays(rng: np.random.Generator) -> tuple[dict, dict]:
    """Arrays of base station and receiver: panels or cylinders."""
    station = one_of(rng, (
        {"kind": "planar", "columns": 8, "rows": 8},
        {"kind": "planar", "columns": 8, "rows": 4},
        {"kind": "cylinder", "columns": 16, "rings": 2},
    ))  # fmt: skip
    receiver = one_of(rng, (
        {"kind": "cylinder", "columns": 8, "rings": 4},
        {"kind": "cylinder", "columns": 8, "rings": 2},
        {"kind": "planar", "columns": 4, "rows": 4},
    ))  # fmt: skip
    return dict(station), dict(receiver)


def turn(start: np.ndarray, speed: float, rate: float, period: float, steps: int) -> np.ndarray:
    """Places (4·steps + 1, 2) [m] along a drive of constant speed [m/s] and turn rate [rad/s], four to a period."""
    time = period * np.arange(4 * steps + 1) / 4
    chord, course = speed * time * np.sinc(rate * time / (2 * np.pi)), start[2] + 0.5 * rate * time
    return start[:2] + np.column_stack([chord * np.cos(course), chord * np.sin(course)])


def track(rng: np.random.Generator, starts, boxes: Sequence[Box], inside, clearance: float, drive: dict) -> dict:
    """``[track]``: a drive that keeps its distance from every box and stays where it may be.

    Parameters
    ----------
    starts : rng → (3,) x, y [m] and heading [rad] of a try
    inside : places (N, 2) → whether a drive may go there
    clearance : m
    drive : ranges of ``speed`` [m/s] and ``turn_rate`` [rad/s], ``period`` [s], ``steps`` (range), ``bias`` [m]
    """
    for _ in range(TRIES):
        start, speed = np.asarray(starts(rng)), within(rng, drive["speed"])
        rate, steps = within(rng, drive["turn_rate"]), int(rng.integers(drive["steps"][0], drive["steps"][1] + 1))
        places = turn(start, speed, rate, drive["period"], steps)
        if inside(places) and free(places, boxes, clearance):
            return {
                "speed": round(speed, 3),
                "turn_rate": round(rate, 4),
                "period": drive["period"],
                "steps": steps,
                "start": [*(round(float(v), 4) for v in start), float(one_of(rng, drive["bias"]))],
            }
    raise NoRoom


def points(rng: np.random.Generator, count: int, names: Sequence[str], place, boxes, rcs: float | None) -> list[dict]:
    """``[[scatter_point]]``: small objects clear of every box; ``place``: rng → (3,) m."""
    made = []
    for _ in range(count * TRIES):
        if len(made) == count:
            break
        spot = np.asarray(place(rng))
        if free(spot[:2], boxes, 0.25):
            entry = {"name": f"{one_of(rng, names)}_{len(made)}", "position": [round(float(v), 3) for v in spot]}
            made.append(entry | ({} if rcs is None else {"rcs": rcs}))
    return made


def towards(rng: np.random.Generator, here, there, spread_deg: float = 15.0) -> float:
    """Yaw [°] of a panel at ``here`` (2,) that looks at ``there`` (2,), as exactly as people mount panels."""
    x, y = np.asarray(there)[:2] - np.asarray(here)[:2]
    return round(float(np.degrees(np.arctan2(y, x)) + rng.uniform(-spread_deg, spread_deg)), 1)
