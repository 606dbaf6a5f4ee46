"""The stages, one function each: trace → synthesize → estimate → slam → bound → evaluate.

Every stage takes and returns records, so that anyone can enter or leave at any of them. Random numbers come from
:mod:`dopslam.pipeline.seeds`: results do not depend on the number of workers or on which stages ran together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from dopslam.config.scenario import Scenario, parse
from dopslam.evaluate import detections as matching
from dopslam.evaluate.bounds import Bound, detection_mask, pcrb
from dopslam.evaluate.run import true_association
from dopslam.models import unmeasured
from dopslam.models.measurement import measure, seen_noise
from dopslam.models.pose import Pose
from dopslam.models.scans import CLUTTER
from dopslam.pipeline import link as radio
from dopslam.pipeline import preflight
from dopslam.pipeline import problem as build
from dopslam.pipeline.judge import match_series
from dopslam.pipeline.own import own_track
from dopslam.pipeline.seeds import Component, generator
from dopslam.pipeline.signals import Snapshots
from dopslam.records import SPEED_OF_LIGHT, DetectionSeries, FloorPlan, Kind, Landmarks, Mesh, Paths, Track, edges_of
from dopslam.simulate import world as simulate_module
from dopslam.slam.filter import Problem, later
from dopslam.slam.filter import run as run_filter
from dopslam.slam.health import divergence
from dopslam.slam.history import History

Progress = Callable[[str, int, int], None]


def quiet(stage: str, done: int, total: int) -> None:
    """Progress callback that shows nothing."""


@dataclass(frozen=True)
class Truth:
    """The truth of a run and what it was made from; without a tracer there are neither paths nor plan nor mesh."""

    scenario: Scenario
    seed: int
    track: Track
    landmarks: Landmarks
    paths: Paths | None = None
    plan: FloorPlan | None = None
    mesh: Mesh | None = None


def drawn_states(scenario: Scenario, rng: np.random.Generator, steps: int | None = None) -> np.ndarray:
    """States (K, 4) of ``steps`` steps from the motion model, eq. (1), or exactly its mean."""
    world = build.situation(scenario)
    world = world if steps is None else replace(world, steps=steps)
    return simulate_module.draw_track(world, rng) if scenario.track.random else simulate_module.nominal_track(world)


def draw_track(scenario: Scenario, seed: int) -> Track:
    """The receiver's true track: its own drive, or drawn from the motion model, eq. (1), or exactly its mean."""
    if scenario.track.file or scenario.track.waypoints:
        return own_track(scenario, seed)
    config, state = scenario.track, drawn_states(scenario, generator(seed, Component.TRACK))
    heading = state[:, 2]
    forward = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(len(state))])
    return Track(
        time=config.period * np.arange(1, len(state) + 1),
        position=np.column_stack([state[:, :2], np.full(len(state), scenario.receiver.height)]),
        heading=heading,
        velocity=config.speed * forward,
        bias=state[:, 3],
        start=np.array(config.start),
    )


def tracing_inputs(scenario: Scenario, seed: int):
    """What the tracer needs of a scenario: scene source, scatter points with drawn phases, settings."""
    from dopslam import raytracing

    points = raytracing.ScatterPoints(
        names=tuple(p.name for p in scenario.scatter_point),
        positions=np.array([p.position for p in scenario.scatter_point]).reshape(-1, 3),
        rcs=np.array([p.rcs for p in scenario.scatter_point]),
        phases=generator(seed, Component.SCATTER).uniform(0, 2 * np.pi, len(scenario.scatter_point)),
    )
    settings = raytracing.TraceSettings(
        max_depth=scenario.trace.max_depth, samples=scenario.trace.samples, seed=scenario.trace.seed
    )
    return preflight.scene_source(scenario), points, settings


def trace(scenario: Scenario, seed: int, progress: Progress = quiet) -> Truth:
    """Drive the track through the scene and trace every path of every step.

    Raises
    ------
    SceneError, LLVMError
        See :class:`dopslam.raytracing.Tracer`.
    """
    from dopslam import raytracing

    track = draw_track(scenario, seed)
    carrier = scenario.radio.carrier_frequency
    _, points, settings = tracing_inputs(scenario, seed)
    progress("trace", 0, track.steps)
    loaded = preflight.checked_scene(scenario, track.position)
    landmarks, paths = raytracing.trace(
        loaded, carrier, np.array(scenario.base_station.position), track.position, track.velocity, points, settings
    )
    progress("trace", track.steps, track.steps)
    plan = _plan(raytracing.floor_plan(loaded.surfaces, scenario.receiver.height))
    return Truth(scenario, seed, track, landmarks, paths, plan, Mesh(loaded.surfaces.triangles.astype(np.float32)))


def _plan(outlines: list[tuple[str, np.ndarray]]) -> FloorPlan:
    counts = [len(line) for _, line in outlines]
    return FloorPlan(
        name=np.array([name for name, _ in outlines], dtype=str),
        offsets=np.concatenate([[0], np.cumsum(counts)]).astype(int),
        points=np.concatenate([line for _, line in outlines]) if outlines else np.zeros((0, 2)),
    )


def synthesize_snapshot(
    scenario: Scenario, track: Track, paths: Paths, step: int, seed: int, number: int | None = None
) -> np.ndarray:
    """Received signal of one step, eq. (2): complex64 (subcarriers, symbols, receive elements) in √W.

    Its noise is that of the ``number`` of the step, where that counts from elsewhere: in a dataset of many parts.
    """
    from estimation import synthesize

    number = step if number is None else number
    rng = generator(seed, Component.NOISE, number)
    table = radio.path_table(scenario, track, paths, step)
    model, noise, hardware = _model(scenario.to_toml()), radio.noise_variance(scenario), radio.impairments(scenario)
    if hardware is None:
        return synthesize(model, table, noise, rng)
    own = scenario.source.traced.impairments.seed
    return hardware.signal(model, table, noise, rng, own, generator(seed, Component.HARDWARE, number))


def synthesize(
    scenario: Scenario, track: Track, paths: Paths, seed: int, progress: Progress = quiet
) -> Iterator[np.ndarray]:
    """Snapshots of all steps, one at a time."""
    for step in range(paths.steps):
        yield synthesize_snapshot(scenario, track, paths, step, seed)
        progress("synthesize", step + 1, paths.steps)


@lru_cache(maxsize=2)
def _model(scenario_toml: str):
    """The signal model of a scenario; kept since its codebooks serve every snapshot."""
    return radio.signal_model(parse(scenario_toml))


@lru_cache(maxsize=2)
def _estimator(scenario_toml: str, threshold: float | None = None):
    """The estimator of a scenario; kept since its dictionaries serve every snapshot.

    Without ``threshold`` it is calibrated on noise for the scenario's false-alarm rate.
    """
    return radio.estimator(parse(scenario_toml), _model(scenario_toml), threshold)


@dataclass(frozen=True)
class SyntheticSignal:
    """Snapshots made when asked for: none is ever stored."""

    scenario_toml: str
    track: Track
    paths: Paths
    seed: int

    @property
    def steps(self) -> int:
        """Number of snapshots."""
        return self.paths.steps

    @property
    def time(self) -> np.ndarray:
        """(K,) s of every snapshot."""
        return self.track.time

    def snapshot(self, step: int) -> np.ndarray:
        """Received signal of one step."""
        return synthesize_snapshot(parse(self.scenario_toml), self.track, self.paths, step, self.seed)


def _estimate_steps(scenario_toml: str, threshold: float | None, signal, steps: list[int]) -> list:
    from estimation.estimators import estimated

    estimator = _estimator(scenario_toml, threshold)
    return [(step, estimated(estimator, signal.snapshot(step))) for step in steps]


def estimate(scenario: Scenario, signal: Snapshots, jobs: int = 1, progress: Progress = quiet) -> DetectionSeries:
    """Detections of every snapshot, estimated without a look at the truth.

    Parameters
    ----------
    scenario : its radio and estimator parts are used
    signal : where snapshots come from
    jobs : worker processes; the result does not depend on it
    progress : callback (stage, done, total)
    """
    from joblib import Parallel, delayed

    text = scenario.to_toml()
    chunk = max(1, min(5, signal.steps // jobs))
    chunks = [list(range(first, min(first + chunk, signal.steps))) for first in range(0, signal.steps, chunk)]
    parallel = Parallel(n_jobs=jobs, return_as="generator_unordered")
    found: dict[int, object] = {}
    progress("estimate", 0, signal.steps)
    threshold = getattr(_estimator(text), "threshold", None)  # calibrated once, on noise alone
    for done in parallel(delayed(_estimate_steps)(text, threshold, signal, steps) for steps in chunks):
        found.update(done or ())
        progress("estimate", len(found), signal.steps)
    return stack_detections(scenario, [found[step] for step in range(signal.steps)], signal.time)


def stack_detections(scenario: Scenario, snapshots: list, time: np.ndarray | None = None) -> DetectionSeries:
    """Detections of single snapshots (``estimation.Detections``) as one record; ``time`` (K,) s where it is known."""
    model = _model(scenario.to_toml())
    speed = scenario.estimator.max_radial_velocity
    # Azimuths cover the circle, elevations count as (−π/2, π/2): the volume that false paths can fall into.
    widths = np.array([model.max_delay, 2 * np.pi, np.pi, 2 * np.pi, np.pi, 2 * speed])
    counts = [len(d.delay) for d in snapshots]

    def column(name):
        return np.concatenate([getattr(d, name) for d in snapshots])

    covariance, missing = unmeasured.filled(column("covariance"), widths)
    return DetectionSeries(
        offsets=edges_of(counts),
        **{n: column(n) for n in ("delay", "aoa", "aod", "radial_velocity", "gain", "snr")},
        covariance=covariance,
        flags=column("flags").astype(np.int64),
        noise_variance=np.array([d.noise_variance for d in snapshots]),
        threshold=float(snapshots[0].threshold),
        false_alarm_rate=scenario.estimator.false_alarm_rate,
        search_volume=unmeasured.volume(widths * [SPEED_OF_LIGHT, 1, 1, 1, 1, 1], missing),
        time=time,
        delay_range=model.max_delay or np.inf,
    )


def simulate(scenario: Scenario, seed: int) -> tuple[Track, Landmarks, DetectionSeries]:
    """A run of the model source: track, landmarks, and detections drawn from the measurement model."""
    world, landmarks = build.situation(scenario), build.model_landmarks(scenario)
    track = draw_track(scenario, seed)
    rng, clutter = (generator(seed, Component.DETECTIONS, part) for part in range(2))
    drawn = simulate_module.draw_scans(world, track.state, rng, clutter)
    scale = np.array([1 / SPEED_OF_LIGHT, 1, 1, 1, 1, 1])
    detections = DetectionSeries(
        offsets=drawn.offsets,
        delay=drawn.z[:, 0] * scale[0],
        aoa=drawn.z[:, 1:3],
        aod=drawn.z[:, 3:5],
        radial_velocity=drawn.z[:, 5],
        gain=np.zeros(len(drawn.z), complex),
        covariance=drawn.covariance * scale[:, None] * scale,
        snr=np.ones(len(drawn.z)),
        noise_variance=np.ones(drawn.steps),
        threshold=1.0,
        false_alarm_rate=drawn.clutter_count,
        search_volume=drawn.search_volume,
        time=track.time,
    )
    return track, landmarks, detections


def blur(scenario: Scenario, detections: DetectionSeries, seed: int) -> DetectionSeries:
    """The same detections with noise of the model source's R added, and R added to their covariances.

    Takes sharp detections to the accuracy of paper A's Section V without touching which paths are found.
    """
    std = build.measurement_std(scenario) * [1 / SPEED_OF_LIGHT, 1, 1, 1, 1, 1]
    noise = generator(seed, Component.DETECTIONS, 2).standard_normal((len(detections.delay), 6)) * std
    return replace(
        detections,
        delay=detections.delay + noise[:, 0],
        aoa=detections.aoa + noise[:, 1:3],
        aod=detections.aod + noise[:, 3:5],
        radial_velocity=detections.radial_velocity + noise[:, 5],
        covariance=detections.covariance + np.diag(std**2),
    )


def slam(
    scenario: Scenario, detections: DetectionSeries, name: str | None = None, doppler: bool = True, seed: int = 0
) -> History:
    """Track and map from detections; the filter is told what :func:`dopslam.pipeline.problem.problem` says, and no more.

    Parameters
    ----------
    name : of :data:`dopslam.filters.FILTERS`, or ``module:Class``; default the scenario's
    doppler : whether the Doppler row is used, if the filter can
    seed : of a filter that draws

    Raises
    ------
    FilterError
        If the detections cannot be filtered.
    """
    problem = build.problem(scenario)
    scans = problem.scans(detections)
    history, told = run_filter(problem, scans, build.chosen_filter(scenario, name, doppler), seed)
    lost = history.lost if problem.restart else divergence(history, scans, problem.anchor, problem.height)
    return replace(history, lost=lost, nis_per_row=told.nis_per_row, passed_over=int(told.passed_over.sum()))


def uses_doppler(scenario: Scenario, name: str) -> bool:
    """Whether a filter can use Doppler: without a velocity in its motion model nobody can."""
    return build.chosen_filter(scenario, name).capabilities.doppler and build.motion(scenario).doppler


def reads_later(scenario: Scenario, name: str) -> tuple[bool, int | None]:
    """Which bound is a filter's own, as :func:`bound` takes it: ``smoothed`` and ``lag``."""
    return later(build.chosen_filter(scenario, name))


def landmark_of_detections(
    scenario: Scenario, track: Track, landmarks: Landmarks, paths: Paths | None, detections: DetectionSeries
) -> np.ndarray:
    """(N,) landmark that each detection stems from by the truth, −1 for false ones; for bounds and evaluation only."""
    if paths is not None:
        matches = match_series(scenario, track, paths, detections)
        return matching.true_landmarks(matches, paths, detections)
    count = len(landmarks)
    pose = Pose(track.position[:, None], track.velocity[:, None], track.heading[:, None], track.bias[:, None])
    exact = measure(pose, landmarks.position, landmarks.kind, np.array(scenario.base_station.position))
    return true_association(
        build.scans(scenario, detections),
        exact.reshape(-1, 6),
        count * np.arange(track.steps + 1),
        np.tile(np.arange(count), track.steps),
    )


def bound(
    scenario: Scenario,
    track: Track,
    landmarks: Landmarks,
    paths: Paths | None,
    detections: DetectionSeries,
    doppler: bool = True,
    smoothed: bool = False,
    problem: Problem | None = None,
    label: np.ndarray | None = None,
    lag: int | None = None,
) -> Bound:
    """PCRB (17) at the true track with the R and the detections of this run and the true association.

    With ``smoothed`` every step is bounded by the detections of the whole run instead of those up to it, or, with ``lag``, of
    those up to so many steps later.

    Paths of two reflections tell what they tell the filters, everything but their departure, unless ``[filter]`` has no
    such type; those of more carry no information here. ``problem`` is what the filter is told; default the scenario's; ``label`` (N,)
    the landmark of each detection where it is known, default by :func:`landmark_of_detections`.
    """
    scans = build.scans(scenario, detections)
    label = landmark_of_detections(scenario, track, landmarks, paths, detections) if label is None else label.copy()
    kind = landmarks.kind.astype(np.int64)
    kind[(kind == Kind.VA) & (landmarks.order > 1)] = Kind.SR
    label[landmarks.order[label] > (1 if scenario.filter.intensity_sr == 0 else 2)] = CLUTTER
    covariance = np.broadcast_to(np.eye(6), (track.steps, len(landmarks), 6, 6)).copy()
    step = np.repeat(np.arange(scans.steps), np.diff(scans.offsets))
    real = label >= 0
    covariance[step[real], label[real]] = seen_noise(scans.covariance[real], kind[label[real]])
    problem = problem or build.problem(scenario)
    return pcrb(
        *problem.motion.truth(track),
        problem.covariance,
        problem.motion,
        landmarks.position,
        kind,
        covariance,
        detection_mask(label, scans.offsets, len(landmarks)),
        np.array(scenario.base_station.position),
        height=scenario.receiver.height,
        doppler=doppler,
        smoothed=smoothed,
        lag=lag,
        pace=scans.pace(problem.motion.interval),
    )
