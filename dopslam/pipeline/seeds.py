"""Random generators of the stages: results depend on the seed, never on workers, order, or which stages ran together."""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Component(IntEnum):
    """Who draws random numbers; the first part of every spawn key."""

    TRACK = 0
    SCATTER = 1
    NOISE = 2
    DETECTIONS = 3
    HARDWARE = 4


def generator(seed: int, component: Component, step: int = 0) -> np.random.Generator:
    """Random generator of one component and step."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(component), step)))
