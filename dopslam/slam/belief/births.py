"""New features from single measurements: one Gaussian per measurement and type.

Given an agent particle, distance and one direction fix the position exactly; the other direction, if the form
explains it, is redundant and gives the evidence. With D = distance − bias, arrival e and departure n (world
frame), w = p − p_a:

* VA: q = p + D e, |∂q| = D^{axes−1};
* PS: q = p_a + R n with R = (D² − ‖w‖²)/(2(D − wᵀn)) — from the AOD, which needs no heading — and
  |∂q| = R^{axes−1}/(1 + eᵀn).

The PPP of new features has intensity μ_n/(volume·u_max) per type prior, so
c_ms = μ_n P(s)/(volume u_max) · E[|∂q| · N(redundant residual)], times 1/2π (1/4π in space) for the direction
that a ``VA`` without AOD leaves unexplained: all forms are densities over the same measurement space (theory
§5).
"""

from __future__ import annotations

import numpy as np

from dopslam.compute.compiled import compiled
from dopslam.slam.belief.kernels import PS, VA, _pack, _tangents, _update, linearize

_LOG_2PI = np.log(2 * np.pi)


def order_for(count: int, form: int) -> np.ndarray:
    """Permutation of the measurement's rows that puts the birth's own rows first (a PS starts from the AOD)."""
    first, second = np.arange(1, 1 + count), np.arange(1 + count, 1 + 2 * count)
    return np.concatenate([[0], second, first] if form == PS else [[0], first, second])


@compiled
def birth(form, count, agent, weight, anchor, distance, aoa, aod, covariance, whitener, permutation):
    """Evidence and Gaussian of a new feature from one measurement.

    Parameters
    ----------
    agent (N, 6), weight (N,) : particles as in :mod:`dopslam.slam.belief.kernels`, weights sum to 1
    covariance, whitener : (n, n) in the order of ``permutation`` (:func:`order_for`)

    Returns
    -------
    log_evidence : ln E[|∂q| N(redundant rows)], −inf where no particle allows the form
    mean (3,), cov (3, 3) : moments over particles
    """
    particles = len(agent)
    n = 1 + 2 * count
    own = 1 + count
    log_w = np.empty(particles)
    q, p6 = np.empty((particles, 3)), np.empty((particles, 6))
    gradient = np.empty((own, 3))
    residual, rows, basis = np.empty(5), np.empty((5, 3)), np.empty((2, 3))
    white_residual, white_rows = np.empty(5), np.empty((5, 3))
    offset = np.empty(3)
    cov = np.empty((3, 3))
    top = -np.inf
    for i in range(particles):
        log_w[i] = -np.inf
        length = distance - agent[i, 3]
        if length <= 0.0 or weight[i] <= 0.0:
            continue
        if form == PS:
            wx, wy, wz = agent[i, 0] - anchor[0], agent[i, 1] - anchor[1], agent[i, 2] - anchor[2]
            slack = length * length - wx * wx - wy * wy - wz * wz
            if slack <= 1e-9:
                continue
            below = length - (wx * aod[0] + wy * aod[1] + wz * aod[2])
            reach = 0.5 * slack / below
            for a in range(3):
                q[i, a] = anchor[a] + reach * aod[a]
            dx, dy, dz = q[i, 0] - agent[i, 0], q[i, 1] - agent[i, 1], q[i, 2] - agent[i, 2]
            r = np.sqrt(dx * dx + dy * dy + dz * dz) + 1e-12
            opening = 1.0 + (dx * aod[0] + dy * aod[1] + dz * aod[2]) / r
            log_jacobian = count * np.log(reach) - np.log(max(opening, 1e-9))
            _tangents(aod[0], aod[1], aod[2], basis)
            for a in range(3):
                gradient[0, a] = aod[a] / max(opening, 1e-9)
            for j in range(count):
                turn = reach * (wx * basis[j, 0] + wy * basis[j, 1] + wz * basis[j, 2]) / below
                for a in range(3):
                    gradient[1 + j, a] = reach * basis[j, a] + turn * aod[a]
        else:
            c, s = agent[i, 4], agent[i, 5]
            ex, ey, ez = c * aoa[0] - s * aoa[1], s * aoa[0] + c * aoa[1], aoa[2]
            q[i, 0] = agent[i, 0] + length * ex
            q[i, 1] = agent[i, 1] + length * ey
            q[i, 2] = agent[i, 2] + length * ez
            log_jacobian = count * np.log(length)
            _tangents(ex, ey, ez, basis)
            gradient[0, 0], gradient[0, 1], gradient[0, 2] = ex, ey, ez
            for j in range(count):
                for a in range(3):
                    gradient[1 + j, a] = length * basis[j, a]
        for a in range(3):
            for b in range(3):
                total = 0.0
                for j in range(own):
                    for k in range(own):
                        total += gradient[j, a] * covariance[j, k] * gradient[k, b]
                cov[a, b] = total
        _pack(cov, p6[i])
        value = log_jacobian + np.log(weight[i])
        if form == VA:
            value -= np.log(2 * np.pi) if count == 1 else np.log(4 * np.pi)
        else:
            linearize(
                form, count, agent, i, q[i, 0], q[i, 1], q[i, 2], anchor, distance, aoa[0], aoa[1], aoa[2],
                aod[0], aod[1], aod[2], residual, rows,
            )  # fmt: skip
            log_det = 0.0
            for j in range(own, n):  # whitened redundant rows; the own rows have no residual
                e, h0, h1, h2 = 0.0, 0.0, 0.0, 0.0
                for k in range(j + 1):
                    t = permutation[k]
                    e += whitener[j, k] * residual[t]
                    h0 += whitener[j, k] * rows[t, 0]
                    h1 += whitener[j, k] * rows[t, 1]
                    h2 += whitener[j, k] * rows[t, 2]
                white_residual[j - own] = e
                white_rows[j - own, 0], white_rows[j - own, 1], white_rows[j - own, 2] = h0, h1, h2
                log_det += np.log(whitener[j, j])
            offset[:] = 0.0
            value += _update(count, white_residual, white_rows, offset, p6[i]) + log_det - 0.5 * count * _LOG_2PI
            for a in range(3):
                q[i, a] += offset[a]
        log_w[i] = value
        top = max(top, value)
    mean = np.zeros(3)
    out = np.zeros((3, 3))
    if top == -np.inf:
        return top, mean, out
    total = 0.0
    for i in range(particles):
        w = np.exp(log_w[i] - top)
        if w > 0.0:
            total += w
            for a in range(3):
                mean[a] += w * q[i, a]
    for a in range(3):
        mean[a] /= total
    for i in range(particles):
        w = np.exp(log_w[i] - top) / total
        if w > 0.0:
            d0, d1, d2 = q[i, 0] - mean[0], q[i, 1] - mean[1], q[i, 2] - mean[2]
            out[0, 0] += w * (p6[i, 0] + d0 * d0)
            out[0, 1] += w * (p6[i, 1] + d0 * d1)
            out[0, 2] += w * (p6[i, 2] + d0 * d2)
            out[1, 1] += w * (p6[i, 3] + d1 * d1)
            out[1, 2] += w * (p6[i, 4] + d1 * d2)
            out[2, 2] += w * (p6[i, 5] + d2 * d2)
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    return top + np.log(total), mean, out


@compiled
def births(form, count, agent, weight, anchor, distance, aoa, aod, covariance, whitener, permutation):
    """:func:`birth` for every measurement: log evidence (M,), means (M, 3), covariances (M, 3, 3)."""
    total = len(distance)
    log_evidence, mean, cov = np.empty(total), np.empty((total, 3)), np.empty((total, 3, 3))
    for m in range(total):
        log_evidence[m], mean[m], cov[m] = birth(
            form,
            count,
            agent,
            weight,
            anchor,
            distance[m],
            aoa[m],
            aod[m],
            covariance[m],
            whitener[m],
            permutation,
        )
    return log_evidence, mean, cov
