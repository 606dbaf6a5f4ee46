"""Measurement model h(x, s) of paper A, eqs. (3)-(12), and its analytic Jacobians (18)-(25), corrected.

One measurement is `z = (c·τ + bias [m], AOA azimuth, AOA elevation, AOD azimuth, AOD elevation [rad],
Doppler [m/s])`. AOA azimuth counts from the heading, AOD from the world's x axis; Doppler (a radial
velocity) is positive when approaching. The kinds are BS = 0, VA = 1, SP = 2, SR = 3: a second reflection, whose
departure is unexplained (`seen_noise`). All functions broadcast: K
landmarks for the Kalman filter, K × N particles elsewhere.

Departures from the paper, each with a test: delays are lengths (its eq. (4) is in seconds while Section V
has metres); arcsin of a ratio in (7), (10); the signs of (19); the divisor of (24), which for a VA is the
distance to the VA since the incidence point moves with the UE; the transposed Jacobian in (25).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

BS, VA, SP, SR = 0, 1, 2, 3
DIMENSION = 6
AZIMUTHS = (1, 3)


def wrap(angle: ArrayLike) -> Array:
    """Angle in [-π, π)."""
    return (np.asarray(angle) + np.pi) % (2 * np.pi) - np.pi


def residual(measured: Array, predicted: Array) -> Array:
    """`measured - predicted` with both azimuths wrapped, shape (..., 5 or 6)."""
    difference = np.array(np.asarray(measured) - np.asarray(predicted))
    for row in AZIMUTHS:
        difference[..., row] = wrap(difference[..., row])
    return difference


def seen_noise(covariance: Array, kind: ArrayLike) -> Array:
    """The R (..., m, m) that landmarks of a kind (...) see: for a second reflection any departure is as likely.

    Its variances 2π and π/2 have the densities 1/2π and 1/π of a uniform azimuth and elevation at a residual of zero.
    """
    free = (np.asarray(kind) == SR)[..., None] & np.isin(np.arange(covariance.shape[-1]), (3, 4))
    uniform = np.diag([0.0, 0.0, 0.0, 2 * np.pi, np.pi / 2, 0.0])[: covariance.shape[-1], : covariance.shape[-1]]
    return np.where(free[..., :, None] | free[..., None, :], uniform, covariance)


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("...i,...i->...", a, b)


def incidence(ue: Array, va: Array, bs: Array) -> tuple[Array, Array, Array]:
    """Point where the path of a virtual anchor meets its wall.

    Returns
    -------
    point : (..., 3) incidence point x_VA + t·(x_U - x_VA)
    t : (...,) fraction of the way from the VA to the UE; the path exists for 0 < t < 1
    projection : (...,) (x_BS - x_VA)·(x_U - x_VA)
    """
    a, w = bs - va, ue - va
    projection = _dot(a, w)
    projection = np.where(np.abs(projection) < 1e-12, 1e-12, projection)
    t = 0.5 * _dot(a, a) / projection
    return va + t[..., None] * w, t, projection


def positions(state: Array, height: float = 0.0) -> Array:
    """UE positions (..., 3) of states (..., n)."""
    state = np.asarray(state, dtype=float)
    return np.stack([state[..., 0], state[..., 1], np.full(state.shape[:-1], height)], axis=-1)


def _angles(vector: Array) -> tuple[Array, Array]:
    azimuth = np.arctan2(vector[..., 1], vector[..., 0])
    return azimuth, np.arctan2(vector[..., 2], np.hypot(vector[..., 0], vector[..., 1]))


def _angle_gradients(vector: Array) -> tuple[Array, Array]:
    """Gradients of azimuth and elevation, (..., 3) each; at the poles the azimuth's is large but finite."""
    square = _dot(vector, vector)
    flat = np.maximum(vector[..., 0] ** 2 + vector[..., 1] ** 2, 1e-12 * square)
    azimuth = np.stack([-vector[..., 1], vector[..., 0], np.zeros_like(flat)], axis=-1) / flat[..., None]
    elevation = (
        np.stack([-vector[..., 0] * vector[..., 2], -vector[..., 1] * vector[..., 2], flat], axis=-1)
        / (square * np.sqrt(flat))[..., None]
    )
    return azimuth, elevation


def _broadcast(state: Array, landmark: Array, kind: ArrayLike, bs: Array, speed: float, height: float):
    state = np.asarray(state, dtype=float)
    shape = np.broadcast_shapes(state.shape[:-1], np.shape(landmark)[:-1], np.shape(kind))
    state = np.broadcast_to(state, (*shape, state.shape[-1]))
    kind = np.broadcast_to(np.asarray(kind), shape)
    # The landmark of kind BS is the BS itself, whatever the caller put there.
    landmark = np.where((kind == BS)[..., None], bs, np.broadcast_to(landmark, (*shape, 3)))
    ue = positions(state, height)
    speeds = state[..., 4] if state.shape[-1] == 6 else np.full(shape, float(speed))
    heading = state[..., 2]
    forward = np.stack([np.cos(heading), np.sin(heading), np.zeros(shape)], axis=-1)
    return state, landmark, kind, ue, speeds, forward


def _departure(ue: Array, landmark: Array, kind: Array, bs: Array) -> Array:
    is_va = (kind == VA)[..., None]
    anchor = np.where(is_va, landmark, bs + 1.0)  # any point that keeps `incidence` finite where it is not used
    point, _, _ = incidence(ue, anchor, bs)
    target = np.where((kind == BS)[..., None], ue, np.where(is_va, point, landmark))
    return np.where((kind == SR)[..., None], [1.0, 0.0, 0.0], target - bs)


def measure(
    state: Array, landmark: Array, kind: ArrayLike, bs: Array, *, speed: float = 0.0, height: float = 0.0
) -> Array:
    """Noise-free measurement h(x, s) of eqs. (3)-(12).

    Parameters
    ----------
    state : (..., 4) or (..., 6) array
        UE state; with six entries the speed is the fifth and `speed` is ignored.
    landmark : (..., 3) array
        Landmark positions [m], world frame; ignored for kind BS.
    kind : (...) int array
    bs : (3,) array
    speed : float
        Known speed v [m/s].
    height : float
        Known height of the UE's plane [m].

    Returns
    -------
    (..., 6) array [m, rad, rad, rad, rad, m/s], azimuths in [-π, π).
    """
    bs = np.asarray(bs, dtype=float)
    state, landmark, kind, ue, speeds, forward = _broadcast(state, landmark, kind, bs, speed, height)
    arrival = landmark - ue
    distance = np.linalg.norm(arrival, axis=-1)
    length = np.where(kind == SP, distance + np.linalg.norm(landmark - bs, axis=-1), distance)
    aoa_az, aoa_el = _angles(arrival)
    aod_az, aod_el = _angles(_departure(ue, landmark, kind, bs))
    doppler = speeds * _dot(forward, arrival) / distance
    return np.stack(
        [length + state[..., 3], wrap(aoa_az - state[..., 2]), aoa_el, wrap(aod_az), aod_el, doppler], axis=-1
    )


def jacobians(
    state: Array, landmark: Array, kind: ArrayLike, bs: Array, *, speed: float = 0.0, height: float = 0.0
) -> tuple[Array, Array]:
    """Jacobians A = ∂h/∂s (..., 6, n) and B = ∂h/∂x (..., 6, 3) of `measure` (same parameters)."""
    bs = np.asarray(bs, dtype=float)
    state, landmark, kind, ue, speeds, forward = _broadcast(state, landmark, kind, bs, speed, height)
    arrival = landmark - ue
    distance = np.linalg.norm(arrival, axis=-1)[..., None]
    q = arrival / distance
    from_bs = landmark - bs
    reach = np.linalg.norm(from_bs, axis=-1)[..., None]
    p = from_bs / np.where(reach > 0, reach, 1.0)
    is_bs, is_va, is_sp = ((kind == k)[..., None] for k in (BS, VA, SP))

    velocity = speeds[..., None] * forward
    sideways = np.stack([-velocity[..., 1], velocity[..., 0], np.zeros_like(speeds)], axis=-1)
    doppler = _dot(velocity, q)[..., None]
    slope = (velocity - doppler * q) / distance  # (25), and minus (24) with the right divisor

    departure = _departure(ue, landmark, kind, bs)
    anchor = np.where(is_va, landmark, bs + 1.0)
    a, w = bs - anchor, ue - anchor
    _, t, projection = incidence(ue, anchor, bs)
    t, projection = t[..., None], projection[..., None]

    shape = kind.shape
    by_state = np.zeros((*shape, 6, state.shape[-1]))
    by_landmark = np.zeros((*shape, 6, 3))
    by_state[..., 0, :2] = -q[..., :2]
    by_state[..., 0, 3] = 1.0
    by_landmark[..., 0, :] = q + np.where(is_sp, p, 0.0)
    for row, gradient in zip((1, 2), _angle_gradients(arrival), strict=True):
        by_state[..., row, :2] = -gradient[..., :2]
        by_landmark[..., row, :] = gradient
    by_state[..., 1, 2] = -1.0
    for row, gradient in zip((3, 4), _angle_gradients(departure), strict=True):
        along = _dot(gradient, w)[..., None]
        moved_ue = t * gradient - (t / projection) * along * a
        moved_va = (1 - t) * gradient + along * (-a / projection + (t / projection) * (a + w))
        by_ue = np.where(is_bs, gradient, np.where(is_va, moved_ue, 0.0))
        by_state[..., row, :2] = by_ue[..., :2]
        by_landmark[..., row, :] = np.where(is_sp, gradient, np.where(is_va, moved_va, 0.0))
    by_state[..., 5, :2] = -slope[..., :2]
    by_state[..., 5, 2] = _dot(sideways, q)
    if state.shape[-1] == 6:
        by_state[..., 5, 4] = _dot(forward, q)
    by_landmark[..., 5, :] = slope
    by_landmark[is_bs[..., 0]] = 0.0
    return by_state, by_landmark
