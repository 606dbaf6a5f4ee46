"""One fitted path where there are two.

Two paths in phase, less than half a resolution cell apart in one mode, leave the curvature of the ambiguity function
when one path is fitted to them: lobes to either side in that mode, alike the path in every other. Each lobe by itself may
stay below the threshold that the pair passes.
"""

from __future__ import annotations

import numpy as np

from ..signal.algebra import gram_diagonal
from ..signal.model import SignalModel
from ..signal.paths import Geometry
from .refine import Linearization, metric

ALIKE = 0.5
"""Least normalized inner product in all modes but one that makes a candidate a side lobe of a path."""
HALF = 0.5
"""Half the distance of the two paths that a pair is started from, in the path's metric."""


def side_lobes(model: SignalModel, found: Geometry, lin: Linearization) -> list[tuple[int, int, int]]:
    """(candidate, path, mode) wherever a candidate differs from a path in one mode only."""
    apart = []
    for mode, other in zip(model.evaluate(found)[0], lin.blocks[0], strict=True):
        own, known = mode[:, 0], other[:, 0]
        norms = np.linalg.norm(own, axis=1)[:, None] * np.linalg.norm(known, axis=1)
        apart.append(np.abs(own.conj() @ known.T) <= ALIKE * norms)
    modes = np.array(apart)
    return [(int(c), int(p), int(np.argmax(modes[:, c, p]))) for c, p in np.argwhere(modes.sum(axis=0) == 1)]


def halves(model: SignalModel, paths: Geometry, path: int, mode: int) -> list[Geometry]:
    """``paths`` with number ``path`` taken in two along each parameter that ``mode`` tells."""
    own = paths.take([path])
    lengths = metric(gram_diagonal(model, model.evaluate(own)), model.active)[0]
    starts = []
    for parameter in model.bands[0].modes[mode].parameters:
        if lengths[parameter, parameter] <= 0:
            continue
        step = np.zeros((1, 6))
        step[0, parameter] = HALF / np.sqrt(lengths[parameter, parameter])
        starts.append(paths.replaced(path, own.moved(step)).joined(own.moved(-step)))
    return starts
