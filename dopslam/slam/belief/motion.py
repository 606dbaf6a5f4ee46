"""Motion of the agent's particles.

A particle is a row of eight numbers: position (3) [m], velocity (3) [m/s], clock bias b·c [m] and heading
[rad]. The array's azimuth is the direction of travel; :class:`ConstantVelocity` derives it from the velocity
as paper B does, :class:`SpeedHeading` carries it as a state of its own, which stays defined at standstill.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from dopslam.models.measurement import wrap

POSITION, VELOCITY, BIAS, HEADING = slice(0, 3), slice(3, 6), 6, 7
SIZE = 8


def particles(position, velocity, bias: ArrayLike = 0.0, heading: ArrayLike | None = None) -> np.ndarray:
    """(N, 8) particles; the heading is the direction of the velocity unless given."""
    position, velocity = np.atleast_2d(position), np.atleast_2d(velocity)
    result = np.zeros((max(len(position), len(velocity)), SIZE))
    result[:, POSITION], result[:, VELOCITY], result[:, BIAS] = position, velocity, bias
    result[:, HEADING] = np.arctan2(velocity[:, 1], velocity[:, 0]) if heading is None else heading
    return result


@dataclass(frozen=True, slots=True)
class ConstantVelocity:
    """x ← A x + B w of paper B, Section VI-A: v ← v + w, p ← p + T v + T w/2, heading atan2(v_y, v_x).

    Parameters
    ----------
    interval : T [s]
    speed_increment : standard deviation of w per step and horizontal axis [m/s]
    vertical_increment : the same for the vertical axis; 0 keeps the agent in its plane
    bias_walk : standard deviation of the clock bias per step [m]; 0 for synchronized clocks
    """

    interval: float
    speed_increment: float
    vertical_increment: float = 0.0
    bias_walk: float = 0.0

    NOISES: ClassVar[int] = 4  # standard normal numbers of a step

    def predict(self, rng: np.random.Generator, x: np.ndarray) -> np.ndarray:
        """Particles one step later, (N, 8)."""
        return self.moved(x, rng.standard_normal((len(x), self.NOISES)))

    def moved(self, x: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Particles one step later for given standard normal noise (N, 4)."""
        w = noise[:, :3] * np.array([self.speed_increment, self.speed_increment, self.vertical_increment])
        return particles(
            x[:, POSITION] + self.interval * (x[:, VELOCITY] + 0.5 * w),
            x[:, VELOCITY] + w,
            x[:, BIAS] + self.bias_walk * noise[:, 3],
        )

    def paced(self, pace: float) -> ConstantVelocity:
        """The motion over ``pace`` periods: walks grow with the square root of the time."""
        if pace == 1.0:
            return self
        root = float(np.sqrt(pace))
        return replace(
            self, interval=self.interval * pace, speed_increment=self.speed_increment * root,
            vertical_increment=self.vertical_increment * root, bias_walk=self.bias_walk * root,
        )  # fmt: skip

    def slopes(self, pose: np.ndarray) -> np.ndarray:
        """(8, 7) derivatives of a particle by its free coordinates."""
        by = np.eye(SIZE, 7)
        square = max(pose[3] ** 2 + pose[4] ** 2, 1e-24)
        by[HEADING, 3], by[HEADING, 4] = -pose[4] / square, pose[3] / square
        return by

    def coordinates(self, x: np.ndarray) -> np.ndarray:
        """(N, 7) free coordinates: position, velocity, bias."""
        return x[:, :HEADING]

    def rebuild(self, coordinates: np.ndarray) -> np.ndarray:
        """Particles of free coordinates."""
        return particles(coordinates[:, :3], coordinates[:, 3:6], coordinates[:, 6])


@dataclass(frozen=True, slots=True)
class SpeedHeading:
    """Speed and heading walk ("polar" motion), optionally with a known turn rate.

    Parameters
    ----------
    interval : T [s]
    speed_walk : standard deviation of the speed per step [m/s]
    heading_walk : standard deviation of the heading per step [rad]
    turn_rate : known turn rate ω [rad/s]
    position_walk : additional position noise per step and horizontal axis [m]
    bias_walk : standard deviation of the clock bias per step [m]
    """

    interval: float
    speed_walk: float
    heading_walk: float
    turn_rate: float = 0.0
    position_walk: float = 0.0
    bias_walk: float = 0.0

    NOISES: ClassVar[int] = 5  # standard normal numbers of a step

    def predict(self, rng: np.random.Generator, x: np.ndarray) -> np.ndarray:
        """Particles one step later, (N, 8); exact arc for the known turn rate."""
        return self.moved(x, rng.standard_normal((len(x), self.NOISES)))

    def moved(self, x: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Particles one step later for given standard normal noise (N, 5)."""
        speed, heading = self._polar(x)
        new_speed = speed + self.speed_walk * noise[:, 0]
        drift = self.heading_walk * noise[:, 1] + self.turn_rate * self.interval
        half = 0.5 * self.turn_rate * self.interval
        # The chord of an arc points along the middle heading and is shorter by sinc.
        middle = heading + 0.5 * drift
        chord = 0.5 * (speed + new_speed) * self.interval * np.sinc(half / np.pi)
        position = x[:, POSITION].copy()
        position[:, 0] += chord * np.cos(middle) + self.position_walk * noise[:, 2]
        position[:, 1] += chord * np.sin(middle) + self.position_walk * noise[:, 3]
        return self._particles(position, new_speed, heading + drift, x[:, BIAS] + self.bias_walk * noise[:, 4])

    def paced(self, pace: float) -> SpeedHeading:
        """The motion over ``pace`` periods: walks grow with the square root of the time."""
        if pace == 1.0:
            return self
        root = float(np.sqrt(pace))
        return replace(
            self, interval=self.interval * pace, speed_walk=self.speed_walk * root, heading_walk=self.heading_walk * root,
            position_walk=self.position_walk * root, bias_walk=self.bias_walk * root,
        )  # fmt: skip

    def slopes(self, pose: np.ndarray) -> np.ndarray:
        """(8, 6) derivatives of a particle by its free coordinates."""
        by = np.zeros((SIZE, 6))
        by[[0, 1, 2, HEADING, BIAS], [0, 1, 2, 4, 5]] = 1.0
        by[3, 3], by[4, 3] = math.cos(pose[HEADING]), math.sin(pose[HEADING])
        by[3, 4], by[4, 4] = -pose[4], pose[3]
        return by

    def coordinates(self, x: np.ndarray) -> np.ndarray:
        """(N, 6) free coordinates: position, speed, heading about its circular mean, bias."""
        speed, heading = self._polar(x)
        center = np.angle(np.mean(np.exp(1j * heading)))
        return np.column_stack([x[:, POSITION], speed, center + wrap(heading - center), x[:, BIAS]])

    def rebuild(self, coordinates: np.ndarray) -> np.ndarray:
        """Particles of free coordinates."""
        return self._particles(coordinates[:, :3], coordinates[:, 3], coordinates[:, 4], coordinates[:, 5])

    @staticmethod
    def _polar(x):
        heading = x[:, HEADING]
        return x[:, 3] * np.cos(heading) + x[:, 4] * np.sin(heading), heading

    @staticmethod
    def _particles(position, speed, heading, bias):
        velocity = np.column_stack([speed * np.cos(heading), speed * np.sin(heading), np.zeros(len(speed))])
        return particles(position, velocity, bias, wrap(heading))


Motion = ConstantVelocity | SpeedHeading
