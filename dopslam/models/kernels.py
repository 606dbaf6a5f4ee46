"""Compiled twins of `motion` and `measurement` for the filters' hot loops; tests hold them equal to the
NumPy versions.

One landmark at a time, results written into arrays the caller owns. `site` is `(bs_x, bs_y, bs_z, height, speed)`, which
makes the receiver move straight ahead as a coordinated turn does, at the speed of the site or at the fifth entry of its
state if it has one. With a sixth entry, an array (3, n + 1), its velocity is `site[5][:, :n] @ state + site[5][:, n]`: any
motion model, linearized where it was predicted.
"""

from __future__ import annotations

import math

import numpy as np

from dopslam.compute.compiled import clear, compiled
from dopslam.models.unmeasured import UNSEEN

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
def measured_rows(noise):
    """How many rows of a measurement tell anything (:mod:`dopslam.models.unmeasured`); the delay does, always."""
    count = 1
    for i in range(1, noise.shape[0]):
        if noise[i, i] < UNSEEN[i]:
            count += 1
    return count


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
def moving(state, site):
    """Velocity of a receiver whose motion model is linearized in the site."""
    n = state.shape[0]
    vx, vy, vz = site[5][0, n], site[5][1, n], site[5][2, n]
    for j in range(n):
        vx += site[5][0, j] * state[j]
        vy += site[5][1, j] * state[j]
        vz += site[5][2, j] * state[j]
    return vx, vy, vz


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
        if len(site) == 5:
            speed = state[4] if state.shape[0] > 4 else site[4]
            z[5] = speed * (math.cos(state[2]) * rx + math.sin(state[2]) * ry) / distance
        else:
            vx, vy, vz = moving(state, site)
            z[5] = (vx * rx + vy * ry + vz * rz) / distance
    return valid


@compiled
def log_spreading(kind, landmark, state, site):
    """Log of the geometric spreading loss: d² for BS and VA, d₁²·d₂² for SP."""
    if kind == 0:
        near = (site[0] - state[0]) ** 2 + (site[1] - state[1]) ** 2 + (site[2] - site[3]) ** 2
        return math.log(near)
    near = (landmark[0] - state[0]) ** 2 + (landmark[1] - state[1]) ** 2 + (landmark[2] - site[3]) ** 2
    loss = math.log(max(near, 1e-6))
    if kind == SP:
        far = (landmark[0] - site[0]) ** 2 + (landmark[1] - site[1]) ** 2 + (landmark[2] - site[2]) ** 2
        loss += math.log(max(far, 1e-6))
    return loss


@compiled
def starting_point(z, state, kind, site, x):
    """Closed-form landmark position of one measurement into `x`; False if its path is shorter than the
    direct one.

    VA, SR: x_U + D q. SP: on the ray of arrival and on the ray of departure, each where the path length fits;
    their mean.
    """
    length = z[0] - state[3]
    wx, wy, wz = site[0] - state[0], site[1] - state[1], site[2] - site[3]
    direct2 = wx * wx + wy * wy + wz * wz
    if not length * length > direct2 or length <= 0.0:
        return False
    azimuth = z[1] + state[2]
    flat = math.cos(z[2])
    qx, qy, qz = flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(z[2])
    if kind != SP:
        x[0] = state[0] + length * qx
        x[1] = state[1] + length * qy
        x[2] = site[3] + length * qz
        return True
    flat = math.cos(z[4])
    px, py, pz = flat * math.cos(z[3]), flat * math.sin(z[3]), math.sin(z[4])
    excess = length * length - direct2
    arrival = 0.5 * excess / (length - (wx * qx + wy * qy + wz * qz))
    departure = 0.5 * excess / (length + (wx * px + wy * py + wz * pz))
    x[0] = 0.5 * (state[0] + arrival * qx + site[0] + departure * px)
    x[1] = 0.5 * (state[1] + arrival * qy + site[1] + departure * py)
    x[2] = 0.5 * (site[3] + arrival * qz + site[2] + departure * pz)
    return True


@compiled
def linearize(state, landmark, kind, site, z, by_state, by_landmark):
    """h, A = ∂h/∂s and B = ∂h/∂x at one point; rows as in `measurement.jacobians`.

    Parameters
    ----------
    state : (n,) array
    landmark : (3,) array (not read for a BS)
    kind : int
    site : tuple, as the module says
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
        if len(site) == 5:
            speed = state[4] if n > 4 else site[4]
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
            if n > 4:
                by_state[5, 4] = cosine * qx + sine * qy
        else:
            vx, vy, vz = moving(state, site)
            doppler = vx * qx + vy * qy + vz * qz
            z[5] = doppler
            by_landmark[5, 0] = (vx - doppler * qx) / distance
            by_landmark[5, 1] = (vy - doppler * qy) / distance
            by_landmark[5, 2] = (vz - doppler * qz) / distance
            for j in range(n):
                by_state[5, j] = site[5][0, j] * qx + site[5][1, j] * qy + site[5][2, j] * qz
            by_state[5, 0] -= by_landmark[5, 0]
            by_state[5, 1] -= by_landmark[5, 1]
    if kind == BS:
        clear(by_landmark)
    return valid


@compiled
def propagate_state(state, interval, speed, rate, jacobian):
    """One step of eq. (1): returns f(s), writes F into `jacobian` (n, n)."""
    n = state.shape[0]
    if n > 4:
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
    if n > 4:
        chord_rate = speed * interval * slope * 0.5 * interval
        jacobian[0, 4] = interval * sinc * cosine
        jacobian[1, 4] = interval * sinc * sine
        jacobian[0, 5] = chord_rate * cosine - chord * sine * 0.5 * interval
        jacobian[1, 5] = chord_rate * sine + chord * cosine * 0.5 * interval
        jacobian[2, 5] = interval
    return result


@compiled
def move_state(state, site, interval, turn_rate, jacobian):
    """The predicted state, and F into `jacobian`: eq. (1) over `interval`, or what another motion model left as the seventh
    and eighth entry of the site."""
    if len(site) == 5:
        return propagate_state(state, interval, site[4], turn_rate, jacobian)
    for i in range(state.shape[0]):
        for j in range(state.shape[0]):
            jacobian[i, j] = site[7][i, j]
    return site[6].copy()
