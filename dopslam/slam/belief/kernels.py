"""Compiled kernels of the Rao-Blackwellized filter.

Given an agent particle, a feature is Gaussian: its likelihood is a Kalman update with the rows of
:mod:`dopslam.slam.belief.geometry` linearized at (particle, feature mean). Rows are whitened by the inverse
Cholesky factor of the measurement's covariance and applied one at a time, so every update is a chain of
scalar ones whatever the number of rows; a planar problem is a spatial one whose covariances vanish along z.
The whitener is lower triangular in the order distance, AOA, AOD: its leading block whitens the marginal of
distance and AOA, which is what a ``VA`` without AOD uses. Forms are the integers of
:class:`~dopslam.slam.belief.records.Form`.

Arrays: ``agent`` (N, 6) = position, clock bias [m], cosine and sine of the heading; ``rows`` of (feature,
type) pairs are CSR lists of measurements: row r owns pairs ``first[r]:first[r + 1]``.
"""

from __future__ import annotations

import numpy as np

from dopslam.compute.compiled import compiled

_LOG_2PI = np.log(2 * np.pi)
LOS, VA, PS, VA_AOD = 0, 1, 2, 3


@compiled
def _tangents(x, y, z, basis):
    """Azimuth and elevation tangents at a unit vector into basis (2, 3)."""
    flat = np.sqrt(x * x + y * y)
    if flat < 1e-9:
        c, s = 1.0, 0.0
    else:
        c, s = x / flat, y / flat
    basis[0, 0], basis[0, 1], basis[0, 2] = -s, c, 0.0
    basis[1, 0], basis[1, 1], basis[1, 2] = -z * c, -z * s, flat


@compiled
def linearize(
    form, count, agent, i, qx, qy, qz, anchor, distance, zx, zy, zz, wx, wy, wz, residual, rows
):  # fmt: skip
    """Residual and gradient with respect to the feature of one (particle i, feature, measurement).

    (zx, zy, zz) is the measured AOA in the receiver's frame, turned by the particle's heading here; (wx, wy,
    wz) the measured AOD. Fills residual (n,) and rows (n, 3); returns the number of rows used, 1 + count for
    ``VA``, else 1 + 2·count. Scalars instead of array slices: a slice costs as much as the row.
    """
    ex, ey, ez = qx - agent[i, 0], qy - agent[i, 1], qz - agent[i, 2]
    r = np.sqrt(ex * ex + ey * ey + ez * ez) + 1e-12
    inverse = 1.0 / r
    ex, ey, ez = ex * inverse, ey * inverse, ez * inverse
    nx, ny, nz = qx - anchor[0], qy - anchor[1], qz - anchor[2]
    reach = np.sqrt(nx * nx + ny * ny + nz * nz) + 1e-12
    outward = 1.0 / reach
    nx, ny, nz = nx * outward, ny * outward, nz * outward
    c, s = agent[i, 4], agent[i, 5]
    zx, zy = c * zx - s * zy, s * zx + c * zy
    rows[0, 0], rows[0, 1], rows[0, 2] = ex, ey, ez
    residual[0] = distance - agent[i, 3] - r
    if form == PS:
        residual[0] -= reach
        rows[0, 0] += nx
        rows[0, 1] += ny
        rows[0, 2] += nz
    stretch = np.sqrt(2.0 / max(1.0 + zx * ex + zy * ey + zz * ez, 1e-12))
    flat = np.sqrt(ex * ex + ey * ey)
    pole = flat < 1e-9
    c = 1.0 if pole else ex / flat
    s = 0.0 if pole else ey / flat
    residual[1] = stretch * (c * zy - s * zx)
    rows[1, 0], rows[1, 1], rows[1, 2] = -s * inverse, c * inverse, 0.0
    if count == 2:
        residual[2] = stretch * (flat * zz - ez * (c * zx + s * zy))
        rows[2, 0], rows[2, 1], rows[2, 2] = -ez * c * inverse, -ez * s * inverse, flat * inverse
    if form == VA:
        return 1 + count
    en = ex * nx + ey * ny + ez * nz
    if form == LOS:
        tx, ty, tz = -ex, -ey, -ez
    elif form == PS:
        tx, ty, tz = nx, ny, nz
    else:
        tx, ty, tz = 2 * en * nx - ex, 2 * en * ny - ey, 2 * en * nz - ez
    stretch = np.sqrt(2.0 / max(1.0 + wx * tx + wy * ty + wz * tz, 1e-12))
    flat = np.sqrt(tx * tx + ty * ty)
    pole = flat < 1e-9
    c = 1.0 if pole else tx / flat
    s = 0.0 if pole else ty / flat
    for j in range(count):
        if j == 0:
            bx, by, bz = -s, c, 0.0
        else:
            bx, by, bz = -tz * c, -tz * s, flat
        k = 1 + count + j
        residual[k] = stretch * (bx * wx + by * wy + bz * wz)
        if form == PS:
            rows[k, 0], rows[k, 1], rows[k, 2] = bx * outward, by * outward, bz * outward
        elif form == VA_AOD:
            # bᵀ∂t/∂q with t = −e + 2(eᵀn)n: through e and through n, each projected onto its tangent plane.
            bn = bx * nx + by * ny + bz * nz
            ux, uy, uz = 2 * bn * nx - bx, 2 * bn * ny - by, 2 * bn * nz - bz
            ue = ux * ex + uy * ey + uz * ez
            vx, vy, vz = 2 * (bn * ex + en * bx), 2 * (bn * ey + en * by), 2 * (bn * ez + en * bz)
            vn = vx * nx + vy * ny + vz * nz
            rows[k, 0] = (ux - ue * ex) * inverse + (vx - vn * nx) * outward
            rows[k, 1] = (uy - ue * ey) * inverse + (vy - vn * ny) * outward
            rows[k, 2] = (uz - ue * ez) * inverse + (vz - vn * nz) * outward
        else:
            rows[k, 0], rows[k, 1], rows[k, 2] = 0.0, 0.0, 0.0
    return 1 + 2 * count


@compiled
def _log_constant(form, count, whitener, scale):
    """ln of the whitener's leading determinant over (2π)^{n/2} for the rows a form uses."""
    used = 1 + count if form == VA else 1 + 2 * count
    value = 0.0
    for j in range(used):
        value += np.log(whitener[j, j] * scale) - 0.5 * _LOG_2PI
    return value


@compiled
def _whiten(whitener, m, scale, used, residual, rows, white_residual, white_rows):
    """Whitened residual and rows."""
    for j in range(used):
        e, h0, h1, h2 = 0.0, 0.0, 0.0, 0.0
        for i in range(j + 1):
            w = whitener[m, j, i] * scale
            e += w * residual[i]
            h0 += w * rows[i, 0]
            h1 += w * rows[i, 1]
            h2 += w * rows[i, 2]
        white_residual[j], white_rows[j, 0], white_rows[j, 1], white_rows[j, 2] = e, h0, h1, h2


@compiled
def _reset(packed, cov, offset):
    for a in range(6):
        cov[a] = packed[a]
    offset[0], offset[1], offset[2] = 0.0, 0.0, 0.0


@compiled
def _update(used, residual, rows, mean, cov):
    """Scalar Kalman updates with unit noise; changes mean (3,) (an offset) and cov (6: xx xy xz yy yz zz) in
    place.

    Returns −½(χ² + ln det S).
    """
    chi, det = 0.0, 1.0
    for j in range(used):
        h0, h1, h2 = rows[j, 0], rows[j, 1], rows[j, 2]
        v0 = cov[0] * h0 + cov[1] * h1 + cov[2] * h2
        v1 = cov[1] * h0 + cov[3] * h1 + cov[4] * h2
        v2 = cov[2] * h0 + cov[4] * h1 + cov[5] * h2
        s = 1.0 + h0 * v0 + h1 * v1 + h2 * v2
        e = residual[j] - h0 * mean[0] - h1 * mean[1] - h2 * mean[2]
        g = e / s
        mean[0] += v0 * g
        mean[1] += v1 * g
        mean[2] += v2 * g
        i = 1.0 / s
        cov[0] -= v0 * v0 * i
        cov[1] -= v0 * v1 * i
        cov[2] -= v0 * v2 * i
        cov[3] -= v1 * v1 * i
        cov[4] -= v1 * v2 * i
        cov[5] -= v2 * v2 * i
        chi += e * g
        det *= s
    return -0.5 * (chi + np.log(det))


@compiled
def _pack(cov, packed):
    packed[0], packed[1], packed[2] = cov[0, 0], cov[0, 1], cov[0, 2]
    packed[3], packed[4], packed[5] = cov[1, 1], cov[1, 2], cov[2, 2]


@compiled
def row_likelihoods(
    agent, anchor, count, form, mean, cov, log_missed, first, pair, scale, log_weight,
    distance, aoa, aod, whitener, temper,
):  # fmt: skip
    """ln λ_r(i) = ln [missed_r + Σ_m weight_rm N(z_m | particle i, feature r)], (R, N).

    ``temper`` in (0, 1] inflates every measurement covariance by its inverse (guard g2).
    """
    rows_total, particles = len(form), len(agent)
    out = np.empty((rows_total, particles))
    residual, rows = np.empty(5), np.empty((5, 3))
    white_residual, white_rows = np.empty(5), np.empty((5, 3))
    packed, cov6, offset = np.empty(6), np.empty(6), np.empty(3)
    root = np.sqrt(temper)
    for r in range(rows_total):
        out[r, :] = log_missed[r]
        _pack(cov[r], packed)
        qx, qy, qz = mean[r, 0], mean[r, 1], mean[r, 2]
        for entry in range(first[r], first[r + 1]):
            m = pair[entry]
            factor = scale[entry] * root
            constant = log_weight[entry] + _log_constant(form[r], count, whitener[m], factor)
            for i in range(particles):
                used = linearize(
                    form[r], count, agent, i, qx, qy, qz, anchor, distance[m], aoa[m, 0], aoa[m, 1], aoa[m, 2],
                    aod[m, 0], aod[m, 1], aod[m, 2], residual, rows,
                )  # fmt: skip
                _whiten(whitener, m, factor, used, residual, rows, white_residual, white_rows)
                _reset(packed, cov6, offset)
                value = _update(used, white_residual, white_rows, offset, cov6)
                value += constant
                old = out[r, i]
                if value > old:
                    old, value = value, old
                if value - old > -40.0:
                    old += np.log1p(np.exp(value - old))
                out[r, i] = old
    return out


@compiled
def row_moments(
    agent, anchor, count, form, mean, cov, log_missed, first, pair, scale, log_weight,
    distance, aoa, aod, whitener, log_extrinsic, log_rows, reference,
):  # fmt: skip
    """Moment-matched update of every row over particles and associations.

    ``log_extrinsic`` (R, N) is ln of the particles' weights without the message of the row's own feature;
    ``log_rows`` (R, N) the result of :func:`row_likelihoods`; ``reference`` (R,) a common log scale, the
    largest sum of the two. Particles below e^−16 of it are left out.

    Returns
    -------
    mass : (R, 1 + longest list) shares of missed and of each pair, relative to exp(reference)
    new_mean (R, 3), new_cov (R, 3, 3)
    """
    rows_total, particles = len(form), len(agent)
    longest = 0
    for r in range(rows_total):
        longest = max(longest, first[r + 1] - first[r])
    mass = np.zeros((rows_total, 1 + longest))
    new_mean, new_cov = mean.copy(), cov.copy()
    residual, rows = np.empty(5), np.empty((5, 3))
    white_residual, white_rows = np.empty(5), np.empty((5, 3))
    packed, cov6, offset = np.empty(6), np.empty(6), np.empty(3)
    s1, s2 = np.empty(3), np.empty(6)
    for r in range(rows_total):
        _pack(cov[r], packed)
        qx, qy, qz = mean[r, 0], mean[r, 1], mean[r, 2]
        s0 = 0.0
        for i in range(particles):
            s0 += np.exp(log_extrinsic[r, i] + log_missed[r] - reference[r])
        mass[r, 0] = s0
        s1[:] = 0.0
        for a in range(6):
            s2[a] = s0 * packed[a]
        for entry in range(first[r], first[r + 1]):
            m = pair[entry]
            constant = log_weight[entry] + _log_constant(form[r], count, whitener[m], scale[entry]) - reference[r]
            for i in range(particles):
                if log_extrinsic[r, i] + log_rows[r, i] - reference[r] < -16.0:
                    continue
                used = linearize(
                    form[r], count, agent, i, qx, qy, qz, anchor, distance[m], aoa[m, 0], aoa[m, 1], aoa[m, 2],
                    aod[m, 0], aod[m, 1], aod[m, 2], residual, rows,
                )  # fmt: skip
                _whiten(whitener, m, scale[entry], used, residual, rows, white_residual, white_rows)
                _reset(packed, cov6, offset)
                value = _update(used, white_residual, white_rows, offset, cov6)
                value += constant + log_extrinsic[r, i]
                if value > -60.0:
                    w = np.exp(value)
                    mass[r, 1 + entry - first[r]] += w
                    s0 += w
                    for a in range(3):
                        s1[a] += w * offset[a]
                    s2[0] += w * (cov6[0] + offset[0] * offset[0])
                    s2[1] += w * (cov6[1] + offset[0] * offset[1])
                    s2[2] += w * (cov6[2] + offset[0] * offset[2])
                    s2[3] += w * (cov6[3] + offset[1] * offset[1])
                    s2[4] += w * (cov6[4] + offset[1] * offset[2])
                    s2[5] += w * (cov6[5] + offset[2] * offset[2])
        if s0 > 1e-290 and form[r] != LOS:
            o0, o1, o2 = s1[0] / s0, s1[1] / s0, s1[2] / s0
            new_mean[r, 0] += o0
            new_mean[r, 1] += o1
            new_mean[r, 2] += o2
            new_cov[r, 0, 0] = s2[0] / s0 - o0 * o0
            new_cov[r, 0, 1] = new_cov[r, 1, 0] = s2[1] / s0 - o0 * o1
            new_cov[r, 0, 2] = new_cov[r, 2, 0] = s2[2] / s0 - o0 * o2
            new_cov[r, 1, 1] = s2[3] / s0 - o1 * o1
            new_cov[r, 1, 2] = new_cov[r, 2, 1] = s2[4] / s0 - o1 * o2
            new_cov[r, 2, 2] = s2[5] / s0 - o2 * o2
    return mass, new_mean, new_cov
