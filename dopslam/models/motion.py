"""Coordinated-turn motion of the user equipment, paper A eq. (1), and its Jacobian.

The state is `[x, y, heading, bias]` (m, m, rad, m) with speed and turn rate known, or
`[x, y, heading, bias, speed, turn rate]` with both unknown (the paper's future work); the length of the
state array decides. World frame, heading counted from the x axis; the clock bias is carried as a length c·b.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

KNOWN_MOTION = 4
UNKNOWN_MOTION = 6


@dataclass(frozen=True, slots=True)
class CoordinatedTurn:
    """Parameters of eq. (1).

    Attributes
    ----------
    interval : float
        Sampling interval T [s].
    process_noise : (n, n) array
        Covariance Q of one step; n = 4 (known speed and turn rate) or 6 (both in the state).
    speed, turn_rate : float
        v [m/s] and ω [rad/s]; used when n = 4, ignored when n = 6.
    """

    interval: float
    process_noise: Array
    speed: float = 0.0
    turn_rate: float = 0.0

    def __post_init__(self) -> None:
        n = self.process_noise.shape
        if n not in ((KNOWN_MOTION, KNOWN_MOTION), (UNKNOWN_MOTION, UNKNOWN_MOTION)):
            raise ValueError(f"CoordinatedTurn.process_noise has shape {n}; it must be (4, 4) or (6, 6)")
        if not self.interval > 0:
            raise ValueError(f"CoordinatedTurn.interval is {self.interval} s; it must be positive")

    @property
    def dimension(self) -> int:
        """Number of states, 4 or 6."""
        return self.process_noise.shape[0]


def paced(motion: CoordinatedTurn, pace: float) -> CoordinatedTurn:
    """The motion over `pace` periods: F over that time, and Q as of a walk, in proportion to it."""
    if pace == 1.0:
        return motion
    return replace(motion, interval=motion.interval * pace, process_noise=motion.process_noise * pace)


def _speed_and_rate(state: Array, motion: CoordinatedTurn) -> tuple[Array, Array]:
    if state.shape[-1] == UNKNOWN_MOTION:
        return state[..., 4], state[..., 5]
    shape = state.shape[:-1]
    return np.full(shape, motion.speed), np.full(shape, motion.turn_rate)


def propagate(state: Array, motion: CoordinatedTurn) -> Array:
    """Noise-free step f(s) of eq. (1).

    Written with the chord 2v/ω·sin(ωT/2) = vT·sinc(ωT/2), which has the straight line as its limit for ω → 0.

    Parameters
    ----------
    state : (..., n) array
    motion : CoordinatedTurn

    Returns
    -------
    (..., n) array
    """
    state = np.asarray(state, dtype=float)
    speed, rate = _speed_and_rate(state, motion)
    half = 0.5 * rate * motion.interval
    chord = speed * motion.interval * np.sinc(half / np.pi)
    direction = state[..., 2] + half
    result = state.copy()
    result[..., 0] += chord * np.cos(direction)
    result[..., 1] += chord * np.sin(direction)
    result[..., 2] += rate * motion.interval
    return result


def _sinc_slope(x: Array) -> Array:
    """d/dx of sin(x)/x, with its series near zero where the quotient loses all digits."""
    small = np.abs(x) < 1e-2
    safe = np.where(small, 1.0, x)
    return np.where(small, x * (-1 / 3 + x * x * (1 / 30 - x * x / 840)), (np.cos(safe) - np.sin(safe) / safe) / safe)


def transition_jacobian(state: Array, motion: CoordinatedTurn) -> Array:
    """Jacobian F = ∂f/∂s of eq. (1), shape (..., n, n)."""
    state = np.asarray(state, dtype=float)
    speed, rate = _speed_and_rate(state, motion)
    interval = motion.interval
    half = 0.5 * rate * interval
    sinc = np.sinc(half / np.pi)
    chord = speed * interval * sinc
    cosine, sine = np.cos(state[..., 2] + half), np.sin(state[..., 2] + half)
    n = state.shape[-1]
    jacobian = np.zeros((*state.shape, n))
    jacobian[..., np.arange(n), np.arange(n)] = 1.0
    jacobian[..., 0, 2] = -chord * sine
    jacobian[..., 1, 2] = chord * cosine
    if n == UNKNOWN_MOTION:
        chord_rate = speed * interval * _sinc_slope(half) * 0.5 * interval
        jacobian[..., 0, 4] = interval * sinc * cosine
        jacobian[..., 1, 4] = interval * sinc * sine
        jacobian[..., 0, 5] = chord_rate * cosine - chord * sine * 0.5 * interval
        jacobian[..., 1, 5] = chord_rate * sine + chord * cosine * 0.5 * interval
        jacobian[..., 2, 5] = interval
    return jacobian


def velocity(state: Array, motion: CoordinatedTurn) -> Array:
    """Velocity vector v·[cos heading, sin heading, 0], shape (..., 3), eq. (12)."""
    state = np.asarray(state, dtype=float)
    speed, _ = _speed_and_rate(state, motion)
    heading = state[..., 2]
    return np.stack([speed * np.cos(heading), speed * np.sin(heading), np.zeros_like(heading)], axis=-1)
