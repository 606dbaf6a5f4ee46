"""New features of single measurements, given the agent: compiled.

Given the agent, a feature with a flat prior is where its measurement says: x | s ~ N(x̂ + G (s − ŝ), (BᵀR⁻¹B)⁻¹) with
G = −(BᵀR⁻¹B)⁻¹BᵀR⁻¹A, independent of every other feature. How likely the birth is comes from Laplace's method with the
agent's uncertainty in R̃ = R + A P Aᵀ: (2π)^{(axes − n)/2} |R̃|^{−1/2} |BᵀR̃⁻¹B|^{−1/2} exp(−χ²/2).
"""

from __future__ import annotations

import math

import numpy as np

from dopslam.compute.compiled import compiled, inlined
from dopslam.compute.linalg import cholesky, solve_lower
from dopslam.slam.belief.conditional.linear import POSE, observe
from dopslam.slam.belief.kernels import PS, VA, VA_AOD

_LOG_2PI = math.log(2.0 * math.pi)
_STEPS = 6
_CONVERGED = 1e-2
_LARGEST = 60.0  # χ² of the redundant rows above which no feature of this form explains the measurement


@compiled
def starting_point(form, pose, anchor, scan, m, x):
    """Closed form: a surface at the end of the arriving ray, a point on both rays (the mean of the two); False if the
    path is shorter than the direct one."""
    length = scan.distance[m] - pose[6]
    wx, wy, wz = pose[0] - anchor[0], pose[1] - anchor[1], pose[2] - anchor[2]
    slack = length * length - wx * wx - wy * wy - wz * wz
    if length <= 0.0 or slack <= 1e-9:
        return False
    c, s = math.cos(pose[7]), math.sin(pose[7])
    ex, ey, ez = c * scan.aoa[m, 0] - s * scan.aoa[m, 1], s * scan.aoa[m, 0] + c * scan.aoa[m, 1], scan.aoa[m, 2]
    if form != PS:
        x[0], x[1], x[2] = pose[0] + length * ex, pose[1] + length * ey, pose[2] + length * ez
        return True
    nx, ny, nz = scan.aod[m, 0], scan.aod[m, 1], scan.aod[m, 2]
    near = 0.5 * slack / max(length + wx * ex + wy * ey + wz * ez, 1e-9)
    far = 0.5 * slack / max(length - wx * nx - wy * ny - wz * nz, 1e-9)
    x[0] = 0.5 * (pose[0] + near * ex + anchor[0] + far * nx)
    x[1] = 0.5 * (pose[1] + near * ey + anchor[1] + far * ny)
    x[2] = 0.5 * (pose[2] + near * ez + anchor[2] + far * nz)
    return True


@inlined
def birth(form, pose, by_coordinate, covariance, axes, anchor, scan, m, x, gain, spread):
    """ln of the birth integral of one measurement and form, and x̂, G (3, d), (BᵀR⁻¹B)⁻¹ (3, 3) given the agent.

    With a covariance (d, d) of zeros what is found is the feature given the agent's mean exactly.
    """
    size, n = covariance.shape[0], scan.covariance.shape[1]
    if not starting_point(form, pose, anchor, scan, m, x):
        return -np.inf
    residual, by_pose, by_feature = np.empty(8), np.empty((8, POSE)), np.empty((8, 3))
    by_agent, factor = np.zeros((n, size)), np.empty((n, n))
    white = np.empty((n, axes + 1 + size))
    information, step = np.empty((axes, axes)), np.empty((axes, 1 + size))
    value, used = -np.inf, 0
    for iteration in range(_STEPS):
        used = observe(form, pose, x[0], x[1], x[2], anchor, scan, m, residual, True, by_pose, by_feature)
        for i in range(used):
            for j in range(size):
                by_agent[i, j] = 0.0
                for a in range(POSE):
                    by_agent[i, j] += by_pose[i, a] * by_coordinate[a, j]
        for i in range(used):
            for j in range(i + 1):
                total = scan.covariance[m, i, j]
                for a in range(size):
                    for b in range(size):
                        total += by_agent[i, a] * covariance[a, b] * by_agent[j, b]
                factor[i, j] = total
            for a in range(axes):
                white[i, a] = by_feature[i, a]
            white[i, axes] = residual[i]
            for j in range(size):
                white[i, axes + 1 + j] = by_agent[i, j]
        if not cholesky(factor, used):
            return -np.inf
        solve_lower(factor, used, white)
        chi, log_det = 0.0, 0.0
        for i in range(used):
            chi += white[i, axes] ** 2
            log_det -= math.log(factor[i, i])
        for a in range(axes):
            for b in range(axes):
                information[a, b] = 0.0
                for i in range(used):
                    information[a, b] += white[i, a] * white[i, b]
            for c in range(1 + size):
                step[a, c] = 0.0
                for i in range(used):
                    step[a, c] += white[i, a] * white[i, axes + c]
        if not cholesky(information, axes):
            return -np.inf
        solve_lower(information, axes, step)
        decrease = 0.0
        for a in range(axes):
            decrease += step[a, 0] ** 2
            log_det -= math.log(information[a, a])
        for a in range(axes - 1, -1, -1):  # back substitution
            for c in range(1 + size):
                for b in range(a + 1, axes):
                    step[a, c] -= information[b, a] * step[b, c]
                step[a, c] /= information[a, a]
        reach = math.sqrt((x[0] - pose[0]) ** 2 + (x[1] - pose[1]) ** 2 + (x[2] - pose[2]) ** 2)
        length = 0.0
        for a in range(axes):
            length += step[a, 0] ** 2
        shrink = min(1.0, 0.3 * reach / max(math.sqrt(length), 1e-12))
        for a in range(axes):
            x[a] += shrink * step[a, 0]
        value = 0.5 * (axes - used) * _LOG_2PI + log_det - 0.5 * (chi - decrease)
        if decrease < _CONVERGED:
            if chi - decrease > _LARGEST:
                return -np.inf
            break
        if iteration == _STEPS - 1 and chi - decrease > _LARGEST:
            return -np.inf
    if form == VA_AOD:  # the incidence point has to lie between receiver and surface
        ax, ay, az = anchor[0] - x[0], anchor[1] - x[1], anchor[2] - x[2]
        rx, ry, rz = pose[0] - x[0], pose[1] - x[1], pose[2] - x[2]
        along = ax * rx + ay * ry + az * rz
        if not (along > 0.0 and 0.5 * (ax * ax + ay * ay + az * az) < along):
            return -np.inf
    if form == VA:
        value -= math.log(2.0 * math.pi if scan.count == 1 else 4.0 * math.pi)
    inverse = np.zeros((axes, axes))
    for a in range(axes):
        inverse[a, a] = 1.0
    solve_lower(information, axes, inverse)
    for a in range(3):
        for j in range(size):
            gain[a, j] = -step[a, 1 + j] if a < axes else 0.0
        for b in range(3):
            spread[a, b] = 0.0
            if a < axes and b < axes:
                for k in range(axes):
                    spread[a, b] += inverse[k, a] * inverse[k, b]
    return value


@compiled
def births(forms, pose, by_coordinate, covariance, axes, anchor, scan):
    """:func:`birth` of every measurement and form: log integrals (M, T), x̂ (M, T, 3), G (M, T, 3, d), C (M, T, 3, 3)."""
    count, types, size = scan.distance.shape[0], forms.shape[0], covariance.shape[0]
    log_birth = np.full((count, types), -np.inf)
    x, spread = np.zeros((count, types, 3)), np.zeros((count, types, 3, 3))
    gain = np.zeros((count, types, 3, size))
    for m in range(count):
        for t in range(types):
            log_birth[m, t] = birth(
                forms[t], pose, by_coordinate, covariance, axes, anchor, scan, m, x[m, t], gain[m, t], spread[m, t]
            )
    return log_birth, x, gain, spread
