"""What is not measured, as a measurement that tells nothing: a Gaussian far wider than what is searched.

A filter then runs on any subset of the six quantities. The volume over which false paths spread is widened alike, so that
no hypothesis gains by a quantity that nobody saw.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

WIDE = 100.0  # standard deviation over the width that is searched, times √(2π)


def deviation(widths: np.ndarray) -> np.ndarray:
    """Standard deviations (6,) of quantities that were not measured, from the widths (6,) that are searched."""
    return WIDE * widths / np.sqrt(2 * np.pi)


SPANS = np.array([1.0, 2 * np.pi, np.pi, 2 * np.pi, np.pi, 1.0])  # of angles; of delay and Doppler set per run
UNSEEN = (0.1 * deviation(SPANS)) ** 2  # rad², variances of angles from which on they were not measured


def missing(variance: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """(N, 6) quantities that were not measured, by their variances (N, 6); one that is as wide as what is searched, or
    wider, tells nothing."""
    return np.sqrt(variance) > 0.1 * deviation(widths)


def planar(variance: np.ndarray) -> bool:
    """Whether no elevation was measured at all, by the variances (N, 6) of the detections."""
    return bool(len(variance)) and bool((variance[:, [2, 4]] > UNSEEN[[2, 4]]).all())


def delay_width(search_volume: float, doppler_span: float, used: ArrayLike) -> float:
    """Width [m] over which delays are searched, from the volume of all six quantities and which of them (6,) are measured."""
    spans = np.append(SPANS[1:5], doppler_span)
    return max(search_volume / float(np.prod(spans * np.where(np.asarray(used)[1:], 1.0, WIDE))), 1e-3)


def volume(widths: np.ndarray, missing: np.ndarray) -> float:
    """Volume that false paths spread over; ``missing`` (6,) counts with the width of its own Gaussian. It is the share of
    the detections that lack a quantity, where only some do: the geometric mean over them."""
    return float(np.prod(widths * WIDE ** np.asarray(missing, float)))


def filled(covariance: np.ndarray, widths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Covariances (N, 6, 6) with wide variances where a link cannot observe a quantity (infinite), and which those are.

    A row of elements cannot tell elevations, one symbol no Doppler, one pilot no delay.
    """
    missing = np.isinf(np.einsum("nii->ni", covariance))
    either = missing[:, :, None] | missing[:, None, :]
    wide = missing[:, :, None] * np.diag(deviation(widths) ** 2)
    return np.where(either, wide, covariance), missing.any(axis=0)
