"""Track and map together: robust Gauss-Newton (Levenberg and Marquardt) on all detections of a run, sparse.

Costs: −log of the mixture of scales at each detection's whitened residual, ½ squared lengths of the motion's residuals
and of the prior's, one step before the first scan. A mixture's cost is lowered by weighted least squares with its
weights at the point reached (Dempster, Laird and Rubin 1980); the information of the optimum is the observed one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dopslam.errors import FilterError
from dopslam.models.measurement import wrap
from dopslam.models.motion import MotionModel
from dopslam.models.paces import noises, propagate, transition_jacobian
from dopslam.slam.batch.front import Normal, Plan, Solution, plan, solve
from dopslam.slam.batch.landmarks import holds
from dopslam.slam.batch.noise import Scales
from dopslam.slam.batch.rows import Map, Rows, linearize, masked, whitened

Array = NDArray[np.float64]
Index = NDArray[np.int64]

KNOWN = 1e-12  # variance that stands for none where a state is known exactly: information must stay finite
HEADING = 2


@dataclass(frozen=True, slots=True)
class Chain:
    """What ties the states together.

    Attributes
    ----------
    motion : CoordinatedTurn
    mean : (n,) array; prior of the state one step before the first scan
    information : (n, n) array; its inverse covariance, zero where nothing is known
    pace : (K,) array; time since the scan before, of the first since the prior, in periods of the motion model
    """

    motion: MotionModel
    mean: Array
    information: Array
    pace: Array


@dataclass(frozen=True, slots=True)
class Estimate:
    """State of the optimization.

    Attributes
    ----------
    state : (K + 1, n), covariance : (K + 1, n, n); from one step before the first scan on
    found : Map
    cost : float; negative log of the posterior density, up to what does not change within a run
    log_determinant : float; of the information matrix
    square, weight : (N,) squared length of each detection's residual and its weight; nan and 0 where it is free
    """

    state: Array
    covariance: Array
    found: Map
    cost: float
    log_determinant: float
    square: Array
    weight: Array


@dataclass(frozen=True, slots=True)
class Sight:
    """The detections that have a landmark, sorted by step, and their whiteners."""

    rows: Index
    owner: Index
    whitener: Array
    count: Index
    order: Plan
    offsets: Index


def sights(data: Rows, owner: Index, found: Map, dimension: int) -> Sight:
    """Prepare the detections of an association; every landmark must be seen."""
    base, rows = len(data.stations), np.flatnonzero(owner >= 0)
    used = data.used_by(rows, found.kind[owner[rows]])
    eye = np.broadcast_to(np.eye(6), (len(rows), 6, 6))
    whitener = whitened(masked(data.covariance[rows], used), eye)[0]
    points = owner[rows] - base
    pose = data.step[rows] + 1
    first = np.full(len(found) - base, data.steps + 1)
    last = np.full(len(found) - base, -1)
    seen = points >= 0
    np.minimum.at(first, points[seen], pose[seen])
    np.maximum.at(last, points[seen], pose[seen])
    if (last < 0).any():
        raise FilterError(f"landmark {int(np.argmin(last))} has no detection: it cannot be estimated")
    offsets = np.searchsorted(pose, np.arange(data.steps + 2))
    return Sight(rows, points, whitener, used.sum(axis=1), plan(data.steps + 1, dimension, first, last), offsets)


def _differences(chain: Chain, state: Array) -> tuple[Array, Array]:
    """Residuals of the motion (K, n) and of the prior (n,), headings wrapped."""
    moved = state[1:] - propagate(state[:-1], chain.motion, chain.pace)
    start = state[0] - chain.mean
    moved[:, HEADING], start[HEADING] = wrap(moved[:, HEADING]), wrap(start[HEADING])
    return moved, start


def _weight(chain: Chain) -> Array:
    """(K, n, n) inverse covariances of the steps."""
    values, which = np.unique(chain.pace, return_inverse=True)
    known = KNOWN * np.eye(chain.motion.dimension)
    return np.asarray(np.linalg.inv(noises(chain.motion, values) + known), float)[which]


def _residuals(data: Rows, sight: Sight, state: Array, found: Map, owner: Index):
    linear = linearize(data, sight.rows, state[data.step[sight.rows] + 1], found.kind[owner], found.position[owner])
    return linear, np.einsum("mij,mj->mi", sight.whitener, linear.error)


def _cost(data: Rows, sight: Sight, chain: Chain, noise: Scales, state: Array, error: Array) -> float:
    moved, start = _differences(chain, state)
    density, _ = noise.weigh(np.sum(error**2, axis=1), sight.count)
    tied = np.einsum("ki,kij,kj->", moved, _weight(chain), moved) + start @ chain.information @ start
    return float(0.5 * tied - density.sum())


def _normal(data: Rows, sight: Sight, chain: Chain, state: Array, linear, error: Array, weight: Array) -> Normal:
    n, poses = chain.motion.dimension, len(state)
    points = sight.order.first.shape[0]
    by_state, by_point = sight.whitener @ linear.by_state, sight.whitener @ linear.by_point
    scaled_state, scaled_point = by_state * weight[:, None, None], by_point * weight[:, None, None]
    left = np.swapaxes(scaled_state, 1, 2)
    pose, by_pose = np.zeros((poses, n, n)), np.zeros((poses, n))
    at = data.step[sight.rows] + 1
    np.add.at(pose, at, left @ by_state)
    np.add.at(by_pose, at, np.einsum("mij,mj->mi", left, error))
    point, vector = np.tile(np.diag(holds(data)), (points, 1, 1)), np.zeros((points, 3))
    seen = sight.owner >= 0
    np.add.at(point, sight.owner[seen], (np.swapaxes(scaled_point, 1, 2) @ by_point)[seen])
    np.add.at(vector, sight.owner[seen], np.einsum("mij,mi->mj", scaled_point, error)[seen])
    moved, start = _differences(chain, state)
    jacobian, q = transition_jacobian(state[:-1], chain.motion, chain.pace), _weight(chain)
    back = np.swapaxes(jacobian, 1, 2) @ q
    pose[:-1] += back @ jacobian
    pose[1:] += q
    by_pose[:-1] += np.einsum("kij,kj->ki", back, moved)
    by_pose[1:] -= np.einsum("kij,kj->ki", q, moved)
    pose[0] += chain.information
    by_pose[0] -= chain.information @ start
    return Normal(pose, -back, point, left @ by_point, sight.owner, sight.offsets, by_pose, vector)


def optimize(
    data: Rows, chain: Chain, noise: Scales, owner: Index, state: Array, found: Map, iterations: int = 30
) -> Estimate:
    """Most likely track and map given an association.

    Parameters
    ----------
    data : Rows
    chain : Chain
    noise : Scales
    owner : (N,) landmark of each detection in `found`, -1 none
    state : (K + 1, n) array
        Where to start, and `found` likewise.
    iterations : int
        Most solutions of the normal equations.

    Raises
    ------
    FilterError
        If the information of the run is singular.
    """
    base = len(data.stations)
    sight = sights(data, owner, found, chain.motion.dimension)
    mine = owner[sight.rows]
    linear, error = _residuals(data, sight, state, found, mine)
    cost, damping = _cost(data, sight, chain, noise, state, error), 0.0
    for _ in range(iterations):
        weight = noise.weigh(np.sum(error**2, axis=1), sight.count)[1]
        normal = _normal(data, sight, chain, state, linear, error, weight)
        step = solve(sight.order, normal, damping)
        if step is None:
            damping = max(10 * damping, 1e-6)
            if damping > 1e6:
                break
            continue
        trial, moved = _moved(state, found, step, base)
        next_linear, next_error = _residuals(data, sight, trial, moved, mine)
        next_cost = _cost(data, sight, chain, noise, trial, next_error)
        gain = float(np.sum(step.pose * normal.by_pose) + np.sum(step.point * normal.by_point))
        if np.isfinite(next_cost) and next_cost <= cost + 1e-9 * abs(cost):
            settled = cost - next_cost < 1e-3 and gain < 1e-2
            state, found, linear, error, cost = trial, moved, next_linear, next_error, next_cost
            damping = 0.0 if damping < 1e-5 else damping / 10
            if settled:
                break
        else:
            damping = max(10 * damping, 1e-4)
            if damping > 1e6:
                break
    density = np.sum(error**2, axis=1)
    weight = noise.weigh(density, sight.count)[1]
    told = noise.information(density, sight.count)
    last = solve(sight.order, _normal(data, sight, chain, state, linear, error, told), spread=True)
    if last is None:
        raise FilterError("batch: the information of the run is singular; give a prior, or detections with angles")
    spread = np.concatenate([found.covariance[:base], last.point_covariance])
    square, weights = np.full(len(owner), np.nan), np.zeros(len(owner))
    square[sight.rows], weights[sight.rows] = density, weight
    mapped = Map(found.kind, found.position, found.station, spread)
    return Estimate(state, last.pose_covariance, mapped, cost, last.log_determinant, square, weights)


def _moved(state: Array, found: Map, step: Solution, base: int) -> tuple[Array, Map]:
    trial, position = state + step.pose, found.position.copy()
    position[base:] += step.point
    return trial, Map(found.kind, position, found.station, found.covariance)
