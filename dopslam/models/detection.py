"""Probability of detection: constant with a soft range for scatter points, or from the predicted SNR.

Two models, one signature. `ConstantDetection` is the convention of paper A's figures: p_D for BS and VA
everywhere, for SPs within a 3-D distance of the UE, softened by the uncertainty of that distance.
`SnrDetection` is physical: with post-integration SNR ρ, a path is found with probability P(χ'²_{2+6}(2ρ) >
2·threshold), eight degrees of freedom since a peak is searched over a complex gain and six parameters. Each
track learns its own SNR reference, ρ times the geometric spreading loss (BS, VA: d²; SP: d₁²·d₂²), from the
ρ of its detections.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import ncx2, norm

from dopslam.errors import FilterError

Array = NDArray[np.float64]

TABLE_START_DB = -10.0
TABLE_STEP_DB = 0.25
TABLE_SIZE = 281  # to 60 dB


@dataclass(frozen=True, slots=True)
class ConstantDetection:
    """p_D the same for every path, scatter points only within `sp_range` [m] of the UE (None: everywhere)."""

    probability: float = 0.9
    sp_range: float | None = 50.0

    def __post_init__(self) -> None:
        if not 0 < self.probability <= 1:
            raise FilterError(f"ConstantDetection.probability is {self.probability}; it must lie in (0, 1]")


@dataclass(frozen=True, slots=True)
class SnrDetection:
    """p_D from ρ.

    Attributes
    ----------
    threshold : float
        Detection threshold on ρ, linear.
    fading_std_db : float
        Spread of the log-SNR around its prediction (pattern, material, selection); p_D is averaged over it.
    ceiling : float
        Largest p_D ever assumed: an obstacle, not noise, explains a miss at high SNR.
    """

    threshold: float
    fading_std_db: float = 2.0
    ceiling: float = 0.98

    def __post_init__(self) -> None:
        if not self.threshold > 0:
            raise FilterError(f"SnrDetection.threshold is {self.threshold}; it must be positive (linear)")
        if not 0 < self.ceiling <= 1:
            raise FilterError(f"SnrDetection.ceiling is {self.ceiling}; it must lie in (0, 1]")


DetectionModel = ConstantDetection | SnrDetection
STRONG = 2e5  # twice an SNR


def probability_from_snr(snr: ArrayLike, threshold: float) -> Array:
    """P(χ'²_8(2ρ) > 2·threshold) of a path with post-integration SNR `snr` (linear).

    Above 50 dB the root of χ'² is normal to 3e-6, and the exact function may overflow or never end.
    """
    squared, offset = 2.0 * threshold, 2.0 * np.asarray(snr, dtype=float)
    if squared < 1e-3:  # one but for 3e-15
        return np.ones(offset.shape)
    if squared > STRONG:
        return norm.sf(np.sqrt(squared) - np.sqrt(offset + 7.0))
    exact = ncx2.sf(squared, 8, np.minimum(offset, STRONG))
    return np.where(offset > STRONG, norm.sf(np.sqrt(squared) - np.sqrt(offset + 7.0)), exact)


def detection_table(model: DetectionModel) -> Array:
    """p_D on the grid of ρ from -10 to 60 dB in steps of 0.25 dB, averaged over the fading, shape (281,)."""
    decibel = TABLE_START_DB + TABLE_STEP_DB * np.arange(TABLE_SIZE)
    if isinstance(model, ConstantDetection):
        return np.full(TABLE_SIZE, model.probability)
    nodes, weights = np.polynomial.hermite_e.hermegauss(21)
    weights = weights / weights.sum()
    shifted = decibel[:, None] + model.fading_std_db * nodes
    table = probability_from_snr(10 ** (shifted / 10), model.threshold) @ weights
    return np.minimum(np.maximum.accumulate(table), model.ceiling)


def soft_range(distance: ArrayLike, limit: float | None, distance_std: ArrayLike = 0.0) -> Array:
    """P(true distance < limit) = Φ((limit - distance)/std); a hard step for std = 0; 1 without a limit."""
    distance = np.asarray(distance, dtype=float)
    if limit is None:
        return np.ones(distance.shape)
    return norm.cdf((limit - distance) / np.maximum(np.asarray(distance_std, dtype=float), 1e-9))
