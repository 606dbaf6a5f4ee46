"""Compiled Gaussian evidence for data association (guard g1)."""

from __future__ import annotations

import numpy as np

from dopslam.compute.compiled import compiled
from dopslam.slam.belief.kernels import LOS, PS, VA, _tangents, linearize

_LOG_2PI = np.log(2 * np.pi)


@compiled
def _cholesky_log_density(s, e, n):
    """ln N(e; 0, s) of the leading n rows, s is destroyed; −inf if it is not positive."""
    value = -0.5 * n * _LOG_2PI
    for j in range(n):
        d = s[j, j]
        for k in range(j):
            d -= s[j, k] * s[j, k]
        if d <= 0.0:
            return -np.inf
        d = np.sqrt(d)
        s[j, j] = d
        y = e[j]
        for k in range(j):
            y -= s[j, k] * e[k]
        e[j] = y / d
        for i in range(j + 1, n):
            v = s[i, j]
            for k in range(j):
                v -= s[i, k] * s[j, k]
            s[i, j] = v / d
        value -= 0.5 * e[j] * e[j] + np.log(d)
    return value


@compiled
def gaussian_evidence(agent, weight, anchor, count, form, mean, cov, distance, aoa, aod, covariance, scale):
    """Data association evidence ln N(z_m; predicted moments of row r), (R, M) (guard g1).

    The predicted measurement's moments are taken over the weighted particles and the feature's Gaussian, in
    the chord coordinates at the mean particle's prediction. Unlike a Monte Carlo average of sharp likelihoods
    this never vanishes when no particle falls into a measurement's support. ``scale`` (R, M) multiplies 1/σ.
    """
    rows_total, particles, measurements = len(form), len(agent), len(distance)
    out = np.empty((rows_total, measurements))
    n = 1 + 2 * count
    residual, rows, basis = np.empty(5), np.empty((5, 3)), np.empty((2, 3))
    y, h = np.empty(5), np.empty(3)
    s, e = np.empty((5, 5)), np.empty(5)
    center = np.empty(6)
    reference_a, reference_t = np.empty(3), np.empty(3)
    for a in range(6):
        center[a] = 0.0
        for i in range(particles):
            center[a] += weight[i] * agent[i, a]
    norm = np.sqrt(center[4] ** 2 + center[5] ** 2) + 1e-12
    center[4] /= norm
    center[5] /= norm
    for r in range(rows_total):
        qx, qy, qz = mean[r, 0], mean[r, 1], mean[r, 2]
        _directions(form[r], center, qx, qy, qz, anchor, reference_a, reference_t)
        predicted, spread = np.zeros(5), np.zeros((5, 5))
        for i in range(particles):
            # The reference direction plays the measurement: its residual is minus the particle's offset from
            # it.
            used = linearize(
                form[r], count, agent, i, qx, qy, qz, anchor, 0.0, reference_a[0], reference_a[1], reference_a[2],
                reference_t[0], reference_t[1], reference_t[2], residual, rows,
            )  # fmt: skip
            for j in range(used):
                y[j] = -residual[j]
                for a in range(3):
                    h[a] = rows[j, 0] * cov[r, 0, a] + rows[j, 1] * cov[r, 1, a] + rows[j, 2] * cov[r, 2, a]
                predicted[j] += weight[i] * y[j]
                for k in range(j + 1):
                    mapped = h[0] * rows[k, 0] + h[1] * rows[k, 1] + h[2] * rows[k, 2]
                    spread[j, k] += weight[i] * (y[j] * y[k] + mapped)
        used = 1 + count if form[r] == VA else n
        for j in range(used):
            for k in range(j + 1):
                spread[j, k] -= predicted[j] * predicted[k]
        for m in range(measurements):
            # A feature at the origin of the mean particle's frame would do; only the directions are compared.
            _chord_to(reference_a, aoa[m], count, e, 1, basis)
            if used > 1 + count:
                _chord_to(reference_t, aod[m], count, e, 1 + count, basis)
            e[0] = distance[m] - predicted[0]
            for j in range(1, used):
                e[j] -= predicted[j]
            inverse = 1.0 / (scale[r, m] * scale[r, m])
            for j in range(used):
                for k in range(j + 1):
                    s[j, k] = spread[j, k] + covariance[m, j, k] * inverse
            out[r, m] = _cholesky_log_density(s, e, used)
    return out


@compiled
def _chord_to(reference, measured, count, out, start, basis):
    dot = reference[0] * measured[0] + reference[1] * measured[1] + reference[2] * measured[2]
    stretch = np.sqrt(2.0 / max(1.0 + dot, 1e-12))
    _tangents(reference[0], reference[1], reference[2], basis)
    for j in range(count):
        out[start + j] = stretch * (basis[j, 0] * measured[0] + basis[j, 1] * measured[1] + basis[j, 2] * measured[2])


@compiled
def _directions(form, agent, qx, qy, qz, anchor, arrival, departure):
    """Arrival in the receiver's frame and departure in the world frame of one feature."""
    ex, ey, ez = qx - agent[0], qy - agent[1], qz - agent[2]
    r = np.sqrt(ex * ex + ey * ey + ez * ez) + 1e-12
    ex, ey, ez = ex / r, ey / r, ez / r
    nx, ny, nz = qx - anchor[0], qy - anchor[1], qz - anchor[2]
    reach = np.sqrt(nx * nx + ny * ny + nz * nz) + 1e-12
    nx, ny, nz = nx / reach, ny / reach, nz / reach
    c, s = agent[4], agent[5]
    arrival[0], arrival[1], arrival[2] = c * ex + s * ey, -s * ex + c * ey, ez
    if form == LOS:
        departure[0], departure[1], departure[2] = -ex, -ey, -ez
    elif form == PS:
        departure[0], departure[1], departure[2] = nx, ny, nz
    else:
        en = ex * nx + ey * ny + ez * nz
        departure[0], departure[1], departure[2] = 2 * en * nx - ex, 2 * en * ny - ey, 2 * en * nz - ez
