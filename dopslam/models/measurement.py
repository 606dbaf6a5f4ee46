"""Measurement model h(x, s) of paper A, eqs. (3)-(12), and its analytic Jacobians (18)-(25), corrected.

One measurement is `z = (c·τ + bias [m], AOA azimuth, AOA elevation, AOD azimuth, AOD elevation [rad],
Doppler [m/s])`. AOA azimuth counts from the heading, AOD from the world's x axis; Doppler (a radial
velocity) is positive when approaching. What is special to a kind of landmark (BS = 0, VA = 1, SP = 2, SR = 3) is its path
(:mod:`dopslam.models.paths`); what the receiver does is its pose. All functions broadcast: K
landmarks for the Kalman filter, K × N particles elsewhere.

Departures from the paper, each with a test: delays are lengths (its eq. (4) is in seconds while Section V
has metres); arcsin of a ratio in (7), (10); the signs of (19); the divisor of (24), which for a VA is the
distance to the VA since the incidence point moves with the UE; the transposed Jacobian in (25).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dopslam.models import paths
from dopslam.models.pose import (
    BIAS,
    COLUMNS,
    HEADING,
    POSE,
    POSITION,
    VELOCITY,
    Pose,
    ahead,
    pose_jacobian_of,
    pose_of,
)

Array = NDArray[np.float64]

BS, VA, SP, SR = 0, 1, 2, 3
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
    free = ~paths.explains_departure(kind)[..., None] & np.isin(np.arange(covariance.shape[-1]), (3, 4))
    uniform = np.diag([0.0, 0.0, 0.0, 2 * np.pi, np.pi / 2, 0.0])[: covariance.shape[-1], : covariance.shape[-1]]
    return np.where(free[..., :, None] | free[..., None, :], uniform, covariance)


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("...i,...i->...", a, b)


def directions(azimuth: ArrayLike, elevation: ArrayLike) -> Array:
    """Unit vectors (..., 3) of azimuths and elevations (...)."""
    azimuth, elevation = np.broadcast_arrays(np.asarray(azimuth, float), np.asarray(elevation, float))
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)


def _angles(vector: Array) -> tuple[Array, Array]:
    azimuth = np.arctan2(vector[..., 1], vector[..., 0])
    return azimuth, np.arctan2(vector[..., 2], np.hypot(vector[..., 0], vector[..., 1]))


def _angle_gradients(vector: Array) -> tuple[Array, Array]:
    """Gradients of azimuth and elevation, (..., 3) each; at the poles the azimuth's is large but finite."""
    vector = np.where((vector != 0).any(axis=-1)[..., None], vector, [1.0, 0.0, 0.0])  # nothing explains a departure
    square = _dot(vector, vector)
    flat = np.maximum(vector[..., 0] ** 2 + vector[..., 1] ** 2, 1e-12 * square)
    azimuth = np.stack([-vector[..., 1], vector[..., 0], np.zeros_like(flat)], axis=-1) / flat[..., None]
    elevation = (
        np.stack([-vector[..., 0] * vector[..., 2], -vector[..., 1] * vector[..., 2], flat], axis=-1)
        / (square * np.sqrt(flat))[..., None]
    )
    return azimuth, elevation


def _posed(where: Pose | ArrayLike, speed: float, height: float) -> tuple[Pose, Array | None]:
    """The pose of a state that moves straight ahead, with its Jacobian (..., 8, n); a pose is what it is."""
    if isinstance(where, Pose):
        return where, None
    state = np.asarray(where, dtype=float)
    told = state.shape[-1] > len(POSE)
    velocity, by_heading, by_speed = ahead(state[..., 2], state[..., 4] if told else np.full(state.shape[:-1], speed))
    by_velocity = np.zeros((*state.shape[:-1], 3, state.shape[-1]))
    by_velocity[..., 2] = by_heading
    if told:
        by_velocity[..., 4] = by_speed
    return pose_of(state, velocity, height), pose_jacobian_of(state, by_velocity)


def measure(
    where: Pose | ArrayLike,
    landmark: ArrayLike,
    kind: ArrayLike,
    bs: ArrayLike,
    *,
    speed: float = 0.0,
    height: float = 0.0,
) -> Array:
    """Noise-free measurement h(x, s) of eqs. (3)-(12).

    Parameters
    ----------
    where : Pose, or (..., n) array
        Of the receiver (:meth:`~dopslam.models.motion.MotionModel.pose`). For short, an array `[x, y, heading, bias]` of
        one that moves straight ahead at `speed`, or at its fifth entry where it has one.
    landmark : (..., 3) array
        Landmark positions [m], world frame; ignored for kind BS.
    kind : (...) int array
    bs : (3,) array
    speed, height : float
        v [m/s] and height of the receiver's plane [m]; for an array only, a pose has both.

    Returns
    -------
    (..., 6) array [m, rad, rad, rad, rad, m/s], azimuths in [-π, π).
    """
    pose, _ = _posed(where, speed, height)
    arrival = paths.landmarks_of(bs, landmark, kind) - pose.position
    path = paths.paths(pose.position, bs, landmark, kind)
    aoa_az, aoa_el = _angles(arrival)
    aod_az, aod_el = _angles(path.departure)
    doppler = _dot(pose.velocity, arrival) / np.linalg.norm(arrival, axis=-1)
    rows = (path.length + pose.bias, wrap(aoa_az - pose.heading), aoa_el, wrap(aod_az), aod_el, doppler)
    return np.stack(rows, axis=-1)


def jacobians(
    where: Pose | ArrayLike,
    landmark: ArrayLike,
    kind: ArrayLike,
    bs: ArrayLike,
    *,
    speed: float = 0.0,
    height: float = 0.0,
) -> tuple[Array, Array]:
    """Jacobians of `measure` (same parameters) by the pose (..., 6, 8), or by the state (..., 6, n) where that is given as
    an array, and by the landmark (..., 6, 3)."""
    pose, by_array = _posed(where, speed, height)
    arrival = paths.landmarks_of(bs, landmark, kind) - pose.position
    shape = np.broadcast_shapes(arrival.shape[:-1], np.shape(kind))
    path, slope = paths.paths(pose.position, bs, landmark, kind), paths.slopes(pose.position, bs, landmark, kind)
    distance = np.linalg.norm(arrival, axis=-1)[..., None]
    q = arrival / distance
    velocity = np.broadcast_to(pose.velocity, q.shape)
    turning = (velocity - _dot(velocity, q)[..., None] * q) / distance  # (25), and minus (24) with the right divisor

    by_pose, by_landmark = np.zeros((*shape, 6, COLUMNS)), np.zeros((*shape, 6, 3))
    by_pose[..., 0, POSITION], by_landmark[..., 0, :] = slope.length_by_p, slope.length_by_x
    by_pose[..., 0, BIAS] = 1.0
    for row, gradient in zip((1, 2), _angle_gradients(arrival), strict=True):
        by_pose[..., row, POSITION], by_landmark[..., row, :] = -gradient, gradient
    by_pose[..., 1, HEADING] = -1.0
    for row, gradient in zip((3, 4), _angle_gradients(path.departure), strict=True):
        by_pose[..., row, POSITION] = np.einsum("...i,...ij->...j", gradient, slope.departure_by_p)
        by_landmark[..., row, :] = np.einsum("...i,...ij->...j", gradient, slope.departure_by_x)
    by_pose[..., 5, POSITION], by_pose[..., 5, VELOCITY], by_landmark[..., 5, :] = -turning, q, turning
    by_landmark[paths.known(kind, shape)] = 0.0
    return by_pose if by_array is None else by_pose @ by_array, by_landmark
