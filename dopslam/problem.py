"""From a scenario to the parameter records of motion, simulation and filters, in one place."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from dopslam.config.belief import BeliefConfig
from dopslam.config.scenario import Scenario
from dopslam.models import ambiguity
from dopslam.models.detection import ConstantDetection, DetectionModel, SnrDetection
from dopslam.models.motion import CoordinatedTurn
from dopslam.models.scans import Scans, from_detections
from dopslam.records import BaseStations, DetectionSeries, Kind, Landmarks
from dopslam.simulate.world import FixedNoise, Situation
from dopslam.slam.belief.adapter import Setup, turning
from dopslam.slam.belief.records import TYPES, Assumptions
from dopslam.slam.pmb.ek_pmb import FilterParameters
from dopslam.slam.snapshot import start as snapshot


def motion(scenario: Scenario) -> CoordinatedTurn:
    """Coordinated turn, eq. (1), with the scenario's speed and turn rate, both known to the filter."""
    track = scenario.track
    return CoordinatedTurn(track.period, np.diag(np.square(track.process_std)), track.speed, track.turn_rate)


def prior(scenario: Scenario, reading: str = "std") -> tuple[np.ndarray, np.ndarray]:
    """Mean (4,) and covariance (4, 4) of the receiver's initial knowledge.

    ``reading`` takes ``track.start_std`` as standard deviations (``"std"``) or, paper A's Section V to the letter, as
    variances (``"var"``).
    """
    spread = np.array(scenario.track.start_std)
    return np.array(scenario.track.start), np.diag(spread**2 if reading == "std" else spread)


def start(scenario: Scenario, scans: Scans, doppler: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of what a filter starts from: the scenario's, or found from the scans alone.

    Raises
    ------
    FilterError
        If ``filter.start`` is ``"snapshot"`` and no scan tells where the receiver is.
    """
    if scenario.filter.start == "prior":
        return prior(scenario)
    bs = np.array(scenario.base_station.position)
    found = snapshot.start(scans, motion(scenario), bs, scenario.receiver.height, doppler=doppler)
    return found.mean, found.covariance


def base_stations(scenario: Scenario) -> BaseStations:
    """The base stations as the table that ``anchor`` columns count."""
    station = scenario.base_station
    return BaseStations(np.array([station.position], float), np.deg2rad([float(station.yaw_deg)]))


def model_landmarks(scenario: Scenario) -> Landmarks:
    """Landmarks that the model source draws detections from: the BS, the listed VAs, the scatter points."""
    anchors, points = scenario.source.model.virtual_anchors, scenario.scatter_point
    return Landmarks(
        name=np.array(["BS", *(f"VA{i}" for i in range(len(anchors))), *(f"SP {p.name}" for p in points)]),
        kind=np.array([Kind.BS] + [Kind.VA] * len(anchors) + [Kind.SP] * len(points), dtype=np.int8),
        position=np.array([scenario.base_station.position, *anchors, *(p.position for p in points)]),
        order=np.array([0] + [1] * (len(anchors) + len(points))),
    )


def measurement_std(scenario: Scenario) -> np.ndarray:
    """Standard deviations (6,) of the model source [m, rad ×4, m/s]."""
    model = scenario.source.model
    return np.array([model.range_std, *[model.angle_std] * 4, model.doppler_std])


def situation(scenario: Scenario, reading: str = "std") -> Situation:
    """The world of the model source (paper A, Section V)."""
    model, landmarks = scenario.source.model, model_landmarks(scenario)
    mean, covariance = prior(scenario, reading)
    return Situation(
        bs=np.array(scenario.base_station.position),
        kind=landmarks.kind.astype(np.int64),
        position=landmarks.position,
        motion=motion(scenario),
        prior_mean=mean,
        prior_covariance=covariance,
        steps=scenario.track.steps,
        noise=FixedNoise(measurement_std(scenario), model.detection_probability, model.sp_range),
        clutter_count=model.clutter_rate,
        clutter_range=model.clutter_range,
        doppler_limit=doppler_limit(scenario),
        height=scenario.receiver.height,
    )


def doppler_limit(scenario: Scenario) -> float:
    """Largest radial velocity [m/s] that detections can have: the drive's speed where the model draws them, else what
    the estimator searches. A receiver that stands still bounds nothing by its own speed."""
    moving = scenario.source.kind == "model" and scenario.track.speed > 0
    return scenario.track.speed if moving else scenario.estimator.max_radial_velocity


def unwrapped(scenario: Scenario, detections: DetectionSeries) -> DetectionSeries:
    """The detections with every delay in the turn of the link's range that the prior says.

    A start from the scans alone knows nothing of the receiver; then the delays themselves say where they begin, and the
    scenario's clock bias only which of the turns is meant, which nothing else could say.
    """
    mean, covariance = prior(scenario)
    if scenario.filter.start == "snapshot":
        covariance = covariance + np.diag([1.0, 1.0, 0.0, 1.0]) * ambiguity.UNKNOWN**2
    station = np.array(scenario.base_station.position)
    return ambiguity.unwrapped(detections, (mean, covariance), motion(scenario), station, scenario.receiver.height)


def scans(scenario: Scenario, detections: DetectionSeries) -> Scans:
    """Detections of a run as the filters read them."""
    yaw = np.deg2rad(scenario.base_station.yaw_deg)
    return from_detections(unwrapped(scenario, detections), bs_yaw=yaw, doppler_span=2 * doppler_limit(scenario))


def detection_model(scenario: Scenario, threshold: float) -> DetectionModel:
    """p_D that follows the SNR of the detections (``threshold`` on ρ), or the constant of the model source."""
    if scenario.source.kind == "traced":
        return SnrDetection(threshold)
    model = scenario.source.model
    return ConstantDetection(model.detection_probability, model.sp_range)


def belief_setup(scenario: Scenario, known: tuple[np.ndarray, np.ndarray] | None = None) -> Setup:
    """What belief propagation is told: start (``known``, else the scenario's) and motion as the other filters, the rest
    from ``[belief]``."""
    track, belief = scenario.track, scenario.belief
    mean, covariance = known or prior(scenario)
    return Setup(
        anchor=np.array(scenario.base_station.position),
        height=scenario.receiver.height,
        mean=mean,
        covariance=covariance,
        motion=turning(track.period, track.turn_rate, np.array(track.process_std)),
        speed=track.speed,
        yaw=float(np.deg2rad(scenario.base_station.yaw_deg)),
        assumptions=assumptions(belief, "single_bounce"),
        false_alarm_tail=0.1 if belief.false_alarm_tail is None else belief.false_alarm_tail,
        doppler_span=2 * doppler_limit(scenario),
    )


def assumptions(belief: BeliefConfig, types: str) -> Assumptions:
    """What ``[belief]`` says about the features; ``types`` holds where it leaves them open."""
    own = {field.name for field in fields(Assumptions)} - {"types"}
    return Assumptions(types=TYPES[belief.types or types], **belief.model_dump(include=own))


def filter_parameters(
    scenario: Scenario, detection: DetectionModel, density: str | None = None, doppler: bool = True
) -> FilterParameters:
    """The filter's parameters; ``density`` overrides the scenario's ``joint`` or ``marginal``."""
    config = scenario.filter
    return FilterParameters(
        joint=(density or config.density) == "joint",
        doppler=doppler,
        iterations=config.iterations,
        associations=config.associations,
        gate=config.gate,
        survival=config.survival,
        intensity=(config.intensity_va, config.intensity_sp),
        prune=config.prune_existence,
        cubature=config.linearization == "cubature",
        reweight=config.reweight,
        birth_intensity=(config.birth_va, config.birth_sp),
        thinning=config.thinning,
        detection=detection,
    )
