"""The belief that the conditional filter carries from step to step, and its prediction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dopslam.models.measurement import wrap
from dopslam.slam.belief.motion import Motion, SpeedHeading
from dopslam.slam.belief.records import Form

_STEP = 1e-4  # of the central differences, in a coordinate's own unit or in standard deviations
_HEADING = 4  # coordinate of :class:`SpeedHeading` that is an angle


class Map(NamedTuple):
    """Features given the agent, x | s ~ N(center + G (s − s̄), C), one row per feature and type; row 0 is the line of sight.

    Attributes
    ----------
    label : (K + 1,) int, number of each feature, −1 the line of sight
    first : (K + 2,) int, rows of feature k are first[k]:first[k + 1]
    form : (R,) int; weight : (R,) P(exists, type)
    hidden : (R,) probability that an obstacle or the end of its surface hides the feature, given that it exists
    seen : (R,) detections so far, an average over associations
    reference : (R, 3) mean and variance of the amplitude times the root of the spreading loss, and the mean as it was when
        last detected: misses pull the first down, which would explain why a feature is not seen, and not whether it should be
    center : (R, 3) m; gain : (3R, d), G; spread : (3R, 3R) m², C
    """

    label: NDArray[np.int64]
    first: NDArray[np.int64]
    form: NDArray[np.int64]
    weight: NDArray[np.float64]
    hidden: NDArray[np.float64]
    seen: NDArray[np.float64]
    reference: NDArray[np.float64]
    center: NDArray[np.float64]
    gain: NDArray[np.float64]
    spread: NDArray[np.float64]

    @property
    def existence(self) -> np.ndarray:
        """(K + 1,) existence probabilities."""
        return np.add.reduceat(self.weight, self.first[:-1])

    @property
    def owner(self) -> np.ndarray:
        """(R,) feature of each row."""
        return np.repeat(np.arange(len(self.label)), np.diff(self.first))

    def marginals(self, covariance: np.ndarray) -> Map:
        """Every row's own marginal and nothing else: no correlation with the agent (covariance (d, d)), none among rows."""
        wide = np.zeros_like(self.spread)
        for r in range(len(self.form)):
            at = slice(3 * r, 3 * r + 3)
            wide[at, at] = self.spread[at, at] + self.gain[at] @ covariance @ self.gain[at].T
        return self._replace(gain=np.zeros_like(self.gain), spread=wide)

    def joined(self, label, counts, form, weight, reference, center, gain, spread) -> Map:
        """With newborn features behind, independent of all others given the agent; spread (·, 3, 3), gain (·, 3, d)."""
        old, new = len(self.spread), 3 * len(form)
        wide = np.zeros((old + new, old + new))
        wide[:old, :old] = self.spread
        for i, block in enumerate(spread):
            at = slice(old + 3 * i, old + 3 * i + 3)
            wide[at, at] = block
        return Map(
            np.concatenate([self.label, label]), np.concatenate([self.first, self.first[-1] + np.cumsum(counts)]),
            np.concatenate([self.form, form]), np.concatenate([self.weight, weight]), np.concatenate([self.hidden, np.zeros(len(form))]),
            np.concatenate([self.seen, np.ones(len(form))]),
            np.concatenate([self.reference, reference]), np.concatenate([self.center, center]),
            np.concatenate([self.gain, gain.reshape(new, -1)]), wide,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Belief:
    """Agent and map.

    Attributes
    ----------
    mean : (c,) all coordinates of the motion model; covariance : (d, d) of those that are uncertain
    active : (d,) int, which these are
    points : (N, d) particles, or None for a Gaussian agent; log_weight : (N,)
    map : :class:`Map`
    next_label : of the next new feature
    cloud : particles (N, 8) and log weights of a start that is no Gaussian, before the first step only
    """

    mean: np.ndarray
    covariance: np.ndarray
    active: np.ndarray
    points: np.ndarray | None
    log_weight: np.ndarray | None
    map: Map
    next_label: int = 0
    cloud: tuple[np.ndarray, np.ndarray] | None = None


@dataclass(frozen=True, slots=True)
class Dynamics:
    """A motion model in its free coordinates, linearized by central differences: one code for every motion."""

    motion: Motion

    def _relative(self, coordinates: np.ndarray, center: np.ndarray) -> np.ndarray:
        """The branch of the heading that is nearest to the center's."""
        if isinstance(self.motion, SpeedHeading):
            coordinates = coordinates.copy()
            coordinates[:, _HEADING] = center[_HEADING] + wrap(coordinates[:, _HEADING] - center[_HEADING])
        return coordinates

    def coordinates(self, particles: np.ndarray) -> np.ndarray:
        """(N, c) free coordinates of particles."""
        return self.motion.coordinates(particles)

    def poses(self, coordinates: np.ndarray) -> np.ndarray:
        """(N, 8) poses."""
        return np.ascontiguousarray(self.motion.rebuild(coordinates))

    def moved(self, coordinates: np.ndarray, center: np.ndarray) -> np.ndarray:
        """(N, c) one step later, without noise."""
        particles = self.motion.rebuild(coordinates)
        moved = self.motion.moved(particles, np.zeros((len(particles), self.motion.NOISES)))
        return self._relative(self.motion.coordinates(moved), center)

    def linearize(self, mean: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """f(mean) (c,), F (c, c) and Q (c, c)."""
        c, w = len(mean), self.motion.NOISES
        offsets = np.concatenate([np.zeros((1, c)), _STEP * np.eye(c), -_STEP * np.eye(c), np.zeros((2 * w, c))])
        noise = np.concatenate([np.zeros((1 + 2 * c, w)), np.eye(w), -np.eye(w)])
        particles = self.motion.rebuild(mean + offsets)
        after = self.motion.coordinates(self.motion.moved(particles, noise))
        after = self._relative(after, after[0])
        by_state = (after[1 : 1 + c] - after[1 + c : 1 + 2 * c]).T / (2 * _STEP)
        by_noise = (after[1 + 2 * c : 1 + 2 * c + w] - after[1 + 2 * c + w :]).T / 2
        return after[0], by_state, by_noise @ by_noise.T

    def pose(self, mean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pose (8,) and its Jacobian (8, c)."""
        pose = self.motion.rebuild(mean[None])[0]
        return pose, self.motion.slopes(pose)


def uncertain(dynamics: Dynamics, mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Which coordinates (c,) the prior or, within three steps, the motion makes uncertain."""
    total = np.diag(covariance).copy()
    for _ in range(3):
        mean, transition, noise = dynamics.linearize(mean)
        covariance = transition @ covariance @ transition.T + noise
        total += np.diag(covariance)
    return np.flatnonzero(total > 1e-24)


def empty_map(anchor: np.ndarray, size: int, sight: np.ndarray) -> Map:
    """Only the line of sight; sight (3,) is its existence and the mean and variance of its reference."""
    return Map(
        np.array([-1]), np.array([0, 1]), np.array([int(Form.LOS)]), sight[:1].copy(), np.zeros(1), np.zeros(1), sight[None, [1, 2, 1]].copy(),
        np.array(anchor, float)[None], np.zeros((3, size)), np.zeros((3, 3)),
    )  # fmt: skip
