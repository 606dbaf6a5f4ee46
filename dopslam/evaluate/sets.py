"""Distances between sets of points, and between sets of trajectories, beside GOSPA (:mod:`dopslam.evaluate.metrics`).

OSPA: Schuhmacher, Vo and Vo (2008). T-GOSPA: García-Fernández, Rahmathullah and Svensson (2020), the linear programming
metric, which also counts how often a trajectory is taken over by another one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment, linprog
from scipy.sparse import block_diag, coo_array, hstack, vstack
from scipy.sparse import eye_array as identity
from scipy.spatial.distance import cdist

from dopslam.errors import DopslamError

Array = NDArray[np.float64]


def ospa(truth: Array, estimate: Array, cutoff: float = 20.0, order: float = 2.0) -> float:
    """Optimal subpattern assignment metric [m].

    Parameters
    ----------
    truth : (T, d) m; estimate : (E, d) m
    cutoff : c [m], order : p ≥ 1
    """
    _check("ospa", cutoff, order)
    truth, estimate = np.asarray(truth, float), np.asarray(estimate, float)
    few, many = sorted((len(truth), len(estimate)))
    if many == 0:
        return 0.0
    if few == 0:
        return float(cutoff)
    cost = np.minimum(cdist(truth, estimate), cutoff) ** order
    total = cost[linear_sum_assignment(cost)].sum() + cutoff**order * (many - few)
    return float((total / many) ** (1 / order))


@dataclass(frozen=True, slots=True)
class TrajectoryGospa:
    """T-GOSPA and its parts, each already summed over the steps.

    Attributes
    ----------
    distance : float [m]; (localization + missed + false + switch)^{1/p}
    localization, missed, false, switch : float [m^p]
    """

    distance: float
    localization: float
    missed: float
    false: float
    switch: float


def trajectory_gospa(
    truth: Array, estimate: Array, cutoff: float = 20.0, order: float = 2.0, switch: float = 2.0
) -> TrajectoryGospa:
    """T-GOSPA between two sets of trajectories.

    Parameters
    ----------
    truth : (T, K, d) m, NaN at the steps at which a trajectory does not exist
    estimate : (E, K, d) m, likewise
    cutoff : c [m], order : p ≥ 1
    switch : γ [m], penalty of a change of partner
    """
    _check("trajectory_gospa", cutoff, order)
    truth, estimate = np.asarray(truth, float), np.asarray(estimate, float)
    if truth.ndim != 3 or estimate.ndim != 3 or truth.shape[1:] != estimate.shape[1:]:
        raise DopslamError(
            f"trajectory_gospa: shapes {truth.shape} and {estimate.shape} are not (T, K, d) and (E, K, d)"
        )
    steps, here, there = truth.shape[1], _exists(truth), _exists(estimate)
    half = 0.5 * cutoff**order
    parts = np.zeros((3, steps, len(truth) + 1, len(estimate) + 1))  # localization, missed, false of every pair
    for k in range(steps):
        parts[1, k, :-1, -1] = half * here[:, k]
        parts[2, k, -1, :-1] = half * there[:, k]
        both = here[:, k, None] & there[None, :, k]
        distance = np.full(both.shape, np.inf)
        if both.any():
            mine, other = np.flatnonzero(here[:, k]), np.flatnonzero(there[:, k])
            distance[np.ix_(mine, other)] = cdist(truth[mine, k], estimate[other, k])
        near = both & (distance < cutoff)
        parts[0, k, :-1, :-1][near] = distance[near] ** order
        parts[1, k, :-1, :-1] = half * (here[:, k, None] & ~near)
        parts[2, k, :-1, :-1] = half * (there[None, :, k] & ~near)
    weight, changed = _assignment(parts.sum(axis=0), 0.5 * switch**order)
    shares = [float((part * weight).sum()) for part in parts]
    change = 0.5 * switch**order * changed
    localization, missed, false = shares
    total = max(sum(shares) + change, 0.0)
    return TrajectoryGospa(total ** (1 / order), localization, missed, false, change)


def _assignment(cost: Array, penalty: float) -> tuple[Array, float]:
    """Weights (K, T + 1, E + 1) of the cheapest assignment, and the sum of their changes from step to step."""
    steps, rows, columns = cost.shape
    size = rows * columns
    index = np.arange(size).reshape(rows, columns)
    real = index[:-1, :-1].ravel()
    sums = [*index[:-1], *index[:, :-1].T]  # every trajectory goes somewhere, the dummies may take any number
    if not sums:
        return np.zeros_like(cost), 0.0
    row = np.concatenate([np.full(len(s), n) for n, s in enumerate(sums)])
    single = coo_array((np.ones(len(row)), (row, np.concatenate(sums))), shape=(len(sums), size))
    equal: Any = _blocks(single, steps)
    changes = (steps - 1) * len(real)
    pick = coo_array((np.ones(len(real)), (np.arange(len(real)), real)), shape=(len(real), size))
    later = hstack([coo_array((changes, size)), _blocks(pick, steps - 1)]) if changes else None
    upper = None
    if later is not None:
        earlier = hstack([_blocks(pick, steps - 1), coo_array((changes, size))])
        step, unit = later - earlier, identity(changes)
        upper = vstack([hstack([step, -unit]), hstack([-step, -unit])]).tocsr()
    weights = np.concatenate([cost.ravel(), np.full(changes, penalty)])
    limits = np.array([[0.0, 1.0]]).repeat(len(weights), axis=0)
    limits[: size * steps, 1][np.tile(index.ravel() == size - 1, steps)] = 0.0
    limits[size * steps :, 1] = np.inf
    found = linprog(
        weights,
        A_ub=upper,
        b_ub=None if upper is None else np.zeros(2 * changes),
        A_eq=hstack([equal, coo_array((equal.shape[0], changes))]).tocsr() if changes else equal.tocsr(),
        b_eq=np.ones(equal.shape[0]),
        bounds=limits,
        method="highs",
    )
    if found.status != 0 or found.x is None:
        raise DopslamError(f"trajectory_gospa: the linear program was not solved ({found.message})")
    x = np.asarray(found.x)
    return x[: size * steps].reshape(cost.shape), float(x[size * steps :].sum())


def _blocks(matrix, count: int):
    """A sparse matrix repeated along the diagonal."""
    return block_diag([matrix] * count) if count else coo_array((0, 0))


def _exists(trajectories: Array) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(trajectories).all(axis=2))


def _check(name: str, cutoff: float, order: float) -> None:
    if not cutoff > 0 or order < 1:
        raise DopslamError(f"{name}: cutoff {cutoff} must be positive and order {order} at least 1")
