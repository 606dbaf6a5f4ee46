"""The cases of a suite: which scenes, seeds and noise levels, and the detections of one of them.

A case is a generated scene whose paths are traced; its detections are what an efficient estimator would report of them.
A path of post-integration SNR ρ is detected with p_D(ρ); detected paths get Gaussian errors with their joint Cramér–Rao
bound (of the detected paths together) as covariance, to which the level ``rough`` adds errors of calibration, fresh in every
detection and told in its covariance; false detections are uniform over the search volume. Tracing takes
seconds, no signal is searched, so that a whole suite is made in minutes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dopslam.config.scenario import Scenario, parse
from dopslam.models.detection import probability_from_snr
from dopslam.models.measurement import wrap
from dopslam.models.scans import CLUTTER
from dopslam.pipeline import link
from dopslam.pipeline import stages as pipeline
from dopslam.pipeline.seeds import Component, generator
from dopslam.records import SPEED_OF_LIGHT, DetectionSeries, Landmarks, Paths, Track, edges_of
from estimation import PathTable
from estimation.fisher import crb, snr

KINDS = ("street", "plaza", "room", "corridor", "hall")
DEVELOP, TEST = "develop", "test"
FIRST_SCENE = {DEVELOP: 100, TEST: 4000}  # seed of the first scene of a kind
LEVELS = {  # dB on the transmit power of the scene, and errors of calibration beside those of noise [m, rad ×4, m/s]
    "sharp": (0.0, np.zeros(6)),
    "rough": (-8.0, np.array([0.05, 0.01, 0.01, 0.01, 0.01, 0.05])),
}
STEPS = 20
THRESHOLD = 14.0  # on ρ, linear
FALSE = 0.3  # detections per snapshot
WIDEST = 0.5  # rad, of the deviation of a direction: beyond it no estimator reports one


@dataclass(frozen=True)
class Case:
    """One case.

    Attributes
    ----------
    kind, scene : generator and its seed
    seed : of track, detections and false detections
    level : of :data:`LEVELS`
    split : ``develop`` or ``test``; by the scene, so that nothing can be tuned on the test half
    """

    kind: str
    scene: int
    seed: int
    level: str
    split: str

    @property
    def name(self) -> str:
        """Unique in a suite."""
        return f"{self.kind}-{self.scene}-{self.seed}-{self.level}"


def plan(
    scenes: int = 1, seeds: int = 2, first: dict[str, int] | None = None, kinds: tuple[str, ...] = KINDS
) -> list[Case]:
    """The cases of a suite: every kind, ``scenes`` of each in either split, ``seeds`` drives in each, at every level."""
    first = first or FIRST_SCENE
    return [
        Case(kind, scene, seed, level, split)
        for split, start in first.items()
        for kind in kinds
        for scene in range(start, start + scenes)
        for seed in range(seeds)
        for level in LEVELS
    ]


def scenario_of(case: Case, steps: int = STEPS) -> Scenario:
    """The scenario of a case, its power set by the level."""
    text = f'[scene]\ngenerator = "{case.kind}"\nseed = {case.scene}\n'
    shared = [f"track.steps={steps}", f"estimator.false_alarm_rate={FALSE}"]
    scenario = parse(text, shared, source=case.name)
    power = scenario.source.traced.transmit_power_dbm + LEVELS[case.level][0]
    return parse(text, [*shared, f"source.traced.transmit_power_dbm={power!r}"], source=case.name)


def told(scenario: Scenario, name: str) -> Scenario:
    """What a participant is told as a scenario that filters run on: all but the scene, its scatter points and its seed."""
    tree = scenario.model_dump(mode="python", exclude={"scatter_point"}, exclude_none=True)
    kept = {k: v for k, v in tree.items() if k not in ("scene", "name", "trace")}
    from tomli_w import dumps

    return parse(dumps({"name": name, "scene": {"builtin": "floor_wall"}, **kept}), source=name)


def detections_of(
    scenario: Scenario,
    track: Track,
    paths: Paths,
    rng: np.random.Generator,
    calibration: np.ndarray = LEVELS["sharp"][1],
) -> tuple[DetectionSeries, np.ndarray]:
    """Detections of traced paths as an efficient estimator reports them, and the landmark of each, −1 where it is false.

    ``calibration`` (6,) are standard deviations of further errors [m, rad ×4, m/s].
    """
    model, noise = link.signal_model(scenario), link.noise_variance(scenario)
    speed = scenario.estimator.max_radial_velocity
    reach = model.max_delay or float(paths.tau.max(initial=0.0)) * 2
    further = np.diag(np.square(calibration * _SCALE))
    tables, covariances, strengths, labels = [], [], [], []
    for step in range(track.steps):
        table = link.path_table(scenario, track, paths, step)
        seen = _detected(model, table, noise, rng)
        table = table.take(seen)
        covariance = crb(model, table, noise) + further if len(seen) else np.zeros((0, 6, 6))
        spread = np.sqrt(np.einsum("nii->ni", covariance)[:, 1:5])
        told_well = np.isfinite(covariance).all(axis=(1, 2)) & (spread < WIDEST).all(axis=1)
        strength = snr(model, table, noise) if len(seen) else np.zeros(0)
        root = np.linalg.cholesky(_conditioned(covariance[told_well]))
        drawn = table.vector[told_well] + (_SCALE * np.einsum("nij,nj->ni", root, rng.standard_normal(root.shape[:2])))
        rows = np.flatnonzero((np.abs(drawn[:, [2, 4]]) < np.pi / 2).all(axis=1))
        count = int(rng.poisson(FALSE))
        false, false_covariance = _false(count, covariance[told_well], reach, speed, rng)
        order = rng.permutation(len(rows) + count)
        tables.append(np.concatenate([drawn[rows], false])[order])
        covariances.append(np.concatenate([covariance[told_well][rows], false_covariance])[order])
        weak = THRESHOLD * (1 + rng.exponential(1 / THRESHOLD, count))
        strengths.append(np.concatenate([strength[told_well][rows], weak])[order])
        mine = paths.landmark[paths.rows(step)][seen][told_well][rows]
        labels.append(np.concatenate([mine, np.full(count, CLUTTER)])[order])
    z, counts = np.concatenate(tables), [len(t) for t in tables]
    rho = np.concatenate(strengths)
    series = DetectionSeries(
        offsets=edges_of(counts),
        delay=z[:, 0] % reach if model.max_delay else z[:, 0],
        aoa=np.column_stack([wrap(z[:, 1]), z[:, 2]]),
        aod=np.column_stack([wrap(z[:, 3]), z[:, 4]]),
        radial_velocity=z[:, 5],
        gain=np.zeros(len(z), complex),
        covariance=np.concatenate(covariances),
        snr=np.maximum(rho, 1e-6),
        noise_variance=np.full(track.steps, noise),
        threshold=THRESHOLD,
        false_alarm_rate=FALSE,
        search_volume=reach * SPEED_OF_LIGHT * (2 * np.pi * np.pi) ** 2 * 2 * speed,
        time=track.time,
        delay_range=model.max_delay or np.inf,
    )
    return series, np.concatenate(labels).astype(np.int64)


_SCALE = np.array([1 / SPEED_OF_LIGHT, 1, 1, 1, 1, 1])


def _conditioned(covariance: np.ndarray) -> np.ndarray:
    """Covariances with the delay as c·τ [m], where factors have their digits."""
    return covariance / _SCALE[:, None] / _SCALE


def _detected(model, table: PathTable, noise: float, rng: np.random.Generator) -> np.ndarray:
    """Paths that are detected: by their own strength, then by what the other detectable ones leave of it."""
    alone = np.array([snr(model, table.take([i]), noise)[0] for i in range(len(table))])
    candidates = np.flatnonzero(alone > 0.3 * THRESHOLD)
    if not len(candidates):
        return candidates
    rho = snr(model, table.take(candidates), noise)
    return candidates[rng.random(len(candidates)) < probability_from_snr(rho, THRESHOLD)]


def _false(count: int, like: np.ndarray, reach: float, speed: float, rng: np.random.Generator):
    """False detections (n, 6), uniform, with the covariance of the weakest real one of the snapshot."""
    low = np.array([0.0, -np.pi, -np.pi / 2, -np.pi, -np.pi / 2, -speed])
    high = np.array([reach, np.pi, np.pi / 2, np.pi, np.pi / 2, speed])
    if len(like):
        weakest = like[np.argmax(np.einsum("nii->n", like[:, 1:5, 1:5]))]
    else:
        weakest = np.diag(np.square([0.1 / SPEED_OF_LIGHT, 0.05, 0.05, 0.05, 0.05, 0.1]))
    return rng.uniform(low, high, (count, 6)), np.broadcast_to(weakest, (count, 6, 6))


@dataclass(frozen=True)
class Drawn:
    """A case as it was drawn: what is told, and what is not."""

    case: Case
    scenario: Scenario
    track: Track
    landmarks: Landmarks
    detections: DetectionSeries
    label: np.ndarray


def draw(case: Case, steps: int = STEPS) -> Drawn:
    """Trace a case and draw its detections."""
    scenario = scenario_of(case, steps)
    traced = pipeline.trace(scenario, case.seed)
    assert traced.paths is not None
    return drawn(case, scenario, traced.track, traced.landmarks, traced.paths)


def drawn(case: Case, scenario: Scenario, track: Track, landmarks: Landmarks, paths: Paths) -> Drawn:
    """A case on paths that are there."""
    rng = generator(case.seed, Component.DETECTIONS, list(LEVELS).index(case.level))
    detections, label = detections_of(scenario, track, paths, rng, LEVELS[case.level][1])
    return Drawn(case, told(scenario, case.name), track, landmarks, detections, label)


def at_level(case: Case, level: str) -> Case:
    """The same scene and drive at another level."""
    return replace(case, level=level)
