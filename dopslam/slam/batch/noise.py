"""Errors of detections beyond their stated covariance: a mixture of normals N(0, s R) over a few scales s.

A detection whose residual has squared Mahalanobis length d² over m rows has density Σ_c p_c s_c^{−m/2} exp(−d²/2s_c)
in units of N(0; 0, R). Its weight in the normal equations is the mean of 1/s under the probabilities of the scales
given d²: one for ordinary detections, so that nothing is lost where R is right (a Student-t would weigh the ordinary
ones too), and small for outliers. Where R is not to be believed, the scales are those of a Student-t with the factor on R
and the tail that the residuals speak for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

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

    def weigh(self, square: Array, rows: NDArray) -> tuple[Array, Array]:
        """log density (N,) over N(0; 0, R), and weight (N,), of squared lengths (N,) over `rows` (N,) rows."""
        terms = self._terms(square, rows)
        top = terms.max(axis=-1, keepdims=True)
        part = np.exp(terms - top)
        total = part.sum(axis=-1)
        return top[..., 0] + np.log(total), (part @ (1 / self.scale)) / total

    def information(self, square: Array, rows: NDArray) -> Array:
        """(N,) information of each detection in units of R⁻¹, the mean over directions of the observed one (Louis 1982):
        E[1/s] − Var[1/s] d²/m under the probabilities of the scales given d².

        The weight E[1/s] alone, right for the next step, counts what is known of the scales only from the residual itself.
        """
        terms = self._terms(square, rows)
        part = np.exp(terms - terms.max(axis=-1, keepdims=True))
        part /= part.sum(axis=-1, keepdims=True)
        weight = part @ (1 / self.scale)
        variance = part @ (1 / self.scale**2) - weight**2
        return np.maximum(weight - variance * np.asarray(square) / np.maximum(rows, 1), 0.1 * weight)

    @property
    def usual(self) -> float:
        """The median of the scales that are met."""
        order = np.argsort(self.scale)
        return float(self.scale[order][np.searchsorted(np.cumsum(self.share[order]), 0.5 * self.share.sum())])

    @property
    def weight(self) -> float:
        """The mean weight of a detection."""
        return float(self.share @ (1 / self.scale))

    def _terms(self, square: Array, rows: Array) -> Array:
        square, rows = np.asarray(square)[..., None], np.asarray(rows)[..., None]
        return np.log(self.share) - 0.5 * square / self.scale - 0.5 * rows * np.log(self.scale)


GIVEN = Scales(np.array([1.0, 9.0, 100.0]), np.array([0.95, 0.04, 0.01]))
FREEDOM = (3.0, 6.0, 12.0, 48.0)  # of the Student-t errors that are tried
FACTORS = 2.0 ** np.arange(-4, 4.01, 0.25)  # on R, likewise
PARTS = 9  # scales that stand for a Student-t


def student(freedom: float, factor: float) -> Scales:
    """Student-t errors of some degrees of freedom and covariance factor·R in the middle: scales factor·ν/χ²_ν."""
    middle = (np.arange(PARTS) + 0.5) / PARTS
    return Scales(factor * freedom / chi2.ppf(middle, freedom), np.full(PARTS, 1 / PARTS))


def learned(square: Array, rows: Array) -> Scales:
    """The Student-t that squared residuals (N,) over `rows` (N,) rows speak for most.

    One factor and one tail for all: a free mixture would give the detections that the fit happens to hit a covariance of
    nothing, and the next fit would hit them the better.
    """
    tried = [student(freedom, factor) for freedom in FREEDOM for factor in FACTORS]
    return max(tried, key=lambda scales: float(scales.weigh(square, rows)[0].sum()))
