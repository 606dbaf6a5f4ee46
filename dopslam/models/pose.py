"""Where a receiver is and how it moves, whatever motion model says so: the hinge between motion and measurement.

A measurement knows a pose and no motion model: its Jacobian by the state is that by the pose times the pose's by the state.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

POSE = ("x", "y", "heading", "bias")
"""The first entries of every receiver state [m, m, rad, m]; what follows is the motion model's."""

COLUMNS = 8
POSITION, VELOCITY, HEADING, BIAS = slice(0, 3), slice(3, 6), 6, 7
"""Columns of a Jacobian by a pose."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Poses, any number of them.

    Attributes
    ----------
    position, velocity : (..., 3) m and m/s, world frame
    heading : (...) rad, azimuth of the receiver's own x axis
    bias : (...) m, clock bias times c
    """

    position: Array
    velocity: Array
    heading: Array
    bias: Array

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the set of poses."""
        return np.shape(self.heading)


def positions(state: ArrayLike, height: float = 0.0) -> Array:
    """Positions (..., 3) of receiver states (..., n) in a plane of some height [m]."""
    state = np.asarray(state, dtype=float)
    return np.stack([state[..., 0], state[..., 1], np.full(state.shape[:-1], height)], axis=-1)


def pose_of(state: ArrayLike, velocity: Array, height: float = 0.0) -> Pose:
    """The pose of states (..., n) that move with velocities (..., 3)."""
    state = np.asarray(state, dtype=float)
    return Pose(positions(state, height), velocity, state[..., 2], state[..., 3])


def pose_jacobian_of(state: ArrayLike, by_velocity: Array) -> Array:
    """∂pose/∂s (..., 8, n) of states (..., n), from that of the velocity (..., 3, n)."""
    state = np.asarray(state, dtype=float)
    jacobian = np.zeros((*state.shape[:-1], COLUMNS, state.shape[-1]))
    jacobian[..., [0, 1, HEADING, BIAS], [0, 1, 2, 3]] = 1.0
    jacobian[..., VELOCITY, :] = by_velocity
    return jacobian


def ahead(heading: Array, speed: Array) -> tuple[Array, Array, Array]:
    """Velocity v·[cos ϖ, sin ϖ, 0] of eq. (12), and its derivatives by heading and speed; (..., 3) each."""
    cosine, sine, nothing = np.cos(heading), np.sin(heading), np.zeros(np.shape(heading))
    forward = np.stack([cosine, sine, nothing], axis=-1)
    speed = np.asarray(speed, dtype=float)[..., None]
    return speed * forward, speed * np.stack([-sine, cosine, nothing], axis=-1), forward
