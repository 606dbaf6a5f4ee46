"""Errors of tracks and maps: GOSPA with its decomposition, RMSE, NEES."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from dopslam.errors import DopslamError
from dopslam.models.pose import POSE

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Gospa:
    """GOSPA distance (α = 2) and its parts.

    Attributes
    ----------
    distance : float [m]; (localization + missed + false)^{1/p}
    localization : float [m^p]; Σ d^p over assigned pairs
    missed, false : float [m^p]; c^p/2 for each
    missed_count, false_count : int
    pairs : (n, 2) int array; (truth, estimate) within the cutoff
    """

    distance: float
    localization: float
    missed: float
    false: float
    missed_count: int
    false_count: int
    pairs: NDArray[np.int64]


def gospa(truth: Array, estimate: Array, cutoff: float = 20.0, order: float = 2.0) -> Gospa:
    """Generalized optimal subpattern assignment metric with α = 2 (Rahmathullah et al. 2017).

    Parameters
    ----------
    truth : (T, d) array [m]
    estimate : (E, d) array [m]
    cutoff : float, c [m]
    order : float, p ≥ 1

    Returns
    -------
    Gospa
    """
    if not cutoff > 0 or order < 1:
        raise DopslamError(f"gospa: cutoff {cutoff} must be positive and order {order} at least 1")
    truth, estimate = np.atleast_2d(np.asarray(truth, float)), np.atleast_2d(np.asarray(estimate, float))
    count_true = 0 if truth.size == 0 else len(truth)
    count_found = 0 if estimate.size == 0 else len(estimate)
    if count_true and count_found:
        distance = cdist(truth, estimate)
        cost = np.minimum(distance, cutoff) ** order
        rows, columns = linear_sum_assignment(cost)
        near = distance[rows, columns] < cutoff
        pairs = np.column_stack([rows[near], columns[near]])
        localization = float(cost[rows[near], columns[near]].sum())
    else:
        pairs, localization = np.empty((0, 2), dtype=np.int64), 0.0
    missed, false = count_true - len(pairs), count_found - len(pairs)
    penalty = 0.5 * cutoff**order
    total = localization + penalty * (missed + false)
    return Gospa(total ** (1 / order), localization, penalty * missed, penalty * false, missed, false, pairs)


def state_errors(estimate: Array, truth: Array) -> Array:
    """estimate - truth with the heading (column 2) wrapped, shape (..., n)."""
    error = np.array(np.asarray(estimate, float) - np.asarray(truth, float))
    error[..., 2] = (error[..., 2] + np.pi) % (2 * np.pi) - np.pi
    return error


def squared_errors(error: Array, names: tuple[str, ...] = POSE) -> dict[str, Array]:
    """Squared errors of position [m²], heading [rad²], clock [m²] and of what a motion model has beyond, by its name.

    Parameters
    ----------
    error : (..., n)
    names : of the n states
    """
    parts = {
        "position": error[..., 0] ** 2 + error[..., 1] ** 2,
        "heading": error[..., 2] ** 2,
        "clock": error[..., 3] ** 2,
    }
    return parts | {name: error[..., i] ** 2 for i, name in enumerate(names) if i >= len(POSE)}


def nees(error: Array, covariance: Array) -> Array:
    """Normalized estimation error squared eᵀP⁻¹e, shape (...); its expectation is the number of states.

    A state that the filter holds for known (variance 0) adds nothing if its error is 0, and makes the NEES infinite
    otherwise; a variance that is infinite (nothing known) adds nothing.
    """
    error, covariance = np.asarray(error, float), np.asarray(covariance, float)
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    used = (variance > 0) & ~np.isposinf(variance)
    both = used[..., :, None] & used[..., None, :]
    scale = np.sqrt(np.where(used, variance, 1.0))
    matrix = np.where(both, covariance, np.eye(error.shape[-1])) / (scale[..., :, None] * scale[..., None, :])
    number = np.asarray(~np.isnan(covariance).any(axis=(-1, -2)) & np.isfinite(error).all(axis=-1))
    matrix = np.where(number[..., None, None], matrix, np.eye(error.shape[-1]))
    values, vectors = np.linalg.eigh(0.5 * (matrix + np.swapaxes(matrix, -1, -2)))
    turned = np.einsum("...ij,...i->...j", vectors, np.where(used & number[..., None], error, 0.0) / scale)
    flat = values <= 1e-15  # a combination of states that is known
    squares = np.where(flat & (np.abs(turned) < 1e-9), 0.0, turned**2 / np.where(flat, 1e-30, values))
    wrong = ((variance == 0) & (error != 0)).any(axis=-1)
    return np.where(number, np.where(wrong, np.inf, squares.sum(axis=-1)), np.nan)


def rmse_over_bound(squared: Array, bound_squared: Array) -> float:
    """Mean over steps of RMSE_k/bound_k.

    Parameters
    ----------
    squared : (runs, K) array of squared errors
    bound_squared : (runs, K) array of squared bounds with the detections that were drawn; averaged over the
    runs
    """
    return float(np.mean(np.sqrt(np.mean(squared, axis=0) / np.mean(bound_squared, axis=0))))
