"""What a converged fit leaves about its paths: merged pairs, and models that are not quite right.

Two paths closer than the link resolves are fitted by one, at the real part of their centroid ``c = sum_i g_i delta_i /
sum_i g_i`` (delta: distances, in the six parameters). The imaginary part of c no path can take up: it stays in the
residual along ``j g d_a s``, where a right model leaves noise. Its energy is a chi-square test, and its size and direction
are those of the error that the real part makes of either path's position, since the phase between the paths is random.
So are what errors of the model leave (an element's gain, phase noise over the symbols).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from ..signal.directions import Float
from .refine import Linearization, tangent_gram

RATE = 0.004
"""Probability that noise alone makes a path look merged."""
SPREAD = 4.0
"""Squared real over squared imaginary part of the centroid, where the imaginary part is seen. Its mean is infinite (the
angle is uniform), this covers two thirds of the angles by one deviation."""


@dataclass(frozen=True, eq=False)
class Misfit:
    """Structure in the residual about each path.

    Attributes
    ----------
    statistic : (P,) chi-square statistic of the part out of phase with the path
    level : above which a path counts as merged
    shift : (P, 6) imaginary part of the centroid on the tangents, less what noise has in it; 0 where it is noise
    """

    statistic: Float
    level: float
    shift: Float

    @property
    def merged(self) -> np.ndarray:
        """(P,) paths that are not one path."""
        return self.statistic > self.level

    def inflated(self, tangent: Float) -> Float:
        """Covariances (P, 6, 6) on the tangents with those of merged paths grown: along the shift by its size, and in all
        directions by what noise may have turned it.
        """
        grown = (1 + SPREAD) * tangent + SPREAD * self.shift[:, :, None] * self.shift[:, None]
        return np.where(self.merged[:, None, None], grown, tangent)


def misfit(lin: Linearization, noise_variance: float, active) -> Misfit:
    """Test of the residual about each path of a converged fit."""
    paths, active = len(lin.gain), np.asarray(active, bool)
    size = int(active.sum())
    statistic, shift = np.zeros(paths), np.zeros((paths, 6))
    if not size:
        return Misfit(statistic, np.inf, shift)
    idle = np.tile(~active, paths)
    gram = tangent_gram(lin)
    gram[idle], gram[:, idle] = 0.0, 0.0
    diagonal = np.real(np.diag(gram))
    scale = np.where(diagonal > 0, 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 0.0)
    gram *= np.outer(scale, scale)
    # What the paths' own moves take of the directions out of phase with them.
    plain, cross = np.real(gram) + 1e-9 * np.eye(len(gram)), np.imag(gram)
    rest = np.real(gram) - cross.T @ np.linalg.solve(plain, cross)
    score = (lin.quadrature.ravel() * scale).reshape(paths, 6)
    level = float(chi2.isf(RATE, size))
    for path in range(paths):
        own = slice(6 * path, 6 * path + 6)
        values, vectors = np.linalg.eigh(rest[own, own])
        seen = values > 1e-6 * values[-1]
        along = vectors[:, seen].T @ score[path]
        statistic[path] = 2 / noise_variance * np.sum(along**2 / values[seen])
        if statistic[path] > level:
            clean = np.sqrt(1 - size / statistic[path])
            shift[path] = clean * scale[own] * (vectors[:, seen] @ (along / values[seen]))
    return Misfit(statistic, level, shift)
