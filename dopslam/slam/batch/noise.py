"""Errors of detections beyond their stated covariance: a mixture of normals N(0, s R) over a few scales s.

A detection whose residual has squared Mahalanobis length d² over m rows has density Σ_c p_c s_c^{−m/2} exp(−d²/2s_c)
in units of N(0; 0, R). Its weight in the normal equations is the mean of 1/s under the probabilities of the scales
given d²: one for ordinary detections, so that nothing is lost where R is right (a Student-t would weigh the ordinary
ones too), and small for outliers. Learned shares of a fine grid of scales are the empirical-Bayes answer to covariances
that are wrong as a whole and to heavy tails alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dopslam.errors import FilterError

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Scales:
    """Mixture of scales.

    Attributes
    ----------
    scale : (C,) array; factors on R
    share : (C,) array; how often each is met
    """

    scale: Array
    share: Array

    def __post_init__(self) -> None:
        if self.scale.shape != self.share.shape or not ((self.scale > 0).all() and (self.share > 0).all()):
            raise FilterError(f"Scales: scale {self.scale} and share {self.share} must be positive and of one length")

    def weigh(self, square: Array, rows: Array) -> tuple[Array, Array]:
        """log density (N,) over N(0; 0, R), and weight (N,), of squared lengths (N,) over `rows` (N,) rows."""
        terms = self._terms(square, rows)
        top = terms.max(axis=-1, keepdims=True)
        part = np.exp(terms - top)
        total = part.sum(axis=-1)
        return top[..., 0] + np.log(total), (part @ (1 / self.scale)) / total

    @property
    def usual(self) -> float:
        """The median of the scales that are met."""
        order = np.argsort(self.scale)
        return float(self.scale[order][np.searchsorted(np.cumsum(self.share[order]), 0.5 * self.share.sum())])

    @property
    def weight(self) -> float:
        """The mean weight of a detection."""
        return float(self.share @ (1 / self.scale))

    def learned(self, square: Array, rows: Array, strength: float = 2.0) -> Scales:
        """Shares from residuals, by expectation and maximization; a Dirichlet prior of `strength` observations holds
        those that nothing speaks for."""
        mixture = self
        for _ in range(20):
            terms = mixture._terms(square, rows)
            probability = np.exp(terms - terms.max(axis=-1, keepdims=True))
            probability /= probability.sum(axis=-1, keepdims=True)
            count = probability.sum(axis=0) + strength / len(self.scale)
            mixture = Scales(self.scale, count / count.sum())
        return mixture

    def _terms(self, square: Array, rows: Array) -> Array:
        square, rows = np.asarray(square)[..., None], np.asarray(rows)[..., None]
        return np.log(self.share) - 0.5 * square / self.scale - 0.5 * rows * np.log(self.scale)


GIVEN = Scales(np.array([1.0, 9.0, 100.0]), np.array([0.95, 0.04, 0.01]))
GRID = Scales(np.array([0.25, 0.5, 1, 2, 4, 8, 16, 64, 256]), np.array([1, 2, 8, 4, 2, 1, 1, 0.5, 0.5]) / 20)
