"""From a scenario to the parameter records of motion, simulation and filters, in one place."""

from __future__ import annotations

from dataclasses import fields, is_dataclass

import numpy as np

from dopslam.config.belief import BeliefConfig
from dopslam.config.scenario import Scenario
from dopslam.errors import ConfigError
from dopslam.filters import FILTERS
from dopslam.models.clocks import DriftingClock
from dopslam.models.detection import ConstantDetection
from dopslam.models.motion import CoordinatedTurn, MotionModel, Told, motion_of
from dopslam.models.probe import probed
from dopslam.models.scans import Scans
from dopslam.records import BaseStations, DetectionSeries, Kind, Landmarks
from dopslam.simulate.world import FixedNoise, Situation
from dopslam.slam.belief.records import TYPES, Assumptions
from dopslam.slam.filter import Capabilities, Filter, Problem
from estimation.plugins import blamed

MOTION_KEYS = (
    "speed_std", "turn_rate_std", "speed_walk", "turn_rate_walk", "position_walk", "heading_walk",
)  # fmt: skip
FREE_CLOCK = 1e5  # m per step: what stands for anything, and leaves a filter its digits


def true_motion(scenario: Scenario) -> CoordinatedTurn:
    """Coordinated turn, eq. (1), that tracks are drawn from."""
    track = scenario.track
    return CoordinatedTurn(track.period, np.diag(np.square(track.process_std)), track.speed, track.turn_rate)


def motion(scenario: Scenario) -> MotionModel:
    """How the receiver moves as the filter believes it: the motion model of ``filter.motion``.

    With ``filter.clock = "free"`` the clock bias is anything at every step, with ``"drift"`` it has a rate, one more state.
    """
    true, config = true_motion(scenario), scenario.filter
    noise = np.array(true.process_noise)
    if config.clock == "free":
        noise[3, 3] = FREE_CLOCK**2
    told = Told(
        interval=true.interval,
        pose_noise=noise,
        speed=true.speed,
        turn_rate=true.turn_rate,
        **{name: getattr(config, name) for name in MOTION_KEYS},
    )
    moving = probed(motion_of(config.motion, told, config.motion_options), config.motion)
    if config.clock == "drift":
        return DriftingClock(moving, config.clock_drift_std, config.clock_drift_walk)
    return moving


def start(scenario: Scenario, reading: str = "std") -> tuple[np.ndarray, np.ndarray]:
    """Mean (4,) and covariance (4, 4) that the receiver's start is drawn from.

    ``reading`` takes ``track.start_std`` as standard deviations (``"std"``) or, paper A's Section V to the letter, as
    variances (``"var"``).
    """
    spread = np.array(scenario.track.start_std)
    return np.array(scenario.track.start), np.diag(spread**2 if reading == "std" else spread)


def prior(scenario: Scenario, reading: str = "std") -> tuple[np.ndarray, np.ndarray]:
    """Mean (n,) and covariance (n, n) of what a filter knows at the start; n as in :func:`motion`."""
    return motion(scenario).prior(*start(scenario, reading))


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
    if scenario.track.file or scenario.track.waypoints:
        raise ConfigError(
            "track.file and track.waypoints say one drive, which is traced; the model source, Monte Carlo studies and datasets "
            "draw theirs: leave the key out"
        )
    model, landmarks = scenario.source.model, model_landmarks(scenario)
    mean, covariance = start(scenario, reading)
    return Situation(
        bs=np.array(scenario.base_station.position),
        kind=landmarks.kind.astype(np.int64),
        position=landmarks.position,
        motion=true_motion(scenario),
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


def scans(scenario: Scenario, detections: DetectionSeries) -> Scans:
    """Detections of a run as the filters read them."""
    return problem(scenario).scans(detections)


def problem(scenario: Scenario, reading: str = "std") -> Problem:
    """What every filter of this scenario is told; ``reading`` as in :func:`prior`."""
    config, model = scenario.filter, scenario.source.model
    mean, covariance = prior(scenario, reading)
    drawn = scenario.source.kind == "model"
    return Problem(
        stations=base_stations(scenario),
        mean=mean,
        covariance=covariance,
        motion=motion(scenario),
        height=scenario.receiver.height,
        detection=ConstantDetection(model.detection_probability, model.sp_range) if drawn else None,
        undetected=(config.intensity_va, config.intensity_sp),
        births=(config.birth_va, config.birth_sp),
        survival=config.survival,
        doppler_limit=doppler_limit(scenario),
        snapshot=config.start == "snapshot",
        yaw_std=float(np.deg2rad(scenario.base_station.yaw_std_deg)),
        restart=config.restart,
    )


def told(world: Situation, scenario: Scenario | None = None, doppler_limit: float | None = None) -> Problem:
    """The truth about a simulated world as a problem: a filter that is told it has nothing wrong but its own.

    Parameters
    ----------
    world : what detections are drawn from
    scenario : gives the intensities and the survival that filters assume; None: the defaults of :class:`Problem`
    doppler_limit : m/s; default the world's
    """
    config = scenario.filter if scenario is not None else None
    assumed = {} if config is None else {
        "undetected": (config.intensity_va, config.intensity_sp),
        "births": (config.birth_va, config.birth_sp),
        "survival": config.survival,
    }  # fmt: skip
    return Problem(
        stations=BaseStations(np.atleast_2d(np.asarray(world.bs, float)), np.zeros(1)),
        mean=world.prior_mean,
        covariance=world.prior_covariance,
        motion=world.motion,
        height=world.height,
        detection=world.noise.detection,
        doppler_limit=world.doppler_limit if doppler_limit is None else doppler_limit,
        **assumed,
    )


def chosen_filter(scenario: Scenario, name: str | None = None, doppler: bool = True) -> Filter:
    """The filter of a name, with the choices of ``[filter]`` and ``[belief]`` that it has.

    Parameters
    ----------
    name : of :data:`~dopslam.filters.FILTERS`, or ``module:Class``; default the scenario's
    doppler : whether it shall use Doppler, if it can

    Raises
    ------
    ConfigError
        If there is no such filter, or it has no option of ``[filter.options]``. A table in there with the name of a filter,
        ``[filter.options.batch]``, is for that filter alone.
    """
    config, belief = scenario.filter, scenario.belief
    name = name or config.density
    kind = FILTERS[name]
    own = _options_of(name)
    alone = {key: value for key, value in config.options.items() if isinstance(value, dict) and key in FILTERS}
    chosen = {key: value for key, value in config.options.items() if key not in alone} | alone.get(name, {})
    unknown = sorted(set(chosen) - own)
    if unknown:
        able = [other for other in FILTERS.sound() if unknown[0] in _options_of(other)]
        hint = f"; for {able[0]} alone it is filter.options.{able[0]}.{unknown[0]}" if able else ""
        raise ConfigError(
            f"filter.options.{unknown[0]}: the filter {name!r} has no such option; it has "
            f"{', '.join(sorted(own)) or 'none'}{hint}"
        )
    values = config.model_dump(exclude={"options", "motion_options"}) | {
        "assumptions": assumptions(belief, "single_bounce"),
        "false_alarm_tail": 0.1 if belief.false_alarm_tail is None else belief.false_alarm_tail,
        "doppler": doppler and motion(scenario).doppler,
    }
    with blamed(kind, f"filter {name!r} cannot be made", ConfigError):
        made = kind(**{key: value for key, value in (values | chosen).items() if key in own})
        fits = isinstance(made, Filter) and isinstance(made.capabilities, Capabilities)
    if not fits:
        raise ConfigError(
            f"filter {name!r}: {type(made).__name__} is no filter: it needs 'capabilities' (a dopslam.Capabilities), 'init' "
            "and 'step' (see docs/extending.md)"
        )
    return made


def _options_of(name: str) -> set[str]:
    kind = FILTERS[name]
    return {field.name for field in fields(kind)} if is_dataclass(kind) else set()


def assumptions(belief: BeliefConfig, types: str) -> Assumptions:
    """What ``[belief]`` says about the features; ``types`` holds where it leaves them open."""
    own = {field.name for field in fields(Assumptions)} - {"types"}
    return Assumptions(types=TYPES[belief.types or types], **belief.model_dump(include=own))
