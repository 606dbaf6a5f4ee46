"""Errors of trajectories as the robotics community states them: ATE and RPE.

The definitions are those of Sturm et al. (*A Benchmark for the Evaluation of RGB-D SLAM Systems*, IROS 2012) and agree with
the program evo (``evo_ape``, ``evo_rpe``), written anew from the formulas. Poses are planar motion in space: position in the
world frame and a heading about the vertical.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dopslam.errors import DopslamError

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Statistics:
    """What evo says about a column of errors; ``std`` is over the column itself (not n − 1)."""

    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float


def statistics(errors: Array) -> Statistics:
    """Statistics of errors (N,) ≥ 0."""
    errors = np.asarray(errors, float)
    if not len(errors):
        raise DopslamError(
            "trajectory: there is no error to speak of; give at least one pose (two for relative errors)"
        )
    root = float(np.sqrt(np.mean(errors**2)))
    return Statistics(root, *(float(f(errors)) for f in (np.mean, np.median, np.std, np.min, np.max)))


def poses(position: Array, heading: Array) -> Array:
    """(K, 4, 4) rigid transformations of positions (K, 2 or 3) [m] and headings (K,) [rad]."""
    position, heading = np.asarray(position, float), np.asarray(heading, float)
    if position.ndim != 2 or position.shape[1] not in (2, 3) or heading.shape != (len(position),):
        raise DopslamError(
            f"trajectory: positions {position.shape} and headings {heading.shape} are not (K, 2 or 3) and (K,)"
        )
    out = np.tile(np.eye(4), (len(position), 1, 1))
    cosine, sine = np.cos(heading), np.sin(heading)
    out[:, 0, 0], out[:, 0, 1], out[:, 1, 0], out[:, 1, 1] = cosine, -sine, sine, cosine
    out[:, : position.shape[1], 3] = position
    return out


def alignment(truth: Array, estimate: Array) -> Array:
    """(4, 4) rigid motion of the estimate (K, 4, 4) onto the truth, least squares over the positions (Umeyama 1991, no
    scale)."""
    _same(truth, estimate)
    a, b = truth[:, :3, 3], estimate[:, :3, 3]
    left, singular, right = np.linalg.svd((a - a.mean(axis=0)).T @ (b - b.mean(axis=0)))
    if np.sum(singular > np.finfo(float).eps * singular[0]) < 2:
        raise DopslamError("trajectory: the positions lie in one point or on one line; nothing says how to turn it")
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(left) * np.linalg.det(right))])
    move = np.eye(4)
    move[:3, :3] = left @ sign @ right
    move[:3, 3] = a.mean(axis=0) - move[:3, :3] @ b.mean(axis=0)
    return move


def absolute_errors(truth: Array, estimate: Array, align: bool = False) -> Array:
    """(K,) m, distance of every estimated position from the true one: ATE, ``evo_ape`` (``--align``).

    In radio SLAM the base station fixes the frame, so that nothing is to be aligned; with ``align`` the figure is that of
    methods that know their map only up to a rigid motion.
    """
    _same(truth, estimate)
    moved = alignment(truth, estimate) @ estimate if align else estimate
    return np.linalg.norm(moved[:, :3, 3] - truth[:, :3, 3], axis=1)


def relative_errors(truth: Array, estimate: Array, delta: int = 1) -> tuple[Array, Array]:
    """RPE: what the motion over ``delta`` steps is wrong by, (N,) m and (N,) rad, ``evo_rpe --delta``.

    E = (Q_i⁻¹ Q_{i+Δ})⁻¹ (P_i⁻¹ P_{i+Δ}) over i = 0, Δ, 2Δ, …; its translation and its angle.
    """
    _same(truth, estimate)
    if delta < 1:
        raise DopslamError(f"trajectory: delta is {delta} steps; it must be at least 1")
    first = np.arange(0, len(truth) - delta, delta)
    motion = [np.linalg.inv(p[first]) @ p[first + delta] for p in (truth, estimate)]
    error = np.linalg.inv(motion[0]) @ motion[1]
    cosine = 0.5 * (np.trace(error[:, :3, :3], axis1=1, axis2=2) - 1)
    sine = 0.5 * np.linalg.norm(error[:, [2, 0, 1], [1, 2, 0]] - error[:, [1, 2, 0], [2, 0, 1]], axis=1)
    return np.linalg.norm(error[:, :3, 3], axis=1), np.arctan2(sine, cosine)


def _same(truth: Array, estimate: Array) -> None:
    if truth.shape != estimate.shape:
        raise DopslamError(f"trajectory: {len(truth)} true and {len(estimate)} estimated poses; give the same steps")
