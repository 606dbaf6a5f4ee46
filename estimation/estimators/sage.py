"""SAGE: space-alternating generalized expectation maximization, the estimator paper B refers to.

Started by successive interference cancellation with the same coarse search, threshold and elimination as
:class:`~estimation.Nomp`; only the refinement differs. One cycle visits the paths in turn: the E-step gives a
path what the others leave of the data, the M-step maximizes its likelihood coordinate by coordinate (delay,
AOA, AOD, speed). It reaches the bound for separated paths, and needs ten times the cycles of a joint fit at
half a bin and a hundred times below: kept as the reference, not the default.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..signal.algebra import gram, gram_diagonal
from ..signal.paths import Geometry
from .noise import Noise
from .nomp import Nomp
from .projector import Projector
from .refine import LARGEST_STEP, Linearization, bounded, linearize, metric

COORDINATES = ((0,), (1, 2), (3, 4), (5,))


@dataclass(frozen=True, eq=False)
class Sage(Nomp):
    """SAGE with the parameters of :class:`~estimation.Nomp`, and at most ``cycles`` of refinement after each
    new path. What an unfinished cycle leaves beside a path is no reason to look for another: ``resolve`` is off.
    """

    resolve: bool = False
    cycles: int = 20

    def _fit(
        self, data: Projector, start: Geometry | Linearization, noise: Noise, tolerance: float = 0.5
    ) -> Linearization:
        lin = start if isinstance(start, Linearization) else linearize(data, start)
        for _ in range(self.cycles):
            before = lin.explained
            geometry, gain = lin.geometry, lin.gain.copy()
            for path in range(len(gain)):
                geometry = self._maximize(data, geometry, gain, path)
            trial = linearize(data, geometry)
            if trial.explained > before:
                lin = trial
            if trial.explained - before < max(tolerance * noise.variance(lin), 1e-7 * before):
                break
        return lin

    def _maximize(self, data: Projector, geometry: Geometry, gain, path: int) -> Geometry:
        """One M-step: a Newton step in each coordinate of ``path`` in turn; ``gain`` (P,) is updated in
        place.
        """
        model = data.model
        others = np.delete(np.arange(len(gain)), path)
        rest = model.evaluate(geometry.take(others)) if len(others) else None
        for coordinate in COORDINATES:
            active = np.zeros(6, bool)
            active[list(coordinate)] = model.active[list(coordinate)]
            if not active.any():
                continue
            own = geometry.take([path])
            blocks = model.evaluate(own)
            inner = data.inner(own, blocks)
            if rest is not None:
                inner = inner - gram(model, blocks, rest, plain=True)[..., 0] @ gain[others]
            matrix = gram_diagonal(model, blocks)
            if matrix[0, 0, 0].real <= 0:  # where the element pattern vanishes there is nothing to maximize
                gain[path] = 0.0
                break
            gain[path] = inner[0, 0] / matrix[0, 0, 0].real
            slope = np.real(np.conj(gain[path]) * (inner - matrix[:, :, 0] * gain[path])[:, 1:]) * active
            curvature = metric(matrix, active) * np.abs(gain[path]) ** 2 * matrix[0, 0, 0].real
            step = np.linalg.pinv(curvature[0], rcond=1e-9, hermitian=True) @ slope[0]
            step = bounded(step[None], metric(matrix, model.active), LARGEST_STEP)
            moved = own.moved(step)
            geometry = geometry.replaced(path, moved)
        return geometry
