"""Seeded free drives among random landmarks: a receiver that stops, sets out, brakes and steers as it likes.

Cars and walkers. Accelerations and turn rates change at once; nothing of the maneuvers is told to a filter, which knows a
start and that speed and turn rate are unknown. World frame, m, s, rad.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dopslam.models.measurement import BS, SP, VA
from dopslam.models.paths import mirror, spreading_loss

Array = NDArray[np.float64]

TICK = 0.02  # s, of the drive's own integration


@dataclass(frozen=True)
class Kind:
    """What a receiver does, at most and as a rule; spans are uniform.

    Attributes
    ----------
    speed : m/s, span of the largest speed; acceleration : m/s²; turn_rate : rad/s; sideways : m/s², which limits it too
    extent : m, how far about the drive the landmarks lie; base, objects : m, spans of heights
    """

    speed: tuple[float, float]
    acceleration: float
    turn_rate: float
    sideways: float
    extent: float
    base: float
    objects: tuple[float, float]


CAR = Kind((4.0, 14.0), 4.5, 0.6, 3.0, 60.0, 10.0, (0.5, 5.0))
WALKER = Kind((0.8, 1.6), 2.5, 1.2, 10.0, 10.0, 2.5, (0.5, 2.5))
KINDS = {"car": CAR, "walker": WALKER}


def drive(kind: Kind, steps: int, period: float, rng: np.random.Generator) -> Array:
    """Rows (steps + 1, 3) of time [s], x, y [m]: every one to three seconds another speed and another turn."""
    fastest = rng.uniform(*kind.speed)
    sharpest = min(kind.turn_rate, kind.sideways / fastest)
    speed, aim, rate, left = rng.uniform(0.3, 1.0) * fastest, fastest, 0.0, 0.0
    heading, place, rows = rng.uniform(-np.pi, np.pi), np.zeros(2), []
    for tick in range(round(steps * period / TICK) + 1):
        if left <= 0:
            aim = fastest * rng.choice([0.0, 0.0, 0.3, 0.6, 1.0, 1.2])
            rate = sharpest * rng.choice([-1.0, -0.5, 0.0, 0.0, 0.5, 1.0])
            left = rng.uniform(1.0, 3.0)
        if tick % round(period / TICK) == 0:
            rows.append([tick * TICK, *place])
        change = np.clip((aim - speed) / 0.4, -kind.acceleration, kind.acceleration)
        speed = max(0.0, speed + change * TICK)
        heading += rate * min(1.0, speed / (0.3 * fastest)) * TICK
        place = place + speed * TICK * np.array([np.cos(heading), np.sin(heading)])
        left -= TICK
    return np.array(rows)


def surroundings(kind: Kind, places: Array, height: float, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Kinds (L,), positions (L, 3) [m] and reference SNR (L,) [dB] of base station, one to four walls, up to five objects.

    Parameters
    ----------
    places : (K, 2) m, of the drive, which no wall cuts
    height : m, of the receiver
    """
    middle = places.mean(axis=0)
    bs = np.array([*(middle + rng.uniform(-0.5, 0.5, 2) * kind.extent), kind.base])
    walls, objects = int(rng.integers(1, 5)), int(rng.integers(0, 6))
    position: list = [bs]
    for _ in range(walls):
        angle = rng.uniform(-np.pi, np.pi)
        normal = np.array([np.cos(angle), np.sin(angle), 0.0])
        beyond = max((places @ normal[:2]).max(), bs @ normal) + rng.uniform(2.0, 0.5 * kind.extent)
        position.append(mirror(bs, normal, beyond))
    for _ in range(objects):
        position.append(np.array([*(middle + rng.uniform(-1, 1, 2) * kind.extent), rng.uniform(*kind.objects)]))
    what = np.array([BS] + walls * [VA] + objects * [SP])
    strength = np.where(what == BS, 45.0, np.where(what == VA, 38.0, 30.0)) + rng.uniform(-6, 6, len(what))
    where, ue = np.array(position), np.array([*middle, height])
    return what, where, strength + 10 * np.log10(spreading_loss(what, where, ue, bs))
