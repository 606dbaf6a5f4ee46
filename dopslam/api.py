"""The verbs that ``import dopslam as ds`` offers: every stage on records in memory.

They are those of the command line, without its files::

    import dopslam as ds

    scenario = ds.load("ring_road", set=["trace.max_depth=2"])
    truth = ds.trace(scenario, seed=0)
    detections = ds.estimate(scenario, ds.synthesize(scenario, truth, seed=0))
    problem = ds.problem(scenario)
    joint = ds.slam(problem, detections, ds.filters.Joint(iterations=3))
    bound = ds.bound(problem, truth, detections)
    print(ds.evaluate(truth, bound, joint=joint))
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dopslam.config import scenario as config
from dopslam.config.scenario import Scenario
from dopslam.errors import ConfigError
from dopslam.evaluate.bounds import Bound
from dopslam.evaluate.run import Evaluation
from dopslam.filters import FILTERS
from dopslam.pipeline import ahead, stages
from dopslam.pipeline import problem as build
from dopslam.pipeline.judge import judged
from dopslam.pipeline.stages import SyntheticSignal, Truth
from dopslam.records import DetectionSeries
from dopslam.report import tables
from dopslam.simulate.world import Situation
from dopslam.slam import filter as filtering
from dopslam.slam.filter import Filter, Problem
from dopslam.slam.history import History
from dopslam.slam.snapshot.start import locate as locate
from dopslam.studies import montecarlo as studies


def load(scene: str | Path, set: Sequence[str] = ()) -> Scenario:
    """A scenario: a folder with ``scenario.toml``, that file, or the name of a shipped scene.

    Parameters
    ----------
    scene : where it is
    set : ``key.path=value`` texts that override keys, as ``--set`` does

    Raises
    ------
    ConfigError
        Naming the file, the key with its path, the value, and for a misspelt key the nearest right one.
    """
    return config.load(scene, list(set))


def trace(scenario: Scenario, seed: int = 0) -> Truth:
    """Drive the track through the scene and trace every path of every step."""
    return stages.trace(scenario, seed)


def simulate(scenario: Scenario, seed: int = 0) -> tuple[Truth, DetectionSeries]:
    """Track, landmarks, and detections drawn from the measurement model (paper A, Section V); needs no tracer."""
    scenario = config.override(scenario, ["source.kind=model"])
    track, landmarks, detections = stages.simulate(scenario, seed)
    return Truth(scenario, seed, track, landmarks), detections


def synthesize(scenario: Scenario, truth: Truth, seed: int = 0) -> SyntheticSignal:
    """The received signal of every step, eq. (2); ``snapshot(k)`` makes that of step k when it is asked for."""
    if truth.paths is None:
        raise ConfigError("synthesize: a simulated run has no paths; take one from dopslam.trace")
    return SyntheticSignal(scenario.to_toml(), truth.track, truth.paths, seed)


def estimate(scenario: Scenario, signal: Any, jobs: int = 1) -> DetectionSeries:
    """Detections of every snapshot by the scenario's estimator.

    ``signal`` is what :func:`synthesize` gives, or anything with ``steps``, ``time`` ((K,) s or None) and ``snapshot(k)``,
    complex (subcarriers, symbols, receive elements).
    """
    return stages.estimate(scenario, signal, jobs)


def problem(scenario: Scenario) -> Problem:
    """All that a filter is told."""
    return build.problem(scenario)


def world(scenario: Scenario) -> Situation:
    """What the model source draws from, for :func:`montecarlo`."""
    return build.situation(scenario)


def slam(problem: Problem, detections: DetectionSeries, chosen: Filter | str, seed: int = 0) -> History:
    """Track and map from detections.

    Parameters
    ----------
    problem : what the filter is told
    detections : of an estimator, own ones included
    chosen : a filter with its choices, or its name for the default ones
    seed : of a filter that draws

    Raises
    ------
    FilterError
        If the filter cannot do what the problem asks, or fails.
    """
    used = FILTERS[chosen]() if isinstance(chosen, str) else chosen
    where = f"{type(used).__module__}:{type(used).__qualname__}"
    names = [name for name, place in FILTERS.shipped.items() if place == where]
    return ahead.sooner(names, filtering.run, problem, detections, used, seed)[0]


def bound(
    problem: Problem,
    truth: Truth,
    detections: DetectionSeries,
    doppler: bool = True,
    smoothed: bool = False,
    lag: int | None = None,
) -> Bound:
    """Posterior Cramér–Rao bound (17) of this run: the true track, the detections with their R, the true association.

    ``smoothed`` bounds every step by the detections of the whole run, for filters that read it before they answer, or, with
    ``lag``, by those up to so many steps later.
    """
    run = truth.scenario, truth.track, truth.landmarks, truth.paths
    return stages.bound(*run, detections, doppler, smoothed, problem, lag=lag)


@dataclass(frozen=True)
class Result:
    """How good runs are; printed, it is the table that a run ends with.

    Attributes
    ----------
    summary : the content of ``summary.json``
    evaluations : errors and bounds per step, by the name of the filter
    """

    summary: dict[str, Any]
    evaluations: dict[str, Evaluation]

    def __str__(self) -> str:
        return tables.as_text(tables.run_table(self.summary))


def evaluate(truth: Truth, bound: Bound, detections: DetectionSeries | None = None, **histories: History) -> Result:
    """Compare histories, each given by a name, with the truth and the bound; names of the table of filters are known.

    ``detections`` tells which landmarks were ever seen, and how good the detections are.
    """
    if not histories:
        raise ConfigError("evaluate: name at least one history, for instance evaluate(truth, bound, joint=history)")
    true = (truth.track, truth.landmarks, truth.paths)
    return Result(*judged(truth.scenario, truth.seed, true, detections, histories, dict.fromkeys(histories, bound)))


@dataclass(frozen=True)
class Runs:
    """Many runs of several filters on the same draws; printed, their ratios to the bound.

    Attributes
    ----------
    results : the figures of ``dopslam montecarlo --json``, by the name of the filter
    """

    results: dict[str, dict[str, Any]]

    def __str__(self) -> str:
        return tables.as_text(tables.ratios(self.results))


def montecarlo(
    world: Situation,
    problem: Problem | None,
    filters: Mapping[str, Filter],
    runs: int = 100,
    seed: int = 0,
    jobs: int = 1,
) -> Runs:
    """Every filter on the same draws of a world: run r depends on the seed and r only.

    Parameters
    ----------
    world : what tracks and detections are drawn from
    problem : what the filters are told; None: the truth. Detections that are drawn without strengths have no p_D of their
        own: a problem that leaves it open, as that of a traced scenario does, takes the world's
    filters : by the name in the table
    """
    if problem is not None and problem.detection is None:
        problem = replace(problem, detection=build.told(world).detection)
    found = {}
    for name, chosen in filters.items():
        study = studies.Study(world, chosen, problem)
        found[name] = studies.summarize(studies.run_study(study, runs, seed, jobs), study)
    return Runs(found)
