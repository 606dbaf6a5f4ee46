"""Compiled residuals and Jacobians of every likelihood form, with respect to the agent's pose and to the feature.

A pose has the layout of a particle (:mod:`dopslam.slam.belief.motion`): position (3) [m], velocity (3) [m/s], clock
bias [m], heading [rad]. Rows, in this order: distance [m]; radial velocity [m/s] where Doppler is used; arrival tangents;
departure tangents, azimuth before elevation. A form without departure (``VA``) uses the leading rows. Directions are
compared by chords, as in :mod:`dopslam.slam.belief.geometry`: nothing is wrapped and no pole excluded.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dopslam.compute.compiled import compiled
from dopslam.slam.belief.kernels import LOS, PS, VA
from dopslam.slam.belief.records import Scan

POSE = 8  # entries of a pose


class Measured(NamedTuple):
    """A scan as compiled code reads it.

    Attributes
    ----------
    distance, rate : (M,) m, m/s
    aoa : (M, 3) in the receiver's frame; aod : (M, 3) in the world's
    covariance : (M, n, n) in the order of rows
    count : tangents per direction, 1 in the plane; doppler : 1 with the row of radial velocity, else 0
    """

    distance: NDArray[np.float64]
    rate: NDArray[np.float64]
    aoa: NDArray[np.float64]
    aod: NDArray[np.float64]
    covariance: NDArray[np.float64]
    count: int
    doppler: int


def measured(scan: Scan, doppler: bool) -> Measured:
    """The rows of a scan that the filter uses, Doppler second."""
    count = scan.tangents
    used = doppler and scan.radial_velocity is not None
    order = [0, *([1 + 2 * count] if used else []), *range(1, 1 + 2 * count)]
    return Measured(
        np.ascontiguousarray(scan.distance, float),
        np.ascontiguousarray(scan.radial_velocity, float) if used else np.zeros(len(scan)),
        np.ascontiguousarray(scan.aoa, float),
        np.ascontiguousarray(scan.aod, float),
        np.ascontiguousarray(scan.covariance[:, order][:, :, order]),
        count,
        int(used),
    )


@compiled
def rows_used(form, count, doppler):
    """Number of rows that a form explains."""
    return 1 + doppler + count if form == VA else 1 + doppler + 2 * count


@compiled
def observe(form, pose, qx, qy, qz, anchor, scan, m, residual, slopes, by_pose, by_feature):
    """Residual of measurement m and, if ``slopes``, ∂h/∂pose (n, 8) and ∂h/∂q (n, 3); returns the rows used.

    The slopes do not depend on the measurement. ``anchor`` is the base station's position; for ``LOS`` it is (qx, qy,
    qz) as well and by_feature is zero.
    """
    count, doppler = scan.count, scan.doppler
    used = rows_used(form, count, doppler)
    ex, ey, ez = qx - pose[0], qy - pose[1], qz - pose[2]
    r = math.sqrt(ex * ex + ey * ey + ez * ez) + 1e-12
    near = 1.0 / r
    ex, ey, ez = ex * near, ey * near, ez * near
    nx, ny, nz = qx - anchor[0], qy - anchor[1], qz - anchor[2]
    reach = math.sqrt(nx * nx + ny * ny + nz * nz) + 1e-12
    far = 1.0 / reach
    nx, ny, nz = nx * far, ny * far, nz * far
    if slopes:
        for i in range(used):
            for a in range(POSE):
                by_pose[i, a] = 0.0
            for a in range(3):
                by_feature[i, a] = 0.0
        by_pose[0, 0], by_pose[0, 1], by_pose[0, 2], by_pose[0, 6] = -ex, -ey, -ez, 1.0
        by_feature[0, 0], by_feature[0, 1], by_feature[0, 2] = ex, ey, ez
    residual[0] = scan.distance[m] - pose[6] - r
    if form == PS:
        residual[0] -= reach
        if slopes:
            by_feature[0, 0] += nx
            by_feature[0, 1] += ny
            by_feature[0, 2] += nz
    if doppler == 1:
        along = pose[3] * ex + pose[4] * ey + pose[5] * ez
        residual[1] = scan.rate[m] - along
        if slopes:
            gx, gy, gz = (pose[3] - along * ex) * near, (pose[4] - along * ey) * near, (pose[5] - along * ez) * near
            by_feature[1, 0], by_feature[1, 1], by_feature[1, 2] = gx, gy, gz
            by_pose[1, 0], by_pose[1, 1], by_pose[1, 2] = -gx, -gy, -gz
            by_pose[1, 3], by_pose[1, 4], by_pose[1, 5] = ex, ey, ez
    cosine, sine = math.cos(pose[7]), math.sin(pose[7])
    bx, by, zz = scan.aoa[m, 0], scan.aoa[m, 1], scan.aoa[m, 2]
    zx, zy = cosine * bx - sine * by, sine * bx + cosine * by
    stretch = math.sqrt(2.0 / max(1.0 + zx * ex + zy * ey + zz * ez, 1e-12))
    flat = math.sqrt(ex * ex + ey * ey)
    c = 1.0 if flat < 1e-9 else ex / flat
    s = 0.0 if flat < 1e-9 else ey / flat
    a = 1 + doppler
    residual[a] = stretch * (c * zy - s * zx)
    if slopes:
        by_feature[a, 0], by_feature[a, 1] = -s * near, c * near
        by_pose[a, 7] = -flat
    if count == 2:
        residual[a + 1] = stretch * (flat * zz - ez * (c * zx + s * zy))
        if slopes:
            by_feature[a + 1, 0], by_feature[a + 1, 1], by_feature[a + 1, 2] = (
                -ez * c * near,
                -ez * s * near,
                flat * near,
            )
    if slopes:
        for i in range(a, a + count):
            for k in range(3):
                by_pose[i, k] = -by_feature[i, k]
    if form != VA:
        if form == LOS:
            tx, ty, tz = -ex, -ey, -ez
        elif form == PS:
            tx, ty, tz = nx, ny, nz
        else:
            en = ex * nx + ey * ny + ez * nz
            tx, ty, tz = 2 * en * nx - ex, 2 * en * ny - ey, 2 * en * nz - ez
        wx, wy, wz = scan.aod[m, 0], scan.aod[m, 1], scan.aod[m, 2]
        stretch = math.sqrt(2.0 / max(1.0 + wx * tx + wy * ty + wz * tz, 1e-12))
        flat = math.sqrt(tx * tx + ty * ty)
        c = 1.0 if flat < 1e-9 else tx / flat
        s = 0.0 if flat < 1e-9 else ty / flat
        for j in range(count):
            if j == 0:
                ux, uy, uz = -s, c, 0.0
            else:
                ux, uy, uz = -tz * c, -tz * s, flat
            k = a + count + j
            residual[k] = stretch * (ux * wx + uy * wy + uz * wz)
            if not slopes:
                continue
            if form == LOS:
                by_pose[k, 0], by_pose[k, 1], by_pose[k, 2] = ux * near, uy * near, uz * near
            elif form == PS:
                by_feature[k, 0], by_feature[k, 1], by_feature[k, 2] = ux * far, uy * far, uz * far
            else:  # uᵀ∂t with t = −e + 2(eᵀn)n: through e and through n, each projected onto its tangent plane
                un = ux * nx + uy * ny + uz * nz
                fx, fy, fz = 2 * un * nx - ux, 2 * un * ny - uy, 2 * un * nz - uz
                fe = fx * ex + fy * ey + fz * ez
                fx, fy, fz = (fx - fe * ex) * near, (fy - fe * ey) * near, (fz - fe * ez) * near
                vx, vy, vz = 2 * (un * ex + en * ux), 2 * (un * ey + en * uy), 2 * (un * ez + en * uz)
                vn = vx * nx + vy * ny + vz * nz
                by_feature[k, 0] = fx + (vx - vn * nx) * far
                by_feature[k, 1] = fy + (vy - vn * ny) * far
                by_feature[k, 2] = fz + (vz - vn * nz) * far
                by_pose[k, 0], by_pose[k, 1], by_pose[k, 2] = -fx, -fy, -fz
    if form == LOS and slopes:
        for i in range(used):
            for k in range(3):
                by_feature[i, k] = 0.0
    return used
