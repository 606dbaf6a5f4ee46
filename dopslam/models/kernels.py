"""Compiled twins of `motion` and `measurement` for the filters' hot loops; tests hold them equal to the
NumPy versions.

One landmark at a time, results written into arrays the caller owns. `site` is `(bs_x, bs_y, bs_z, height,
speed)`.
"""

from __future__ import annotations

import math

import numpy as np

from dopslam.compute.compiled import clear, compiled

BS, VA, SP, SR = 0, 1, 2, 3
FREE_AZIMUTH, FREE_ELEVATION = 2.0 * math.pi, 0.5 * math.pi  # variances whose densities at 0 are 1/2π and 1/π: uniform
POLE = 0.02  # cos(elevation) below which an azimuth is not used: it is undefined at the pole


@compiled
def wrap_angle(angle):
    """Angle in [-π, π)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@compiled
def subtract(measured, predicted, by_landmark, by_state, out):
    """out = measured - predicted, azimuths wrapped; rows without any Jacobian (an azimuth at a pole, a departure that
    nothing explains) give zero.
    """
    for i in range(out.shape[0]):
        difference = measured[i] - predicted[i]
        if i == 1 or (i > 2 and i < 5):
            difference = wrap_angle(difference) if i < 4 else difference
            used = False
            for j in range(3):
                used = used or by_landmark[i, j] != 0.0
            for j in range(by_state.shape[1]):
                used = used or by_state[i, j] != 0.0
            if not used:
                difference = 0.0
        out[i] = difference


@compiled
def noise_entry(noise, kind, i, j):
    """Entry (i, j) of the R that a landmark's kind sees: the departure of a second reflection may be any direction."""
    if kind == SR and (i == 3 or i == 4 or j == 3 or j == 4):
        return 0.0 if i != j else FREE_AZIMUTH if i == 3 else FREE_ELEVATION
    return noise[i, j]


@compiled
def _direction_rows(vx, vy, vz, row, z, gradient):
    """Azimuth and elevation of a vector into z[row], z[row + 1], their gradients into gradient[0],
    gradient[1].
    """
    flat2 = vx * vx + vy * vy
    square = flat2 + vz * vz
    flat = math.sqrt(flat2)
    z[row] = math.atan2(vy, vx)
    z[row + 1] = math.atan2(vz, flat)
    if flat2 > POLE * POLE * square:
        gradient[0, 0] = -vy / flat2
        gradient[0, 1] = vx / flat2
        gradient[1, 0] = -vx * vz / (square * flat)
        gradient[1, 1] = -vy * vz / (square * flat)
    else:  # azimuth dropped; the elevation's slope has its limit for a vertical arrival, zero in x and y
        gradient[0, 0] = 0.0
        gradient[0, 1] = 0.0
        gradient[1, 0] = 0.0
        gradient[1, 1] = 0.0
    gradient[0, 2] = 0.0
    gradient[1, 2] = flat / square


@compiled
def predict_measurement(state, landmark, kind, site, z):
    """h(x, s) of eqs. (3)-(12) into z[0:6]; returns False where a VA's incidence point does not lie on the
    path.
    """
    rx = landmark[0] - state[0]
    ry = landmark[1] - state[1]
    rz = landmark[2] - site[3]
    if kind == BS:
        rx = site[0] - state[0]
        ry = site[1] - state[1]
        rz = site[2] - site[3]
    distance = math.sqrt(rx * rx + ry * ry + rz * rz)
    speed = state[4] if state.shape[0] == 6 else site[4]
    length = distance
    valid = True
    if kind == SP:
        dx, dy, dz = landmark[0] - site[0], landmark[1] - site[1], landmark[2] - site[2]
        length += math.sqrt(dx * dx + dy * dy + dz * dz)
    elif kind == BS:
        dx, dy, dz = -rx, -ry, -rz
    elif kind == SR:
        dx, dy, dz = 1.0, 0.0, 0.0
    else:
        ax, ay, az = site[0] - landmark[0], site[1] - landmark[1], site[2] - landmark[2]
        projection = -(ax * rx + ay * ry + az * rz)
        if abs(projection) < 1e-12:
            projection = 1e-12
        t = 0.5 * (ax * ax + ay * ay + az * az) / projection
        valid = 0.0 < t < 1.0
        dx, dy, dz = -ax - t * rx, -ay - t * ry, -az - t * rz
    z[0] = length + state[3]
    z[1] = wrap_angle(math.atan2(ry, rx) - state[2])
    z[2] = math.atan2(rz, math.sqrt(rx * rx + ry * ry))
    z[3] = math.atan2(dy, dx)
    z[4] = math.atan2(dz, math.sqrt(dx * dx + dy * dy))
    if z.shape[0] > 5:
        z[5] = speed * (math.cos(state[2]) * rx + math.sin(state[2]) * ry) / distance
    return valid


@compiled
def linearize(state, landmark, kind, site, z, by_state, by_landmark):
    """h, A = ∂h/∂s and B = ∂h/∂x at one point; rows as in `measurement.jacobians`.

    Parameters
    ----------
    state : (4,) or (6,) array
    landmark : (3,) array (not read for a BS)
    kind : int
    site : 5-tuple
    z, by_state, by_landmark : (m,), (m, n), (m, 3) arrays, written; m = 5 leaves the Doppler row out

    Returns
    -------
    bool
        False where a VA's incidence point does not lie between VA and UE: there is no such path.
    """
    n = state.shape[0]
    rows = z.shape[0]
    clear(by_state)
    clear(by_landmark)
    gradient = np.empty((2, 3))
    rx = landmark[0] - state[0]
    ry = landmark[1] - state[1]
    rz = landmark[2] - site[3]
    if kind == BS:
        rx = site[0] - state[0]
        ry = site[1] - state[1]
        rz = site[2] - site[3]
    distance = math.sqrt(rx * rx + ry * ry + rz * rz)
    qx, qy, qz = rx / distance, ry / distance, rz / distance
    valid = True

    length = distance
    px = py = pz = 0.0
    ax = ay = az = 0.0
    t = 0.0
    projection = 1.0
    if kind == SP:
        dx, dy, dz = landmark[0] - site[0], landmark[1] - site[1], landmark[2] - site[2]
        reach = math.sqrt(dx * dx + dy * dy + dz * dz)
        length += reach
        if reach > 0.0:
            px, py, pz = dx / reach, dy / reach, dz / reach
    elif kind == BS:
        dx, dy, dz = -rx, -ry, -rz
    elif kind == SR:
        dx, dy, dz = 1.0, 0.0, 0.0
    else:  # the incidence point x_VA + t w, with w = -r
        ax, ay, az = site[0] - landmark[0], site[1] - landmark[1], site[2] - landmark[2]
        projection = -(ax * rx + ay * ry + az * rz)
        if abs(projection) < 1e-12:
            projection = 1e-12
        t = 0.5 * (ax * ax + ay * ay + az * az) / projection
        valid = 0.0 < t < 1.0
        dx, dy, dz = -ax - t * rx, -ay - t * ry, -az - t * rz

    z[0] = length + state[3]
    by_state[0, 0] = -qx
    by_state[0, 1] = -qy
    by_state[0, 3] = 1.0
    by_landmark[0, 0] = qx + px
    by_landmark[0, 1] = qy + py
    by_landmark[0, 2] = qz + pz

    _direction_rows(rx, ry, rz, 1, z, gradient)
    z[1] = wrap_angle(z[1] - state[2])
    for i in range(2):
        by_state[1 + i, 0] = -gradient[i, 0]
        by_state[1 + i, 1] = -gradient[i, 1]
        for j in range(3):
            by_landmark[1 + i, j] = gradient[i, j]
    if gradient[0, 0] != 0.0 or gradient[0, 1] != 0.0:
        by_state[1, 2] = -1.0

    _direction_rows(dx, dy, dz, 3, z, gradient)
    for i in range(2):
        gx, gy, gz = gradient[i, 0], gradient[i, 1], gradient[i, 2]
        if kind == BS:
            by_state[3 + i, 0] = gx
            by_state[3 + i, 1] = gy
        elif kind == SP:
            by_landmark[3 + i, 0] = gx
            by_landmark[3 + i, 1] = gy
            by_landmark[3 + i, 2] = gz
        elif kind == VA:
            along = -(gx * rx + gy * ry + gz * rz)
            s = t / projection
            by_state[3 + i, 0] = t * gx - s * along * ax
            by_state[3 + i, 1] = t * gy - s * along * ay
            by_landmark[3 + i, 0] = (1.0 - t) * gx + along * (-ax / projection + s * (ax - rx))
            by_landmark[3 + i, 1] = (1.0 - t) * gy + along * (-ay / projection + s * (ay - ry))
            by_landmark[3 + i, 2] = (1.0 - t) * gz + along * (-az / projection + s * (az - rz))

    if rows > 5:
        speed = state[4] if n == 6 else site[4]
        cosine, sine = math.cos(state[2]), math.sin(state[2])
        vx, vy = speed * cosine, speed * sine
        doppler = vx * qx + vy * qy
        z[5] = doppler
        by_landmark[5, 0] = (vx - doppler * qx) / distance
        by_landmark[5, 1] = (vy - doppler * qy) / distance
        by_landmark[5, 2] = -doppler * qz / distance
        by_state[5, 0] = -by_landmark[5, 0]
        by_state[5, 1] = -by_landmark[5, 1]
        by_state[5, 2] = -vy * qx + vx * qy
        if n == 6:
            by_state[5, 4] = cosine * qx + sine * qy
    if kind == BS:
        clear(by_landmark)
    return valid


@compiled
def propagate_state(state, interval, speed, rate, jacobian):
    """One step of eq. (1): returns f(s), writes F into `jacobian` (n, n)."""
    n = state.shape[0]
    if n == 6:
        speed, rate = state[4], state[5]
    half = 0.5 * rate * interval
    if abs(half) < 1e-2:
        square = half * half
        sinc = 1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0))
        slope = half * (-1.0 / 3.0 + square * (1.0 / 30.0 - square / 840.0))
    else:
        sinc = math.sin(half) / half
        slope = (math.cos(half) - sinc) / half
    cosine, sine = math.cos(state[2] + half), math.sin(state[2] + half)
    chord = speed * interval * sinc
    result = state.copy()
    result[0] += chord * cosine
    result[1] += chord * sine
    result[2] += rate * interval
    clear(jacobian)
    for i in range(n):
        jacobian[i, i] = 1.0
    jacobian[0, 2] = -chord * sine
    jacobian[1, 2] = chord * cosine
    if n == 6:
        chord_rate = speed * interval * slope * 0.5 * interval
        jacobian[0, 4] = interval * sinc * cosine
        jacobian[1, 4] = interval * sinc * sine
        jacobian[0, 5] = chord_rate * cosine - chord * sine * 0.5 * interval
        jacobian[1, 5] = chord_rate * sine + chord * cosine * 0.5 * interval
        jacobian[2, 5] = interval
    return result


@compiled
def cholesky(matrix, size):
    """Lower Cholesky factor of the leading (size, size) block in place; False if it is not positive
    definite.
    """
    for j in range(size):
        pivot = matrix[j, j]
        for k in range(j):
            pivot -= matrix[j, k] * matrix[j, k]
        if not pivot > 0.0:
            return False
        pivot = math.sqrt(pivot)
        matrix[j, j] = pivot
        for i in range(j + 1, size):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = value / pivot
    return True


@compiled
def factorize(matrix, size):
    """:func:`cholesky` of a covariance that rounding may have made indefinite: as little as it takes is added to its
    diagonal, up to a hundredth. False if that is not enough, or if it is not finite."""
    kept = matrix[:size, :size].copy()
    share = 0.0
    while share < 0.02:
        if cholesky(matrix, size):
            return True
        share = 1e-12 if share == 0.0 else 10.0 * share
        for i in range(size):
            for j in range(size):
                matrix[i, j] = kept[i, j]
            matrix[i, i] += share * abs(kept[i, i])
    return False


@compiled
def solve_lower(factor, size, rows):
    """Overwrite `rows` (size, columns) with L⁻¹ rows."""
    columns = rows.shape[1]
    for i in range(size):
        for k in range(i):
            scale = factor[i, k]
            if scale != 0.0:
                for j in range(columns):
                    rows[i, j] -= scale * rows[k, j]
        scale = 1.0 / factor[i, i]
        for j in range(columns):
            rows[i, j] *= scale


@compiled
def solve_lower_vector(factor, size, vector):
    """Overwrite `vector` (size,) with L⁻¹ vector and return its squared length."""
    total = 0.0
    for i in range(size):
        value = vector[i]
        for k in range(i):
            value -= factor[i, k] * vector[k]
        value /= factor[i, i]
        vector[i] = value
        total += value * value
    return total
