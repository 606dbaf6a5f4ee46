"""The control experiment of belief propagation: what the correlation between agent and features is worth.

Three filters on the same detections: features given the agent (``kept``); the same code with the correlation dropped after
every step and everything else equal (``dropped``); and paper B's form, particles and marginals (``independent``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dopslam.config.scenario import Scenario
from dopslam.evaluate.run import evaluate_run, summarize
from dopslam.pipeline import file as files
from dopslam.pipeline import problem as build
from dopslam.pipeline import stages
from dopslam.pipeline.stages import Progress, quiet
from dopslam.slam.belief.conditional.filter import Conditional
from dopslam.slam.belief.filter import Belief
from dopslam.slam.belief.records import Form
from dopslam.slam.filter import run as run_filter
from dopslam.studies.bp_cases import CASES
from dopslam.studies.bp_study import one_run, summary
from dopslam.studies.traced import NOISES, largest_order, prepare
from estimation import statistics

VARIANTS = ("kept", "dropped", "independent")


def synthetic(runs: int, seed: int = 1, case: str = "aod", particles: int = 1000, steps: int | None = None) -> dict:
    """The pedestrian experiment (``case`` of :data:`~dopslam.studies.bp_cases.CASES`): figures of every variant."""
    chosen, found = CASES[case], {}
    if steps is not None:
        chosen = replace(chosen, experiment=replace(chosen.experiment, steps=steps))
    for name in VARIANTS:
        features = "independent" if name == "independent" else "conditional"
        parameters = replace(chosen.experiment.parameters, features=features, agent="gaussian")
        filter_ = replace(chosen, parameters=parameters, particles=particles).filter
        if isinstance(filter_, Conditional):
            filter_ = replace(filter_, correlation=name == "kept")
        found[name] = summary(
            [one_run(chosen.experiment, filter_, particles, (seed, r), informed=chosen.informed) for r in range(runs)]
        )
    return found


def traced(
    scenario: Scenario, seeds: Sequence[int], folder: Path, noise: str = "estimator", jobs: int = 1,
    progress: Progress = quiet,
) -> dict:  # fmt: skip
    """A traced scene: for every variant mean and 95 % interval over the seeds of × PEB and NEES, and the landmarks found.

    Parameters
    ----------
    folder : existing folder that keeps the datasets; complete ones are used again
    noise : of :data:`~dopslam.studies.traced.NOISES`
    """
    figures: dict[str, list[dict]] = {name: [] for name in VARIANTS}
    for seed in seeds:
        path = prepare(scenario, seed, folder, jobs, progress)
        own, _ = files.scenario_of(path, (f"source.traced.added_noise={NOISES[noise]}",))
        track, landmarks, paths, _ = files.read_truth(path)
        detections = files.blurred(own, files.read_detections(path), seed)
        bounds = {d: stages.bound(own, track, landmarks, paths, detections, d) for d in (True, False)}
        order, chosen = largest_order("bp", landmarks), build.chosen_filter(own, "bp")
        assert isinstance(chosen, Belief)
        for name in VARIANTS:
            independent = name == "independent"
            assumed = replace(
                chosen.assumptions, features="independent" if independent else "conditional", agent="gaussian"
            )
            variant = replace(chosen, assumptions=assumed, correlation=name == "kept")
            history, _ = run_filter(build.problem(own), detections, variant, seed)
            run = evaluate_run(own, track, landmarks, history, bounds[not independent], order)
            figures[name].append(summarize(run, landmarks, own.evaluation.found_radius))
    return {
        name: {
            "position_over_bound": statistics.mean([run["rmse_over_bound"]["position"] for run in runs]),
            "nees": statistics.mean([run["nees"] for run in runs]),
            "found": int(sum(run["va_found"] + run["sp_found"] for run in runs)),
            "of": int(sum(run["va_total"] + run["sp_total"] for run in runs)),
        }
        for name, runs in figures.items()
    }


def floating_map(steps: int = 30, seed: int = 0) -> dict[str, float]:
    """The smallest case: a receiver that stands still, ±0.5 m in x and y, and three walls but no line of sight.

    Walls that are mapped from the receiver say nothing about where it is: its standard deviation must stay at 0.5 m.

    Returns
    -------
    dict
        Standard deviation [m] per axis after the last step, correlation kept and dropped.
    """
    from dopslam.slam.belief.experiment import Experiment
    from dopslam.slam.belief.geometry import predict
    from dopslam.slam.belief.motion import ConstantVelocity
    from dopslam.slam.belief.records import Scan

    experiment, rng = Experiment(), np.random.default_rng(seed)
    place = np.array([6.0, -4.0, 0.0])
    walls = np.array([[0.0, 18, 0], [38, -22, 0], [-9, -30, 0]])
    length, arrival, _ = predict(Form.VA, place, walls, experiment.anchor)
    noise = np.tile(np.diag([0.02, 0.01, 0.01]) ** 2, (3, 1, 1))
    scans = [
        Scan(length + 0.02 * rng.standard_normal(3), arrival, -arrival, np.full(3, 15.0), noise) for _ in range(steps)
    ]
    parameters = replace(
        experiment.parameters, types=(Form.VA,), agent="gaussian", position_walk=0.0, birth_rate=5.0, survival=1.0
    )
    mean, prior = np.array([*place, 1e-6, 0.0, 0.0, 0.0]), np.zeros((7, 7))
    prior[[0, 1], [0, 1]] = 0.5**2
    result = {}
    for name in VARIANTS[:2]:
        filter_ = Conditional(parameters, ConstantVelocity(0.1, 0.0), doppler=False, correlation=name == "kept")
        state = filter_.start(mean, prior)
        for scan in scans:
            state, info = filter_.step(rng, state, scan)
        result[name] = float(np.sqrt(np.mean(np.diag(info.estimate.covariance)[:2])))
    return result
