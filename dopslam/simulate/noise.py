"""What makes detections inexact, late or missing, in three kinds with one contract: fixed, by link budget, by amplitude.

:class:`FixedNoise` is paper A's (one R, a range of scatter points), :class:`SnrNoise` what ray-traced detections have (R falls
with ρ, p_D follows ρ), :class:`AmplitudeNoise` paper B's (R by Fisher's information of a Rician amplitude that decides by itself
whether a path is seen). A world draws from any of them, for every filter alike.

Paper B's own experiments (:mod:`dopslam.slam.belief.experiment`) draw for themselves: its walk reverts to a mean, its planar scans
compare directions by tangents, and its figures are reproduced draw by draw.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from dopslam.models.amplitude import AmplitudeModel, Radio
from dopslam.models.detection import ConstantDetection, DetectionModel, probability_from_snr
from dopslam.models.measurement import SP
from dopslam.models.paths import paths, spreading_loss

Array = NDArray[np.float64]


class Told(NamedTuple):
    """Of K steps and L landmarks: R (K, L, 6, 6), probability of detection or what was detected (K, L), and ρ (K, L) or None."""

    covariance: Array
    probability: NDArray
    snr: Array | None


class Noise(Protocol):
    """The contract of a kind of noise.

    Attributes
    ----------
    threshold : detection threshold on ρ, linear; None where p_D does not follow ρ
    detection : the true model of p_D for a filter; None where it follows ρ
    """

    @property
    def threshold(self) -> float | None: ...
    @property
    def detection(self) -> DetectionModel | None: ...

    def of(self, ue: Array, bs: Array, position: Array, kind: NDArray[np.int64]) -> Told:
        """Along receivers (K, 1, 3), a base station (3,) and landmarks (L, 3) of kinds (L,)."""
        ...

    def detect(self, rng: np.random.Generator, told: Told) -> Told:
        """What was detected, with the R and ρ that an estimator would report."""
        ...

    def false(self, rng: np.random.Generator, count: int, like: Array) -> tuple[Array, Array]:
        """R (count, 6, 6) and ρ (count,) of false detections; `like` is the first landmark's R."""
        ...


class _Bernoulli:
    """Detected by chance, and reported as it is."""

    def detect(self, rng: np.random.Generator, told: Told) -> Told:
        return told._replace(probability=rng.random(told.probability.shape) < told.probability)


@dataclass(frozen=True, slots=True)
class FixedNoise(_Bernoulli):
    """R and p_D the same for all: standard deviations (6,) [m, rad ×4, m/s], SPs seen within `sp_range`
    [m].
    """

    std: Array
    detection_probability: float = 0.9
    sp_range: float | None = 50.0

    @property
    def threshold(self) -> None:
        """None."""
        return None

    @property
    def detection(self) -> ConstantDetection:
        """Constant."""
        return ConstantDetection(self.detection_probability, self.sp_range)

    def of(self, ue: Array, bs: Array, position: Array, kind: NDArray[np.int64]) -> Told:
        """The same everywhere."""
        count = (len(ue), len(kind))
        probability = np.full(count, self.detection_probability)
        if self.sp_range is not None:
            distance = np.linalg.norm(position - ue, axis=-1)
            probability = np.where((kind == SP) & (distance > self.sp_range), 0.0, probability)
        return Told(np.broadcast_to(np.diag(self.std**2), (*count, 6, 6)), probability, None)

    def false(self, rng: np.random.Generator, count: int, like: Array) -> tuple[Array, Array]:
        """As those of paths."""
        return np.broadcast_to(like, (count, 6, 6)), np.ones(count)


@dataclass(frozen=True, slots=True)
class SnrNoise(_Bernoulli):
    """R = diag(unit_std²)/ρ and p_D(ρ), ρ = reference/spreading loss.

    Attributes
    ----------
    unit_std : (6,) array; standard deviations at ρ = 1
    reference_db : (L,) array; ρ times spreading loss of each landmark [dB]
    threshold : float; detection threshold on ρ, linear
    """

    unit_std: Array
    reference_db: Array
    threshold: float = 14.0

    @property
    def detection(self) -> None:
        """None: it follows ρ."""
        return None

    def of(self, ue: Array, bs: Array, position: Array, kind: NDArray[np.int64]) -> Told:
        """By the spreading loss of each path."""
        snr = 10 ** (self.reference_db / 10) / spreading_loss(kind, position, ue, bs)
        covariance = np.diag(self.unit_std**2) / np.maximum(snr, 1e-3)[..., None, None]
        return Told(covariance, probability_from_snr(snr, self.threshold), snr)

    def false(self, rng: np.random.Generator, count: int, like: Array) -> tuple[Array, Array]:
        """Just above the threshold."""
        snr = self.threshold * (1.0 + rng.exponential(1 / self.threshold, count))
        return np.diag(self.unit_std**2) / snr[:, None, None], snr


@dataclass(frozen=True, slots=True)
class AmplitudeNoise:
    """Paper B: normalized amplitudes u that fall with the path length, R by Fisher's information at u (after eq. (6)), observed
    amplitudes Rician around u (7), and what lies above γ is detected with the R of what was observed.

    Attributes
    ----------
    amplitude, distance : (L,) u of each landmark at a path length [m]
    radio, detector : what fixes R and the amplitudes
    doppler_unit : m/s; standard deviation of the radial velocity at u = 1
    """

    amplitude: Array
    distance: Array
    radio: Radio
    detector: AmplitudeModel
    doppler_unit: float = 1.0

    @property
    def threshold(self) -> float:
        """γ²."""
        return self.detector.threshold**2

    @property
    def detection(self) -> None:
        """None: it follows ρ = u²."""
        return None

    def _covariance(self, amplitude: Array) -> Array:
        d, a, t = self.radio.unit_deviations
        return np.diag([d, a, a, t, t, self.doppler_unit]) ** 2 / np.square(amplitude)[..., None, None]

    def of(self, ue: Array, bs: Array, position: Array, kind: NDArray[np.int64]) -> Told:
        """By the length of each path."""
        u = np.asarray(self.amplitude) * np.asarray(self.distance) / paths(ue, bs, position, kind).length
        return Told(self._covariance(u), self.detector.detection_probability(u), u**2)

    def detect(self, rng: np.random.Generator, told: Told) -> Told:
        """By the observed amplitude; a path that cannot be has none."""
        assert told.snr is not None
        seen = self.detector.sample(rng, np.sqrt(told.snr))
        return Told(self._covariance(seen), (seen > self.detector.threshold) & (told.probability > 0), seen**2)

    def false(self, rng: np.random.Generator, count: int, like: Array) -> tuple[Array, Array]:
        """Truncated Rayleigh amplitudes."""
        seen = self.detector.sample_false_alarm(rng, count)
        return self._covariance(seen), seen**2
