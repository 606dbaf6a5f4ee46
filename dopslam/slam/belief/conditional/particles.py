"""Particles of the agent where a Gaussian is too coarse: exact weights for a proposal that knows the linearized update.

Particle i is one component N(a_i, Q_h) of the predicted density, with Q_h the motion's noise and, through the kernel's
width h, part of the particles' own spread (:mod:`dopslam.slam.belief.belief`, Liu and West): h = 1 is one Gaussian, small h
keeps several modes apart. The proposal multiplies it with what the linearized update of
:mod:`dopslam.slam.belief.conditional.update` says about the agent; the weights use the nonlinear measurement model.
"""

from __future__ import annotations

import math

import numpy as np

from dopslam.compute.compiled import compiled
from dopslam.compute.linalg import cholesky
from dopslam.slam.belief.belief import effective_size, normalized, systematic
from dopslam.slam.belief.conditional.linear import POSE, observe
from dopslam.slam.belief.kernels import VA

_LOG_2PI = math.log(2.0 * math.pi)


@compiled
def log_messages(
    form, first, weight, coordinates, poses, start, point, before_mean, before_center, before_gain, before_spread, by_feature,
    anchor, scan, noise, log_pair, log_missed,
):  # fmt: skip
    """Σ_k ln γ_k of every particle, (N,): each feature as it was, given the agent, when its turn came.

    Exact in the agent; in the feature linearized where the update was, at its posterior, which matters while a feature is
    uncertain: particle s sees it at point + G (s − start).

    coordinates (N, d), poses (N, 8) : the particles; the rest as :func:`update.sequential_update` takes and gives it
    """
    particles, size = coordinates.shape
    count, n = scan.distance.shape[0], scan.covariance.shape[1]
    result = np.zeros(particles)
    owner = np.empty(particles)
    factor, residual, shift = np.empty((n, n)), np.empty(8), np.empty(n)
    none, none3 = np.empty((1, POSE)), np.empty((1, 3))
    direction = math.log(2.0 * math.pi if scan.count == 1 else 4.0 * math.pi)
    for k in range(first.shape[0] - 1):
        constant, exists = 0.0, 0.0
        for r in range(first[k], first[k + 1]):
            exists += weight[r]
            constant += weight[r] * math.exp(log_missed[r])
        constant += max(1.0 - exists, 0.0)
        base = math.log(max(constant, 1e-300))
        for i in range(particles):
            owner[i] = base
        for r in range(first[k], first[k + 1]):
            used = n - scan.count if form[r] == VA else n
            for i in range(used):
                shift[i] = 0.0
                for a in range(3):
                    offset = before_center[r, a] - point[r, a]
                    for j in range(size):
                        offset += before_gain[r, a, j] * (start[j] - before_mean[k, j])
                    shift[i] += by_feature[r, i, a] * offset
            for m in range(count):
                if log_pair[r, m] == -np.inf or weight[r] < 1e-12:
                    continue
                for i in range(used):
                    for j in range(i + 1):
                        value = noise[r, m] * scan.covariance[m, i, j]
                        for a in range(3):
                            for b in range(3):
                                value += by_feature[r, i, a] * before_spread[r, a, b] * by_feature[r, j, b]
                        factor[i, j] = value
                if not cholesky(factor, used):
                    continue
                scale = math.log(weight[r]) + log_pair[r, m] - 0.5 * used * _LOG_2PI
                for i in range(used):
                    scale -= math.log(factor[i, i])
                if form[r] == VA:
                    scale -= direction
                for p in range(particles):
                    qx, qy, qz = point[r, 0], point[r, 1], point[r, 2]
                    for j in range(size):
                        offset = coordinates[p, j] - start[j]
                        qx += before_gain[r, 0, j] * offset
                        qy += before_gain[r, 1, j] * offset
                        qz += before_gain[r, 2, j] * offset
                    observe(form[r], poses[p], qx, qy, qz, anchor, scan, m, residual, False, none, none3)
                    value = scale
                    for i in range(used):
                        e = residual[i] - shift[i]
                        for j in range(i):
                            e -= factor[i, j] * residual[j]
                        e /= factor[i, i]
                        residual[i] = e
                        value -= 0.5 * e * e
                    old = owner[p]
                    if value > old:
                        old, value = value, old
                    if value - old > -40.0:
                        old += math.log(1.0 + math.exp(value - old))
                    owner[p] = old
        for i in range(particles):
            result[i] += owner[i]
    return result


def symmetric_root(matrix: np.ndarray) -> np.ndarray:
    """A with A Aᵀ = matrix, (d, d), also where it is singular."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return vectors * np.sqrt(np.maximum(values, 0.0))


def proposal(
    centers: np.ndarray, noise: np.ndarray, prior: tuple, posterior: tuple, widening: float
) -> tuple[np.ndarray, np.ndarray]:
    """Means (N, d) and one covariance of the components after the linearized update.

    Parameters
    ----------
    centers (N, d), noise (d, d) : the components N(a_i, Q_h)
    prior, posterior : mean (d,) and covariance (d, d) of the linearized update, whose ratio is what the scan says
    widening : of the proposal's standard deviation
    """
    (before, wide), (after, narrow) = prior, posterior
    # The scan as one linear measurement y = s + noise of covariance V: narrow = wide − wide (wide + V)⁻¹ wide. In the basis
    # where wide is the identity, directions about which the scan says nothing are left out; nothing has to be inverted.
    root = symmetric_root(wide)
    scale = np.linalg.pinv(root)
    values, vectors = np.linalg.eigh(np.eye(len(wide)) - scale @ (wide - narrow) @ scale.T)
    told = np.clip(1 - values, 0.0, 1 - 1e-12)
    seen = told > 1e-6
    rows = (vectors.T @ scale)[seen]  # the measurement's rows
    variance = (1 - told[seen]) / told[seen]
    shift = rows @ (after - before) / told[seen]  # where the scan alone puts them, from the prior's mean
    cross = noise @ rows.T
    gain = np.linalg.solve(rows @ cross + np.diag(variance), cross.T).T
    mean = centers + (shift - (centers - before) @ rows.T) @ gain.T
    covariance = noise - gain @ cross.T
    return mean, widening**2 * 0.5 * (covariance + covariance.T)


def tempered(log_weight: np.ndarray, least: float) -> np.ndarray:
    """Weights (N,), normalized, flattened by one exponent so far that ``least`` of them count.

    Fewer than there are coordinates have no covariance; the linearized proposal that they correct has.
    """
    normal = normalized(log_weight)
    if effective_size(normal) >= least:
        return normal
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if effective_size(normalized(middle * log_weight)) >= least else (low, middle)
    return normalized(low * log_weight)


def equal_weights(rng: np.random.Generator, points: np.ndarray, weight: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Resampled points (N, d) about their mean, with covariance ``spread``, the weighted ones': no noise is added."""
    drawn = points[systematic(rng, weight, len(points))]
    drawn = drawn - drawn.mean(axis=0)
    try:
        left = np.linalg.cholesky(spread)
        return drawn @ np.linalg.solve(np.linalg.cholesky(drawn.T @ drawn / len(drawn)).T, left.T)
    except np.linalg.LinAlgError:  # fewer of them than coordinates, or one that is known exactly
        return drawn


def quadratic(offset: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """½ xᵀ covariance⁻¹ x of every row, (N,)."""
    return 0.5 * np.sum(offset * np.linalg.solve(covariance, offset.T).T, axis=1)
