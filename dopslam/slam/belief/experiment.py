"""Synthetic experiments for the belief-propagation filters: tracks and measurements drawn from the model.

The pedestrian experiment stands for paper B, Section VI-B: one anchor, two virtual anchors, one point
scatterer, 200 steps of a straight walk, amplitudes that fall with the path length, Fisher-information
variances, Rician detection and Poisson false alarms. Variants: weak features, a blocked line of sight,
spurious peaks as strong as paths, three dimensions. World frame, SI units, radians; the anchor's array is
aligned with the world frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from dopslam.models.amplitude import AmplitudeModel, Radio, flat_rms_bandwidth
from dopslam.records import SPEED_OF_LIGHT
from dopslam.slam.belief import geometry
from dopslam.slam.belief.records import Form, Parameters, Scan

_WAVELENGTH = SPEED_OF_LIGHT / 28e9
_RADIO = Radio(28e9, flat_rms_bandwidth(768e6), 0.90 * _WAVELENGTH, 2.30 * _WAVELENGTH)
_DETECTOR = AmplitudeModel(threshold=10**0.45, samples=1024.0 * 128 * 64)


@dataclass(frozen=True)
class Experiment:
    """A synthetic experiment; the defaults are the pedestrian one.

    Parameters
    ----------
    anchor : (3,) m
    features : (L, 3) m, true virtual anchors and scatterers
    forms : (L,) true kinds, ``Form.VA_AOD`` or ``Form.PS``
    amplitudes, distances : (1 + L,) reference amplitude at a reference distance [m], line of sight first; u ∝
        1/d
    radio, detector : what fixes variances and detection
    false_alarm_rate, distance_end : Poisson mean per step; distances uniform up to there [m]
    spurious_rate, spurious_end : additional false alarms with amplitude uniform in [γ, end]
    steps, interval : number of measured steps, T [s]
    start, heading, speed : (3,) m, rad, m/s before the first measured step
    heading_noise, speed_noise : standard deviations of the walk per step [rad], [m/s]
    climb_noise : standard deviation of the vertical speed's walk per step [m/s]; 0 keeps the height
    blocked : steps [first, last) without line of sight
    spatial : whether elevations are measured
    """

    anchor: np.ndarray = field(default_factory=lambda: np.zeros(3))
    features: np.ndarray = field(
        default_factory=lambda: np.array([[0.0, 18.0, 0.0], [38.0, -22.0, 0.0], [11.0, 4.0, 0.0]])
    )
    forms: tuple[Form, ...] = (Form.VA_AOD, Form.VA_AOD, Form.PS)
    amplitudes: tuple[float, ...] = (30.0, 15.0, 12.0, 12.0)
    distances: tuple[float, ...] = (10.0, 20.0, 30.0, 20.0)
    radio: Radio = _RADIO
    detector: AmplitudeModel = _DETECTOR
    false_alarm_rate: float = 2.0
    distance_end: float = 80.0
    spurious_rate: float = 0.0
    spurious_end: float = 15.0
    steps: int = 200
    interval: float = 0.1
    start: np.ndarray = field(default_factory=lambda: np.array([6.0, -4.0, 0.0]))
    heading: float = 0.0
    speed: float = 0.65
    heading_noise: float = np.deg2rad(0.3)
    speed_noise: float = 0.005
    climb_noise: float = 0.0
    blocked: tuple[int, int] | None = None
    spatial: bool = False

    @property
    def parameters(self) -> Parameters:
        """Matched filter parameters (the paper's likelihood forms)."""
        rate = self.false_alarm_rate + self.spurious_rate
        detector = self.detector
        if self.spurious_rate > 0:  # one heavy-tailed false alarm density instead of the pure Rayleigh
            detector = replace(detector, tail_weight=0.1)
        return Parameters(
            anchor=self.anchor,
            amplitude=detector,
            false_alarm_rate=rate,
            distance_end=self.distance_end,
            volume=160.0**3 if self.spatial else 160.0**2,
            spatial=self.spatial,
        )


def cluttered(experiment: Experiment | None = None) -> Experiment:
    """Five false alarms per step."""
    return replace(experiment or Experiment(), false_alarm_rate=5.0)


def weak(experiment: Experiment | None = None) -> Experiment:
    """Weak features, u = 15, 6, 5, 5 at the reference distances, and five false alarms per step."""
    return replace(experiment or Experiment(), amplitudes=(15.0, 6.0, 5.0, 5.0), false_alarm_rate=5.0)


def blocked(experiment: Experiment | None = None) -> Experiment:
    """No line of sight in steps 90 to 130, and five false alarms per step."""
    return replace(experiment or Experiment(), blocked=(90, 130), false_alarm_rate=5.0)


def spurious(experiment: Experiment | None = None) -> Experiment:
    """Three spurious peaks per step, as strong as paths (amplitudes up to 15), instead of noise peaks."""
    return replace(experiment or Experiment(), spurious_rate=3.0, false_alarm_rate=1e-3)


def spatial() -> Experiment:
    """Three dimensions: anchor and agent above ground, three walls (one is the ground) and two scatterers."""
    return Experiment(
        anchor=np.array([0.0, 0.0, 3.0]),
        features=np.array(
            [[0.0, 18.0, 3.0], [38.0, -22.0, 3.0], [0.0, 0.0, -3.0], [11.0, 4.0, 2.0], [14.0, -9.0, 4.0]]
        ),
        forms=(Form.VA_AOD, Form.VA_AOD, Form.VA_AOD, Form.PS, Form.PS),
        amplitudes=(30.0, 15.0, 12.0, 12.0, 12.0, 12.0),
        distances=(10.0, 20.0, 30.0, 20.0, 20.0, 20.0),
        start=np.array([6.0, -4.0, 1.5]),
        climb_noise=0.005,
        spatial=True,
    )


@dataclass(frozen=True)
class Truth:
    """True track at the measured steps: position (K, 3) m, heading (K,) rad, velocity (K, 3) m/s."""

    position: np.ndarray
    heading: np.ndarray
    velocity: np.ndarray


def draw_track(experiment: Experiment, rng: np.random.Generator) -> Truth:
    """A walk whose heading and speed revert to their means: h ← h₀ + 0.97(h − h₀) + noise, v likewise with 0.95."""
    heading, speed, place = experiment.heading, experiment.speed, np.array(experiment.start, float)
    position, velocity = np.empty((experiment.steps, 3)), np.empty((experiment.steps, 3))
    headings, climb = np.empty(experiment.steps), 0.0
    for k in range(experiment.steps):
        noise = rng.standard_normal(3)
        heading = experiment.heading + 0.97 * (heading - experiment.heading) + experiment.heading_noise * noise[0]
        speed = experiment.speed + 0.95 * (speed - experiment.speed) + experiment.speed_noise * noise[1]
        climb = 0.95 * climb + experiment.climb_noise * noise[2]
        velocity[k] = speed * geometry.unit_vector(heading) + np.array([0.0, 0.0, climb])
        place = place + experiment.interval * velocity[k]
        position[k], headings[k] = place, heading
    return Truth(position, headings, velocity)


def true_amplitudes(experiment: Experiment, position: np.ndarray) -> np.ndarray:
    """(1 + L,) normalized amplitudes at a receiver position, line of sight first."""
    lengths = [geometry.predict(Form.LOS, position, experiment.anchor, experiment.anchor)[0]]
    for form, q in zip(experiment.forms, experiment.features, strict=True):
        lengths.append(geometry.predict(form, position, q, experiment.anchor)[0])
    return np.array(experiment.amplitudes) * np.array(experiment.distances) / np.array(lengths)


def measurement_covariance(radio: Radio, amplitude: np.ndarray, spatial: bool) -> np.ndarray:
    """(M, n, n) diagonal covariances of (distance, AOA tangents, AOD tangents) at normalized amplitudes."""
    d, a, t = radio.unit_deviations
    unit = np.array([d, a, a, t, t] if spatial else [d, a, t])
    return np.eye(unit.size) * (unit / np.asarray(amplitude)[:, None])[:, None, :] ** 2


def _perturbed(rng, direction: np.ndarray, deviation: float, count: int) -> np.ndarray:
    basis = geometry.tangents(direction, count)
    angle = deviation * rng.standard_normal(count)
    size = np.linalg.norm(angle)
    if size < 1e-15:
        return direction
    return np.cos(size) * direction + np.sin(size) / size * (angle @ basis)


def _random_directions(rng, size: int, spatial: bool) -> np.ndarray:
    azimuth = rng.uniform(-np.pi, np.pi, size)
    return geometry.unit_vector(azimuth, np.arcsin(rng.uniform(-1, 1, size)) if spatial else 0.0)


def draw_scan(
    experiment: Experiment, position: np.ndarray, heading: float, step: int, rng: np.random.Generator
) -> tuple[Scan, np.ndarray]:
    """One step's measurements in random order.

    Returns
    -------
    scan, source : source (M,) is 0 for the line of sight, 1 + l for feature l, −1 for a false alarm
    """
    count = 2 if experiment.spatial else 1
    unit = experiment.radio.unit_deviations
    rows, source = [], []
    true_u = true_amplitudes(experiment, position)
    observed = experiment.detector.sample(rng, true_u)
    forms = (Form.LOS, *experiment.forms)
    places = np.vstack([experiment.anchor, experiment.features])
    hidden = experiment.blocked is not None and experiment.blocked[0] <= step < experiment.blocked[1]
    for index, (form, q) in enumerate(zip(forms, places, strict=True)):
        length, arrival, departure = geometry.predict(form, position, q, experiment.anchor)
        sigma = unit / true_u[index]
        noisy = length + sigma[0] * rng.standard_normal()
        aoa = _perturbed(rng, geometry.turned(arrival, np.array(-heading)), sigma[1], count)
        aod = _perturbed(rng, departure, sigma[2], count)
        if observed[index] > experiment.detector.threshold and not (hidden and form == Form.LOS):
            rows.append((noisy, aoa, aod, observed[index]))
            source.append(index)
    noise, strong = rng.poisson(experiment.false_alarm_rate), rng.poisson(experiment.spurious_rate)
    total = noise + strong
    amplitude = np.concatenate(
        [
            experiment.detector.sample_false_alarm(rng, noise),
            rng.uniform(experiment.detector.threshold, experiment.spurious_end, strong),
        ]
    )
    distance = rng.uniform(0, experiment.distance_end, total)
    aoa = _random_directions(rng, total, experiment.spatial)
    aod = _random_directions(rng, total, experiment.spatial)
    rows += list(zip(distance, aoa, aod, amplitude, strict=True))
    source += [-1] * total
    order = rng.permutation(len(rows))
    amplitudes = np.array([rows[i][3] for i in order])
    scan = Scan(
        np.array([rows[i][0] for i in order]),
        np.array([rows[i][1] for i in order]).reshape(-1, 3),
        np.array([rows[i][2] for i in order]).reshape(-1, 3),
        amplitudes,
        measurement_covariance(experiment.radio, amplitudes, experiment.spatial),
    )
    return scan, np.array(source, int)[order]


def draw(experiment: Experiment, rng: np.random.Generator) -> tuple[Truth, list[Scan], list[np.ndarray]]:
    """A track, its scans and the sources of their measurements."""
    truth = draw_track(experiment, rng)
    scans, sources = [], []
    for k in range(experiment.steps):
        scan, source = draw_scan(experiment, truth.position[k], float(truth.heading[k]), k, rng)
        scans.append(scan)
        sources.append(source)
    return truth, scans, sources
