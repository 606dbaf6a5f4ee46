"""How good detections are: association with the truth, RMSE over the bound, NEES, probability of detection,
false paths.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import linear_sum_assignment

from .detections import Detections
from .fisher import crb, snr
from .signal.directions import Float
from .signal.model import SignalModel
from .signal.paths import PathTable
from .statistics import half_width

GATE = 60.0
"""Largest squared Mahalanobis distance (six parameters) at which a detection still counts as that path."""


@dataclass(frozen=True, eq=False)
class Match:
    """One burst's detections against its true paths.

    Attributes
    ----------
    truth, found : (A,) indices of the associated pairs
    error : (A, 6) detection minus truth, azimuths and delays wrapped
    bound : (A, 6, 6) Cramer-Rao bound of the true paths
    covariance : (A, 6, 6) the detections' own
    rho : (P,) true post-integration SNR of all true paths, linear
    detected : (P,) which true paths were found
    false : number of detections without a true path
    """

    truth: np.typing.NDArray[np.intp]
    found: np.typing.NDArray[np.intp]
    error: Float
    bound: Float
    covariance: Float
    rho: Float
    detected: np.typing.NDArray[np.bool_]
    false: int

    @property
    def nees(self) -> Float:
        """(A,) normalized squared errors with the detections' own covariances (expected: the number of
        parameters).
        """
        return _squared(self.error, self.covariance)


def differences(found: Float, truth: Float, period: float = np.inf) -> Float:
    """Parameter differences (..., 6), azimuths wrapped to +-pi and delays to half the unambiguous ``period``
    [s].
    """
    error = np.array(found - truth)
    error[..., [1, 3]] = (error[..., [1, 3]] + np.pi) % (2 * np.pi) - np.pi
    if np.isfinite(period) and period > 0:
        error[..., 0] = (error[..., 0] + period / 2) % period - period / 2
    return error


def associate(
    model: SignalModel, detections: Detections, paths: PathTable, noise_variance: float, gate: float = GATE
) -> Match:
    """Optimal assignment of detections to true paths by squared Mahalanobis distance.

    The distance uses the sum of the bound and the detection's own covariance per pair. A path that tells nothing (it
    leaves or arrives where a pattern is zero) has no bound, and no detection is of it.
    """
    active = model.active
    truth = paths.vector
    bound = crb(model, paths, noise_variance)
    rho = snr(model, paths, noise_variance)
    error = differences(detections.vector[:, None], truth[None], model.max_delay or np.inf)
    telling = np.isfinite(bound[:, active][:, :, active]).all(axis=(1, 2))
    both = detections.covariance[:, None] + bound[None, telling]
    distance, volume = np.full(error.shape[:2], 1e9), np.zeros(error.shape[:2])
    if both.size:
        both = both[..., active, :][..., active]
        distance[:, telling], volume[:, telling] = (
            np.nan_to_num(_squared(error[:, telling][..., active], both), nan=1e9),
            np.linalg.slogdet(both / _unit(bound[telling], active))[1],
        )
    # The determinant keeps an unresolved path with a huge bound from taking the detection of its strong
    # neighbor.
    row, column = linear_sum_assignment(np.where(distance < gate, distance + volume, 1e6))
    good = distance[row, column] < gate
    row, column = row[good], column[good]
    detected = np.zeros(len(paths), bool)
    detected[column] = True
    part = np.ix_(np.arange(len(row)), np.flatnonzero(active), np.flatnonzero(active))
    return Match(
        column,
        row,
        error[row, column][:, active],
        bound[column][part],
        detections.covariance[row][part],
        rho,
        detected,
        len(detections) - len(row),
    )


def _unit(bound: Float, active) -> Float:
    """Common units in which determinants of the pairs' covariances are of moderate size."""
    scale = np.sqrt(np.median(np.diagonal(bound, axis1=1, axis2=2)[:, active], axis=0))
    return np.outer(scale, scale)


def _squared(error: Float, covariance: Float) -> Float:
    scale = 1 / np.sqrt(np.maximum(np.diagonal(covariance, axis1=-2, axis2=-1), 1e-300))
    correlation = covariance * scale[..., :, None] * scale[..., None, :]
    scaled = error * scale
    return np.sum(scaled * np.linalg.solve(correlation, scaled[..., None])[..., 0], axis=-1)


@dataclass(frozen=True, eq=False)
class Summary:
    """Pooled figures of many bursts, each with its 95 % interval where there is one.

    Attributes
    ----------
    rmse_over_crb : (6,) root of the mean squared ratio of error to bound, over associations with rho above
        ``accuracy_from``
    rmse_interval : (6, 2)
    nees_over_n : mean own-covariance NEES over the number of parameters
    nees_interval : (2,)
    nees_per_parameter : (6,) mean squared error of each parameter over its own variance
    associations : number of associations pooled
    gross : number of those with an error beyond six times its bound in some parameter
    false_per_snapshot : mean
    snapshots : number
    """

    rmse_over_crb: Float
    rmse_interval: Float
    nees_over_n: float
    nees_interval: Float
    nees_per_parameter: Float
    associations: int
    gross: int
    false_per_snapshot: float
    snapshots: int


def summarize(matches: list[Match], accuracy_from: float = 10**1.8) -> Summary:
    """Pool matches; errors enter where the true rho is above ``accuracy_from`` (linear)."""
    keep = [m.rho[m.truth] > accuracy_from for m in matches]
    error = np.concatenate([m.error[k] for m, k in zip(matches, keep, strict=True)])
    bound = np.concatenate([m.bound[k] for m, k in zip(matches, keep, strict=True)])
    own = np.concatenate([m.covariance[k] for m, k in zip(matches, keep, strict=True)])
    nees = np.concatenate([m.nees[k] for m, k in zip(matches, keep, strict=True)])
    count, size = error.shape
    if count == 0:
        unknown, false = np.full(size, np.nan), float(np.mean([m.false for m in matches]))
        nothing = np.full((size, 2), np.nan)
        return Summary(unknown, nothing, np.nan, nothing[0], unknown, 0, 0, false, len(matches))
    ratio = error**2 / np.diagonal(bound, axis1=1, axis2=2)
    rmse = np.sqrt(ratio.mean(axis=0))
    spread = half_width(ratio.std(axis=0), count) / (2 * np.maximum(rmse, 1e-300))
    mean = nees.mean() / size
    width = half_width(nees.std() / size, count)
    return Summary(
        rmse,
        np.stack([rmse - spread, rmse + spread], axis=1),
        float(mean),
        np.array([mean - width, mean + width]),
        np.mean(error**2 / np.diagonal(own, axis1=1, axis2=2), axis=0),
        count,
        int(np.sum(np.any(ratio > 36, axis=1))),
        float(np.mean([m.false for m in matches])),
        len(matches),
    )


def detection_by_band(matches: list[Match], edges_db) -> list[tuple[int, int]]:
    """(found, present) true paths per band of rho [dB]."""
    rho = 10 * np.log10(np.maximum(np.concatenate([m.rho for m in matches]), 1e-12))
    found = np.concatenate([m.detected for m in matches])
    return [
        (int(found[(rho >= a) & (rho < b)].sum()), int(((rho >= a) & (rho < b)).sum())) for a, b in pairwise(edges_db)
    ]


def nees_by_band(matches: list[Match], edges_db) -> list[tuple[float, int]]:
    """(mean own-covariance NEES over its dimension, count) per band of true rho [dB]."""
    rho = 10 * np.log10(np.concatenate([m.rho[m.truth] for m in matches]))
    nees = np.concatenate([m.nees for m in matches])
    size = matches[0].error.shape[1]
    bands = pairwise(edges_db)
    return [
        (float(nees[k].mean() / size) if k.any() else np.nan, int(k.sum()))
        for k in ((rho >= a) & (rho < b) for a, b in bands)
    ]
