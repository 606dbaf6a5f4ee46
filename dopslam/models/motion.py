"""How a receiver moves: the contract of a motion model, and the coordinated turn of paper A.

Every state begins with the pose `[x, y, heading, bias]` (m, m, rad, m; world frame, heading counted from the x axis, the
clock bias carried as a length c·b). What follows is the model's own: speed and turn rate, a velocity, accelerations. A
model of one's own is a class in a file::

    @dataclass(frozen=True, kw_only=True)
    class Drift(Motion):
        names = (*POSE, "vx", "vy")
        interval: float
        pose_noise: np.ndarray

        @property
        def process_noise(self): ...
        def step(self, state): ...
        def velocity(self, state): ...

and is chosen by ``filter.motion = "file.py:Drift"``. It is made with those of the quantities of :class:`Told` that it has
as parameters, and the keys of ``filter.motion_options``. Jacobians are central differences unless it gives its own.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from dopslam.errors import ConfigError
from dopslam.filters import MOTIONS
from dopslam.models.pose import POSE, Pose, ahead, pose_jacobian_of, pose_of
from dopslam.records import Track

Array = NDArray[np.float64]

TURN = (*POSE, "speed", "turn_rate")  # states of a coordinated turn; the last two where they are not known
KNOWN_MOTION = 4
UNKNOWN_MOTION = 6
STEP = 1e-6  # of central differences, relative to 1 + |entry|


@runtime_checkable
class MotionModel(Protocol):
    """What filters, bounds and simulation know of a motion; everything broadcasts over states (..., n).

    Attributes
    ----------
    names : of the n states, the first four those of :data:`~dopslam.models.pose.POSE`
    interval : s; time of one step
    process_noise : (n, n); Q of one step
    doppler : whether its velocity is to be believed, so that Doppler says something
    """

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def interval(self) -> float: ...
    @property
    def process_noise(self) -> Array: ...
    @property
    def doppler(self) -> bool: ...
    @property
    def dimension(self) -> int: ...

    def step(self, state: Array) -> Array:
        """Noise-free state (..., n) one step later."""
        ...

    def jacobian(self, state: Array) -> Array:
        """∂step/∂s (..., n, n)."""
        ...

    def pose(self, state: Array, height: float = 0.0) -> Pose:
        """The pose that is measured, in a plane of some height [m]."""
        ...

    def pose_jacobian(self, state: Array) -> Array:
        """∂pose/∂s (..., 8, n)."""
        ...

    def paced(self, pace: float) -> MotionModel:
        """The motion over another time, in steps."""
        ...

    def prior(self, mean: Array, covariance: Array) -> tuple[Array, Array]:
        """Mean (n,) and covariance (n, n) of the start, from those of its pose (4,), (4, 4)."""
        ...

    def truth(self, track: Track) -> tuple[Array, Array]:
        """States (K, n) of a true track and its start (n,), for bounds."""
        ...


class Motion:
    """What most motion models have in common; a model of one's own derives from it and gives the rest."""

    __slots__ = ()

    names = POSE
    doppler = True
    interval: float
    process_noise: Array

    @property
    def dimension(self) -> int:
        """Number of states n."""
        return len(self.names)

    def step(self, state: Array) -> Array:
        """Noise-free state (..., n) one step later."""
        raise self._lacks("step")

    def velocity(self, state: Array) -> Array:
        """Velocity (..., 3) [m/s] of a state."""
        raise self._lacks("velocity")

    def _lacks(self, method: str) -> ConfigError:
        return ConfigError(f"filter.motion: {type(self).__name__} has no {method}(state); every motion model needs one")

    def jacobian(self, state: Array) -> Array:
        """∂step/∂s (..., n, n), by central differences."""
        return differences(self.step, state)

    def pose(self, state: Array, height: float = 0.0) -> Pose:
        """The pose that is measured."""
        return pose_of(state, self.velocity(state), height)

    def pose_jacobian(self, state: Array) -> Array:
        """∂pose/∂s (..., 8, n), the velocity's part by central differences."""
        return pose_jacobian_of(state, differences(self.velocity, state))

    def paced(self, pace: float) -> Any:
        """The same over `pace` steps; right where the process noise is made from the interval."""
        return self if pace == 1.0 else replace(self, interval=self.interval * pace)  # pyright: ignore

    def prior(self, mean: Array, covariance: Array) -> tuple[Array, Array]:
        """Prior of the pose; a model with more states says what it knows of them."""
        if self.dimension == len(POSE):
            return mean, covariance
        raise ConfigError(
            f"motion model {type(self).__name__}: no prior of {', '.join(self.names[len(POSE) :])}; give it a method 'prior'"
        )

    def truth(self, track: Track) -> tuple[Array, Array]:
        """True states; a model with more than the pose says where they come from."""
        if self.dimension == len(POSE):
            return track.state, np.asarray(track.start, float)
        raise ConfigError(
            f"motion model {type(self).__name__}: no true {', '.join(self.names[len(POSE) :])} of a track, so that nothing "
            "bounds it; give it a method 'truth'"
        )


def differences(function: Callable[[Array], Array], state: Array) -> Array:
    """Jacobian (..., m, n) of a function of states (..., n) → (..., m), by central differences."""
    state = np.asarray(state, dtype=float)
    size = STEP * (1.0 + np.abs(state))
    columns = []
    for i in range(state.shape[-1]):
        move = np.zeros_like(state)
        move[..., i] = size[..., i]
        high, low = state + move, state - move
        columns.append((function(high) - function(low)) / (high - low)[..., i : i + 1])
    return np.stack(columns, axis=-1)


@dataclass(frozen=True, slots=True)
class CoordinatedTurn(Motion):
    """Coordinated turn of paper A, eq. (1), speed and turn rate known or in the state.

    Attributes
    ----------
    interval : float
        Sampling interval T [s].
    process_noise : (n, n) array
        Covariance Q of one step; n = 4 (known speed and turn rate) or 6 (both in the state).
    speed, turn_rate : float
        v [m/s] and ω [rad/s]; known when n = 4, their prior means when n = 6.
    spread : (speed, turn rate)
        Prior standard deviations of both, when n = 6.
    """

    interval: float
    process_noise: Array
    speed: float = 0.0
    turn_rate: float = 0.0
    spread: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        n = self.process_noise.shape
        if n not in ((KNOWN_MOTION, KNOWN_MOTION), (UNKNOWN_MOTION, UNKNOWN_MOTION)):
            raise ValueError(f"CoordinatedTurn.process_noise has shape {n}; it must be (4, 4) or (6, 6)")
        if not self.interval > 0:
            raise ValueError(f"CoordinatedTurn.interval is {self.interval} s; it must be positive")

    @property
    def names(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Of the states."""
        return TURN[: self.process_noise.shape[0]]

    def _speed_and_rate(self, state: Array) -> tuple[Array, Array]:
        if self.dimension == UNKNOWN_MOTION:
            return state[..., 4], state[..., 5]
        shape = state.shape[:-1]
        return np.full(shape, self.speed), np.full(shape, self.turn_rate)

    def step(self, state: Array) -> Array:
        """Noise-free step f(s) of eq. (1).

        Written with the chord 2v/ω·sin(ωT/2) = vT·sinc(ωT/2), which has the straight line as its limit for ω → 0.
        """
        state = np.asarray(state, dtype=float)
        speed, rate = self._speed_and_rate(state)
        half = 0.5 * rate * self.interval
        chord = speed * self.interval * np.sinc(half / np.pi)
        direction = state[..., 2] + half
        result = state.copy()
        result[..., 0] += chord * np.cos(direction)
        result[..., 1] += chord * np.sin(direction)
        result[..., 2] += rate * self.interval
        return result

    def jacobian(self, state: Array) -> Array:
        """Jacobian F = ∂f/∂s of eq. (1), shape (..., n, n)."""
        state = np.asarray(state, dtype=float)
        speed, rate = self._speed_and_rate(state)
        interval, n = self.interval, self.dimension
        half = 0.5 * rate * interval
        sinc = np.sinc(half / np.pi)
        chord = speed * interval * sinc
        cosine, sine = np.cos(state[..., 2] + half), np.sin(state[..., 2] + half)
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

    def velocity(self, state: Array) -> Array:
        """Velocity vector v·[cos heading, sin heading, 0], shape (..., 3), eq. (12)."""
        state = np.asarray(state, dtype=float)
        return ahead(state[..., 2], self._speed_and_rate(state)[0])[0]

    def pose_jacobian(self, state: Array) -> Array:
        """∂pose/∂s (..., 8, n)."""
        state = np.asarray(state, dtype=float)
        _, by_heading, by_speed = ahead(state[..., 2], self._speed_and_rate(state)[0])
        by_velocity = np.zeros((*state.shape[:-1], 3, self.dimension))
        by_velocity[..., 2] = by_heading
        if self.dimension == UNKNOWN_MOTION:
            by_velocity[..., 4] = by_speed
        return pose_jacobian_of(state, by_velocity)

    def paced(self, pace: float) -> CoordinatedTurn:
        """The motion over `pace` periods: F over that time, and Q as of a walk, in proportion to it."""
        if pace == 1.0:
            return self
        return replace(self, interval=self.interval * pace, process_noise=self.process_noise * pace)

    def prior(self, mean: Array, covariance: Array) -> tuple[Array, Array]:
        """Prior of the pose, with speed and turn rate where they are states."""
        if self.dimension == KNOWN_MOTION:
            return mean, covariance
        extra = np.diag(np.square(self.spread))
        return np.append(mean, [self.speed, self.turn_rate]), np.asarray(block_diag(covariance, extra))

    def truth(self, track: Track) -> tuple[Array, Array]:
        """States of a track and its start, with the speed along the heading and the rate of turn where they are states."""
        states, start = track.state, np.asarray(track.start, float)
        if self.dimension == KNOWN_MOTION:
            return states, start
        ahead_ = np.column_stack([np.cos(track.heading), np.sin(track.heading)])
        speed = np.sum(track.velocity[:, :2] * ahead_, axis=1)
        turned = np.diff(track.heading, prepend=start[2])
        turned = (turned + np.pi) % (2 * np.pi) - np.pi
        rate = turned / np.diff(track.time, prepend=track.time[0] - self.interval)
        return np.column_stack([states, speed, rate]), np.append(start, [speed[0], rate[0]])


class Walk(CoordinatedTurn):
    """A receiver that stands still but for large process noise: its heading says nothing about its course."""

    __slots__ = ()

    doppler = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Told:
    """What a scenario can tell a motion model; one takes what it has a parameter for.

    Attributes
    ----------
    interval : s
    pose_noise : (4, 4), covariance of the pose's process noise per step
    speed, turn_rate : m/s, rad/s, of the true drive
    speed_std, turn_rate_std : their prior standard deviations where they are not known
    speed_walk, turn_rate_walk : their standard deviations per step
    position_walk : m per step of a walk; None: what the speed covers
    heading_walk : rad per step of a walk
    """

    interval: float
    pose_noise: Array
    speed: float
    turn_rate: float
    speed_std: float
    turn_rate_std: float
    speed_walk: float
    turn_rate_walk: float
    position_walk: float | None
    heading_walk: float


def motion_of(name: str, told: Told, options: dict[str, Any]) -> MotionModel:
    """The motion model of a name, ``module:Class`` or ``file.py:Class``, made with what it has parameters for.

    Raises
    ------
    ConfigError
        If there is none of that name, it has no such option, or is no motion model.
    """
    maker = MOTIONS[name]
    able = set(inspect.signature(maker).parameters)
    values = {field: getattr(told, field) for field in Told.__slots__}
    unknown = sorted(set(options) - able)
    if unknown:
        own = sorted(able - set(values))
        raise ConfigError(
            f"filter.motion_options.{unknown[0]}: the motion model {name!r} has no such option; it has {', '.join(own) or 'none'}"
        )
    try:
        found = maker(**{key: value for key, value in (values | options).items() if key in able})
    except Exception as error:  # a model of one's own can fail in any way
        raise ConfigError(f"filter.motion = {name!r}: {error}") from error
    if not isinstance(found, MotionModel) or tuple(found.names[: len(POSE)]) != POSE:
        raise ConfigError(
            f"filter.motion = {name!r} is no motion model: derive it from dopslam.models.motion.Motion, and let its names begin "
            f"with {', '.join(POSE)}"
        )
    return found


def known(interval: float, pose_noise: Array, speed: float, turn_rate: float) -> CoordinatedTurn:
    """Coordinated turn with known speed and turn rate."""
    return CoordinatedTurn(interval, pose_noise, speed, turn_rate)


def unknown(
    interval: float, pose_noise: Array, speed: float, turn_rate: float,
    speed_std: float, turn_rate_std: float, speed_walk: float, turn_rate_walk: float,
) -> CoordinatedTurn:  # fmt: skip
    """Coordinated turn with speed and turn rate in the state, where they walk from step to step."""
    noise = np.asarray(block_diag(pose_noise, np.diag(np.square([speed_walk, turn_rate_walk]))))
    return CoordinatedTurn(interval, noise, speed, turn_rate, (speed_std, turn_rate_std))


def walk(interval: float, pose_noise: Array, speed: float, position_walk: float | None, heading_walk: float) -> Walk:
    """The receiver stands still but for large process noise: snapshots, people."""
    noise = np.array(pose_noise)
    stride = position_walk or max(speed * interval, float(np.sqrt(noise[0, 0])))
    noise[[0, 1, 2], [0, 1, 2]] = np.square([stride, stride, heading_walk])
    return Walk(interval, noise)


def _sinc_slope(x: Array) -> Array:
    """d/dx of sin(x)/x, with its series near zero where the quotient loses all digits."""
    small = np.abs(x) < 1e-2
    safe = np.where(small, 1.0, x)
    return np.where(small, x * (-1 / 3 + x * x * (1 / 30 - x * x / 840)), (np.cos(safe) - np.sin(safe) / safe) / safe)


def paced(motion: MotionModel, pace: float) -> Any:
    """:meth:`MotionModel.paced`."""
    return motion.paced(pace)


def propagate(state: Array, motion: MotionModel) -> Array:
    """:meth:`MotionModel.step`."""
    return motion.step(state)


def transition_jacobian(state: Array, motion: MotionModel) -> Array:
    """:meth:`MotionModel.jacobian`."""
    return motion.jacobian(state)


def velocity(state: Array, motion: MotionModel) -> Array:
    """Velocity (..., 3) [m/s] that a motion model gives a state."""
    return motion.pose(state).velocity
