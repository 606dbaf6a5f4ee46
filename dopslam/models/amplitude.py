"""Amplitude statistics of a path estimate: how likely it is seen, how strong it looks, how exact its
parameters are.

The normalized amplitude ``u`` of a path is the square root of its SNR after coherent integration over all
samples (paper B, Section III-A). A noisy estimate ``z`` of it follows a Rician density; estimates below the
detection threshold ``γ`` are never reported. All amplitudes are dimensionless; γ² is the detection SNR
(linear).

With the scale σ² = ½ + u²/(4N_s) (paper B, below eq. (6)):

* f(z|u) = Rice(z; u, σ) / p_d(u) for z > γ, eq. (7);  p_d(u) = Q₁(u/σ, γ/σ);
* hence p_d(u) f(z|u) is the *untruncated* Rice density: filters need Marcum's Q only in 1 − p_d(u);
* false alarms: f_fa(z) = 2z exp(−z² + γ²), z > γ (Rayleigh), optionally mixed with a uniform tail for the
  strong spurious peaks that real estimators produce (a pure Rayleigh declares every such peak an existing
  feature).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import i0e
from scipy.stats import ncx2

from dopslam.errors import FilterError
from dopslam.records import SPEED_OF_LIGHT

LARGEST_DETECTION_PROBABILITY = 0.99  # 1 − p_d must not underflow: an exact 0 makes one missed detection impossible


@dataclass(frozen=True, slots=True)
class AmplitudeModel:
    """Amplitude likelihoods of one estimator.

    Parameters
    ----------
    threshold : detection threshold γ on the amplitude (γ² is the detection SNR, linear)
    samples : number of samples N_s that the SNR is integrated over
    tail_weight : share of false alarms with uniformly distributed amplitude; 0 is the paper's Rayleigh
    tail_end : largest amplitude of that uniform tail
    """

    threshold: float
    samples: float
    tail_weight: float = 0.0
    tail_end: float = 60.0

    def __post_init__(self):
        if not self.threshold > 0 or not self.samples > 0:
            raise FilterError(
                f"AmplitudeModel: threshold and samples must be positive, got {self.threshold} and {self.samples}"
            )
        if not 0 <= self.tail_weight < 1 or not self.tail_end > self.threshold:
            raise FilterError(
                f"AmplitudeModel: tail_weight must be in [0, 1) and tail_end above the threshold "
                f"{self.threshold}, got {self.tail_weight} and {self.tail_end}"
            )

    def variance(self, u):
        """σ_u² = ½ + u²/(4 N_s), the scale of the Rician density (paper B, after eq. (6))."""
        return 0.5 + np.square(u) / (4.0 * self.samples)

    def log_rice(self, z, u):
        """Log of the untruncated Rician density, log [p_d(u) f(z|u)] of eq. (7); broadcasts."""
        v = self.variance(u)
        return np.log(z / v) - (z - u) ** 2 / (2 * v) + np.log(i0e(z * u / v))

    def log_likelihood(self, z, u):
        """log f(z|u) of eq. (7): truncated Rice, −inf below the threshold."""
        return np.where(z >= self.threshold, self.log_rice(z, u) - np.log(self.detection_probability(u)), -np.inf)

    def detection_probability(self, u):
        """p_d(u) = Q₁(u/σ, γ/σ) by the non-central χ² survival function."""
        v = self.variance(u)
        return ncx2.sf(self.threshold**2 / v, 2, np.square(u) / v)

    def missed_probability(self, u):
        """1 − p_d(u) from a table (absolute error below 1e-5), at least 0.01; ``u`` any array ≥ 0."""
        grid, table = _missed_table(self.threshold, self.samples)
        return np.interp(u, grid, table)

    def log_false_alarm(self, z):
        """Log density of a false alarm's amplitude for z ≥ γ (what just passes is detected); −inf below."""
        rayleigh = np.log(2 * z) - np.square(z) + self.threshold**2
        if self.tail_weight > 0:
            tail = np.where(z < self.tail_end, np.log(self.tail_weight / (self.tail_end - self.threshold)), -np.inf)
            rayleigh = np.logaddexp(np.log1p(-self.tail_weight) + rayleigh, tail)
        return np.where(z >= self.threshold, rayleigh, -np.inf)

    def sample(self, rng: np.random.Generator, u) -> np.ndarray:
        """Noisy amplitudes |u + noise| of paths with amplitude ``u``, not yet thresholded."""
        u = np.asarray(u, float)
        deviation = np.sqrt(self.variance(u))
        return np.hypot(u + deviation * rng.standard_normal(u.shape), deviation * rng.standard_normal(u.shape))

    def sample_false_alarm(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Amplitudes of ``size`` false alarms: truncated Rayleigh by inversion, with the tail if any."""
        z = np.sqrt(self.threshold**2 - np.log1p(-rng.random(size)))
        tail = rng.random(size) < self.tail_weight
        return np.where(tail, rng.uniform(self.threshold, self.tail_end, size), z)


@dataclass(frozen=True, slots=True)
class ConstantDetection:
    """Detections without usable amplitudes: one detection probability, amplitude densities all 1."""

    probability: float = 0.9

    def __post_init__(self):
        if not 0 < self.probability <= LARGEST_DETECTION_PROBABILITY:
            raise FilterError(f"ConstantDetection: probability must be in (0, 0.99], got {self.probability}")

    def variance(self, u):
        """1, unused."""
        return np.ones_like(u)

    def missed_probability(self, u):
        """1 − p_d."""
        return np.full(np.shape(u), 1 - self.probability)

    def log_false_alarm(self, z):
        """0."""
        return np.zeros(np.shape(z))


@lru_cache(maxsize=32)
def _missed_table(threshold: float, samples: float) -> tuple[np.ndarray, np.ndarray]:
    """Grid over u and 1 − p_d(u) on it, floored so that p_d ≤ 0.99; constant beyond the grid."""
    grid = np.linspace(0.0, threshold + 8.0, 4001)
    v = 0.5 + grid**2 / (4.0 * samples)
    return grid, np.maximum(ncx2.cdf(threshold**2 / v, 2, grid**2 / v), 1 - LARGEST_DETECTION_PROBABILITY)


@dataclass(frozen=True, slots=True)
class Radio:
    """What fixes the accuracy of single-path estimates through Fisher's information (paper B, after eq. (6)).

    Parameters
    ----------
    carrier : carrier frequency f_c [Hz]
    rms_bandwidth : mean square bandwidth's root β [Hz]; B/√12 for a flat band B
    rx_aperture, tx_aperture : root of the squared array aperture D² at the receiver and at the anchor [m]
    """

    carrier: float
    rms_bandwidth: float
    rx_aperture: float
    tx_aperture: float

    @property
    def unit_deviations(self) -> np.ndarray:
        """(3,) standard deviations of distance [m], AOA [rad] and AOD [rad] at u = 1; they fall as 1/u."""
        distance = SPEED_OF_LIGHT / (np.sqrt(8) * np.pi * self.rms_bandwidth)
        angle = SPEED_OF_LIGHT / (np.sqrt(8) * np.pi * self.carrier)
        return np.array([distance, angle / self.rx_aperture, angle / self.tx_aperture])


def flat_rms_bandwidth(bandwidth: float) -> float:
    """β of a flat band: β² = B²/12 [Hz]."""
    return bandwidth / np.sqrt(12)


def squared_aperture(positions: np.ndarray, azimuth) -> np.ndarray:
    """D²(φ) of an array in the horizontal plane (paper B, footnote 5).

    Parameters
    ----------
    positions : (H, 2) element positions relative to the array's center of gravity [m]
    azimuth : (...) direction of the wave [rad]

    Returns
    -------
    (...) mean over the elements of the squared offset perpendicular to the direction [m²]
    """
    azimuth = np.asarray(azimuth, float)
    across = -np.sin(azimuth)[..., None] * positions[:, 0] + np.cos(azimuth)[..., None] * positions[:, 1]
    return np.mean(across**2, axis=-1)
