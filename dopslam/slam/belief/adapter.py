"""Belief-propagation SLAM on the measurements that all filters read: from `Scans` to the filters' common `History`.

Azimuths and elevations become unit vectors and tangent covariances, amplitudes are √snr. The clock bias is a coordinate of the agent's particles (0 and no walk for synchronized clocks, as paper
B assumes). In the plane only the azimuths are used and detections far from the horizontal are left out, as
paper B does.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from dopslam.errors import FilterError
from dopslam.models.amplitude import AmplitudeModel, ConstantDetection
from dopslam.models.detection import SnrDetection
from dopslam.models.scans import Scans
from dopslam.records import Kind
from dopslam.slam.belief import geometry
from dopslam.slam.belief.conditional.filter import Conditional
from dopslam.slam.belief.motion import Motion, SpeedHeading, particles
from dopslam.slam.belief.rao_blackwell import RaoBlackwell
from dopslam.slam.belief.records import AOD_FOR_SINGLE_BOUNCE, Assumptions, Estimate, Form, Parameters, Scan
from dopslam.slam.history import Estimate as CommonEstimate
from dopslam.slam.history import History, history_of_estimates


@dataclass(frozen=True, slots=True)
class Setup:
    """What the filter is told about a scene.

    Parameters
    ----------
    anchor : (3,) m
    height : m, the receiver's plane
    mean (4,), covariance (4, 4) : [x m, y m, heading rad, bias m] one period before the first step
    motion : of the agent; speed : m/s at the start, speed_deviation : m/s
    spatial : three-dimensional features; otherwise the horizontal plane
    largest_elevation : rad, detections with a larger arrival elevation are left out in the plane
    assumptions : on the features; false_alarm_tail : share of false alarms as strong as paths
    detection_probability : for detections without amplitudes
    doppler : use radial velocities, where the features are conditional; doppler_span : m/s, width of their search
    correlation : False drops it after every step, the control experiment
    """

    anchor: np.ndarray
    height: float
    mean: np.ndarray
    covariance: np.ndarray
    motion: Motion
    speed: float
    speed_deviation: float = 0.0
    spatial: bool = True
    largest_elevation: float = np.deg2rad(20.0)
    assumptions: Assumptions = field(default_factory=lambda: Assumptions(types=AOD_FOR_SINGLE_BOUNCE))
    false_alarm_tail: float = 0.1
    detection_probability: float = 0.9
    doppler: bool = True
    doppler_span: float = 50.0
    correlation: bool = True


def turning(interval: float, turn_rate: float, process_std: np.ndarray, speed_walk: float = 0.0) -> SpeedHeading:
    """Motion of a receiver with known turn rate; process_std (4,) of [x, y, heading, bias] per step."""
    return SpeedHeading(
        interval, speed_walk, float(process_std[2]), turn_rate, float(process_std[0]), float(process_std[3])
    )


def scans_of(scans: Scans, setup: Setup) -> list[Scan]:
    """One scan of belief propagation per step.

    Raises
    ------
    FilterError
        If a covariance is not positive definite.
    """
    return [_scan(scans, scans.rows(k), setup) for k in range(scans.steps)]


def _scan(scans: Scans, rows: slice, setup: Setup) -> Scan:
    z, amplitude = scans.z[rows], np.ones(len(scans.z)) if scans.snr is None else np.sqrt(scans.snr)
    used = np.ones(len(z), bool) if setup.spatial else np.abs(z[:, 2]) <= setup.largest_elevation
    z = z[used]
    aoa, aod = z[:, 1:3], z[:, 3:5]
    # (length, AOA az, el, AOD az, el) → (length, tangents): an azimuth error shrinks with the cosine of the elevation.
    doppler = setup.doppler and setup.assumptions.features == "conditional"
    size = 6 if doppler else 5
    scale = np.ones((len(z), size))
    scale[:, 1], scale[:, 3] = np.cos(aoa[:, 1]), np.cos(aod[:, 1])
    covariance = scans.covariance[rows][used][:, :size, :size] * scale[:, :, None] * scale[:, None, :]
    if not setup.spatial:
        flat = np.array([0, 1, 3, 5] if doppler else [0, 1, 3])
        covariance = covariance[:, flat][:, :, flat]
        aoa, aod = aoa * [1.0, 0.0], aod * [1.0, 0.0]
    covariance = 0.5 * (covariance + covariance.swapaxes(1, 2))
    if len(covariance) and np.linalg.eigvalsh(covariance).min() <= 0:
        raise FilterError("adapter: a detection's covariance is not positive definite; remove it or inflate it")
    return Scan(
        z[:, 0].copy(),
        geometry.unit_vector(aoa[:, 0], aoa[:, 1]),
        geometry.unit_vector(aod[:, 0], aod[:, 1]),
        amplitude[rows][used],
        np.ascontiguousarray(covariance),
        z[:, 5].copy() if doppler else None,
    )


def filter_of(scans: Scans, setup: Setup, samples: float = 1e6, particles: int = 1000) -> RaoBlackwell | Conditional:
    """The filter with false alarms, detection and search region taken from the measurements.

    samples : number of samples N_s behind the SNR
    """
    lengths = scans.z[:, 0] - float(setup.mean[3])  # without the clock bias, as far as it is known
    end = float(1.2 * np.max(lengths, initial=1.0))
    assumptions = setup.assumptions
    if (
        scans.snr is None or scans.threshold is None or len(scans.snr) == 0 or np.ptp(scans.snr) == 0
    ):  # drawn from a model without amplitudes
        amplitude, amplitude_end = ConstantDetection(setup.detection_probability), 1.0
        assumptions = replace(assumptions, reacquisition=0.0)
    else:
        # Whatever is in the table was detected: a threshold above its weakest row is not the one it passed.
        threshold = float(np.sqrt(min(scans.threshold, scans.snr.min())))
        amplitude_end = 2 * max(float(np.sqrt(scans.snr.max())), threshold)
        amplitude = AmplitudeModel(threshold, samples, setup.false_alarm_tail, amplitude_end)
    parameters = Parameters(
        **asdict(assumptions),
        anchor=np.asarray(setup.anchor, float) * (1.0 if setup.spatial else np.array([1.0, 1.0, 0.0])),
        amplitude=amplitude,
        volume=(2 * end) ** (3 if setup.spatial else 2),
        amplitude_end=amplitude_end,
        false_alarm_rate=scans.clutter_count,
        distance_end=end,
        rescale_covariance=False,
        spatial=setup.spatial,
    )
    if assumptions.features == "independent":
        return RaoBlackwell(parameters, setup.motion)
    return Conditional(
        parameters, setup.motion, doppler=setup.doppler, doppler_span=setup.doppler_span, correlation=setup.correlation, particles=particles,
        detection=SnrDetection(amplitude.threshold**2) if isinstance(amplitude, AmplitudeModel) else None,
    )  # fmt: skip


def start_of(setup: Setup, rng: np.random.Generator, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Particles (N, 8) of the Gaussian prior and log weights (N,)."""
    root = np.linalg.cholesky(setup.covariance + 1e-18 * np.eye(4))
    state = setup.mean + rng.standard_normal((size, 4)) @ root.T
    speed = setup.speed + setup.speed_deviation * rng.standard_normal(size)
    height = setup.height if setup.spatial else 0.0
    position = np.column_stack([state[:, :2], np.full(size, height)])
    velocity = speed[:, None] * geometry.unit_vector(state[:, 2])
    return particles(position, velocity, state[:, 3], state[:, 2]), np.zeros(size)


def gaussian_start(setup: Setup) -> tuple[np.ndarray, np.ndarray]:
    """The prior in the motion's coordinates: mean (c,), covariance (c, c)."""
    x, y, heading, bias = setup.mean
    forward = geometry.unit_vector(np.array([heading]))
    place = np.array([[x, y, setup.height if setup.spatial else 0.0]])
    mean = setup.motion.coordinates(particles(place, setup.speed * forward, bias, np.array([heading])))[0]
    # Position 2, heading, bias and speed of the prior through the motion's own coordinates.
    root = np.zeros((5, 5))
    root[:4, :4] = np.asarray(setup.covariance)
    root[4, 4] = setup.speed_deviation**2
    slope = np.zeros((len(mean), 5))
    for j, step in enumerate(1e-5 * np.eye(5)):
        ends = []
        for sign in (1.0, -1.0):
            moved = np.array([x, y, heading, bias, setup.speed]) + sign * step
            velocity = moved[4] * geometry.unit_vector(moved[2:3])
            ends.append(
                setup.motion.coordinates(
                    particles([[moved[0], moved[1], place[0, 2]]], velocity, moved[3], moved[2:3])
                )[0]
            )
        slope[:, j] = (ends[0] - ends[1]) / 2e-5
    return mean, slope @ root @ slope.T


def paced(filter_: RaoBlackwell | Conditional, setup: Setup, pace: float) -> Any:
    """The filter whose next step is over ``pace`` periods of the motion."""
    return filter_ if pace == 1.0 else replace(filter_, motion=setup.motion.paced(float(pace)))


def beginning(filter_: RaoBlackwell | Conditional, setup: Setup, rng: np.random.Generator, particles: int):
    """State of the filter before the first scan."""
    if isinstance(filter_, Conditional):
        return filter_.start(*gaussian_start(setup), rng)
    return filter_.init(*start_of(setup, rng, particles))


def slam(scans: Scans, setup: Setup, *, particles: int, rng: np.random.Generator) -> History:
    """Track and map from measurements.

    Returns
    -------
    History
        The record that the EK-PMB filters give: states [x m, y m, heading rad, bias m] and the declared map.
    """
    filter_ = filter_of(scans, setup, particles=particles)
    state = beginning(filter_, setup, rng, particles)
    estimates = []
    for k, (pace, scan) in enumerate(zip(scans.pace(setup.motion.interval), scans_of(scans, setup), strict=True)):
        try:
            state, info = paced(filter_, setup, pace).step(rng, state, scan)
        except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
            raise FilterError(
                f"step {k}: belief propagation: {error}; the likely cause is a start far off, too wide or known exactly in "
                'part, and the remedy a start from a snapshot (filter.start = "snapshot")'
            ) from error
        estimates.append(common(info.estimate, setup.assumptions.types))
    return history_of_estimates(estimates)


def common(estimate: Estimate, types: tuple[Form, ...]) -> CommonEstimate:
    """An estimate as the filters' common record: several forms are one kind of landmark."""
    kinds = [Kind.SP if form == Form.PS else Kind.VA for form in types]
    return CommonEstimate(
        mean=np.array([*estimate.position[:2], estimate.heading, estimate.bias]),
        covariance=estimate.state_covariance,
        position=estimate.feature,
        position_covariance=estimate.feature_covariance,
        existence=estimate.existence,
        type_probability=estimate.type_belief @ np.eye(len(Kind))[kinds],
        track=estimate.label,
    )


def synchronized(setup: Setup) -> Setup:
    """The same setup with the clock known: no bias uncertainty and no walk (paper B's assumption)."""
    covariance = np.array(setup.covariance, float)
    covariance[3, :] = covariance[:, 3] = 0.0
    return replace(setup, covariance=covariance, motion=replace(setup.motion, bias_walk=0.0))
