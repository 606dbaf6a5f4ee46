"""Clocks whose rate is off: a motion model with the drift of the clock as one more state."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dopslam.models.motion import Motion, MotionModel
from dopslam.models.pose import Pose
from dopslam.records import Track

Array = NDArray[np.float64]

BIAS = 3  # entry of the state


@dataclass(frozen=True, slots=True)
class DriftingClock(Motion):
    """A motion with a two-state clock: the bias grows by a drift that walks.

    The usual two-state model (Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation,
    sec. 12.3), bias and drift as lengths: the drift is an integrated white noise, the bias integrates the drift beside
    the walk that the motion's own process noise has. Doppler is that of motion alone: receivers lock their carrier to what
    they receive, so that the drift is in the delays only.

    Attributes
    ----------
    motion : any motion model; the drift [m/s] is appended to its states
    spread : m/s; prior standard deviation of the drift, about none
    walk : m/s; standard deviation of the drift's change per step
    """

    motion: MotionModel
    spread: float
    walk: float

    @property
    def names(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Of the states."""
        return (*self.motion.names, "clock_drift")

    @property
    def interval(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Time of one step [s]."""
        return self.motion.interval

    @property
    def doppler(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Whether the velocity is to be believed."""
        return self.motion.doppler

    @property
    def process_noise(self) -> Array:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Q (n, n) of one step."""
        n, interval = self.dimension, self.interval
        noise = np.zeros((n, n))
        noise[:-1, :-1] = self.motion.process_noise
        noise[BIAS, BIAS] += self.walk**2 * interval**2 / 3
        noise[BIAS, -1] = noise[-1, BIAS] = self.walk**2 * interval / 2
        noise[-1, -1] = self.walk**2
        return noise

    def step(self, state: Array) -> Array:
        """Noise-free state (..., n) one step later."""
        state = np.asarray(state, dtype=float)
        moved = np.concatenate([self.motion.step(state[..., :-1]), state[..., -1:]], axis=-1)
        moved[..., BIAS] += self.interval * state[..., -1]
        return moved

    def jacobian(self, state: Array) -> Array:
        """∂step/∂s (..., n, n)."""
        state = np.asarray(state, dtype=float)
        jacobian = np.zeros((*state.shape, self.dimension))
        jacobian[..., :-1, :-1] = self.motion.jacobian(state[..., :-1])
        jacobian[..., BIAS, -1] = self.interval
        jacobian[..., -1, -1] = 1.0
        return jacobian

    def pose(self, state: Array, height: float = 0.0) -> Pose:
        """The pose that is measured."""
        return self.motion.pose(np.asarray(state, dtype=float)[..., :-1], height)

    def pose_jacobian(self, state: Array) -> Array:
        """∂pose/∂s (..., 8, n)."""
        inner = self.motion.pose_jacobian(np.asarray(state, dtype=float)[..., :-1])
        return np.concatenate([inner, np.zeros((*inner.shape[:-1], 1))], axis=-1)

    def paced(self, pace: float) -> DriftingClock:
        """The motion over ``pace`` steps: the drift walks on with the root of the time."""
        return (
            self
            if pace == 1.0
            else replace(self, motion=self.motion.paced(pace), walk=self.walk * float(np.sqrt(pace)))
        )

    def prior(self, mean: Array, covariance: Array) -> tuple[Array, Array]:
        """The prior of the motion, and no drift but for its spread."""
        mean, covariance = self.motion.prior(mean, covariance)
        wider = np.zeros((len(mean) + 1, len(mean) + 1))
        wider[:-1, :-1], wider[-1, -1] = covariance, self.spread**2
        return np.append(mean, 0.0), wider

    def truth(self, track: Track) -> tuple[Array, Array]:
        """States of a track and its start, the drift from the bias of successive steps."""
        states, start = self.motion.truth(track)
        before = np.append(start[BIAS], track.bias[:-1])
        elapsed = np.diff(track.time, prepend=track.time[0] - self.interval)
        drift = (track.bias - before) / elapsed
        return np.column_stack([states, drift]), np.append(start, drift[0])
