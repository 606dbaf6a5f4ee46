"""Laps round a block among many small objects, each seen only from near by: what a map that remembers must stand.

A base station on the roof, four far walls, and objects on both sides of the street. World frame, m, s, rad.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dopslam.models.measurement import BS, SP, VA
from dopslam.models.motion import CoordinatedTurn
from dopslam.models.scans import Scans
from dopslam.records import edges_of
from dopslam.simulate.world import FixedNoise, Situation

Array = NDArray[np.float64]

PERIOD, SPEED, HEIGHT = 0.2, 5.0, 1.5  # s, m/s, m
SIDE, CORNER = 80.0, 10.0  # m, of the block and of the turn about its corners
SEEN = 30.0  # m, from which an object is seen
STD = np.array([0.05, 0.01, 0.01, 0.01, 0.01, 0.1])  # m, rad ×4, m/s
COARSE = np.array([0.5, 0.02, 0.02, 0.2, 0.2, 0.1])  # likewise, of a loop that has to be closed
WALKS = np.array([0.05, 0.05, 0.01, 0.02, 0.3, 0.15])  # of x, y, heading, bias, speed, turn rate a step
START = np.array([0.1, 0.1, 0.005, 0.1, 0.3, 0.1])
STATION = np.array([0.0, 0.0, 30.0])
WALLS = np.array([[260.0, 0, 30], [-300, 0, 30], [0, 240, 30], [0, -280, 30]])  # as virtual anchors


def lap(along: NDArray[Any]) -> Array:
    """Rows (K, 4) of x, y, heading and turn rate at ways (K,) [m] along a square with round corners, from a corner on."""
    quarter = SIDE + 0.5 * np.pi * CORNER
    side, rest = np.divmod(along, quarter)
    straight, turned = np.minimum(rest, SIDE), np.maximum(rest - SIDE, 0.0) / CORNER
    x = straight - 0.5 * SIDE + CORNER * np.sin(turned)
    y = -0.5 * SIDE - CORNER * np.cos(turned)
    angle = 0.5 * np.pi * side
    cos, sin = np.cos(angle), np.sin(angle)
    heading = np.angle(np.exp(1j * (turned + angle)))
    rate = np.where(rest > SIDE, SPEED / CORNER, 0.0)
    return np.column_stack([cos * x - sin * y, sin * x + cos * y, heading, rate])


def block(steps: int, objects: int, rng: np.random.Generator) -> tuple[Situation, Array]:
    """The world and the true states (steps, 6), whose clock walks.

    Parameters
    ----------
    objects : scatter points, 3 to 25 m aside of the way
    """
    way = lap(SPEED * PERIOD * np.arange(1, steps + 1))
    bias = 10.0 + np.cumsum(0.02 * rng.standard_normal(steps))
    states = np.column_stack([way[:, :3], bias, np.full(steps, SPEED), way[:, 3]])
    street, points = lap(np.linspace(0, 4 * SIDE + 2 * np.pi * CORNER, 400))[:, :2], []
    while len(points) < objects:
        spot = rng.uniform(-90.0, 90.0, 2)
        if 3.0 < np.hypot(*(street - spot).T).min() < 25.0:
            points.append([*spot, rng.uniform(0.5, 6.0)])
    world = Situation(
        bs=STATION,
        kind=np.array([BS] + len(WALLS) * [VA] + objects * [SP], np.int64),
        position=np.vstack([STATION, WALLS, np.array(points).reshape(-1, 3)]),
        motion=CoordinatedTurn(PERIOD, np.diag(WALKS**2)),
        prior_mean=np.array([*lap(np.zeros(1))[0, :3], 10.0, SPEED, 0.0]),
        prior_covariance=np.diag(START**2),
        steps=steps,
        noise=FixedNoise(STD, 0.9, SEEN),
        clutter_count=0.5,
        doppler_limit=1.6 * SPEED,
        height=HEIGHT,
    )
    return world, states


def coarse(world: Situation) -> Situation:
    """The objects alone, as a receiver without the base station's bandwidth and array sees them: the track drifts between
    objects that are seen again only a lap later."""
    kept = (world.kind == BS) | (world.kind == SP)
    noise = FixedNoise(COARSE, 0.9, SEEN)
    return replace(world, kind=world.kind[kept], position=world.position[kept], noise=noise)


def unsighted(scans: Scans) -> Scans:
    """The scans of a receiver that never sees the base station itself."""
    assert scans.label is not None
    kept = scans.label != 0
    rows = {name: getattr(scans, name)[kept] for name in ("z", "covariance", "anchor", "label")}
    return replace(scans, **rows, offsets=edges_of(np.bincount(scans.step_of_row[kept], minlength=scans.steps)))
