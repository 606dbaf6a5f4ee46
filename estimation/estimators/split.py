"""One fitted path where there are two.

Two paths in phase, less than half a resolution cell apart in one mode, leave the curvature of the ambiguity function
when one path is fitted to them: lobes to either side in that mode, alike the path in every other. Each lobe by itself may
stay below the threshold that the pair passes.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ..signal.algebra import gram_diagonal
from ..signal.model import SignalModel
from ..signal.paths import Geometry
from .floor import LARGEST, Floor
from .noise import Noise
from .projector import Projector
from .refine import Linearization, metric

SIDE_LOBE = 0.5
"""Candidates above this share of the threshold may be what one path leaves of two."""

ALIKE = 0.5
"""Least normalized inner product in all modes but one that makes a candidate a side lobe of a path."""
HALF = 0.5
"""Half the distance of the two paths that a pair is started from, in the path's metric."""


class Fitter(Protocol):
    """What :class:`~estimation.Nomp` does to fits."""

    @property
    def level(self) -> float: ...
    @property
    def volume(self) -> float: ...
    @property
    def parameters(self) -> int: ...
    @property
    def error_share(self) -> float: ...

    def _fit(
        self, data: Projector, start: Geometry | Linearization, noise: Noise, tolerance: float = ...
    ) -> Linearization: ...
    def _eliminated(self, data: Projector, lin: Linearization | None, noise: Noise) -> Linearization | None: ...
    def _better(self, grown: Linearization | None, lin: Linearization | None, noise: Noise) -> bool: ...


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


def split(estimator: Fitter, data: Projector, lin: Linearization, found: Geometry, statistic, noise: Noise):
    """The paths with one of them in two, if that explains its side lobes: candidates, or paths that took their
    place; None otherwise.
    """
    near = found.take(np.flatnonzero(statistic > SIDE_LOBE * estimator.level))
    if not len(near):
        return None
    # Several candidates may be lobes of one path in one mode.
    once = dict.fromkeys((path, mode) for _, path, mode in side_lobes(data.model, near, lin))
    lobes = [(lin.geometry, path, mode, path) for path, mode in once]
    if statistic[0] > estimator.level:
        # Something is left that no further path explains.
        for other, path, mode in side_lobes(data.model, lin.geometry, lin):
            rest = lin.geometry.take(np.arange(len(lin.gain)) != other)
            lobes.append((rest, path - (other < path), mode, path))
    variance = noise.variance(lin)
    for paths, path, mode, whole in lobes:
        for start in halves(data.model, paths, path, mode):
            grown = estimator._eliminated(data, estimator._fit(data, start, noise), noise)
            if grown is None or not estimator._better(grown, lin, noise):
                continue
            gained = (grown.explained - lin.explained) / variance
            strength = lin.drop[whole] / variance
            # Two paths explain a wrong model better, too: by little of the path's own energy, and much is left.
            given = estimator.error_share * strength
            if gained > LARGEST * strength:
                return grown
            if gained > given + estimator.level * Floor(data, grown, variance).about(lin.geometry.take([whole])):
                return grown
    return None
