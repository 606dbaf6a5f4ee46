"""Belief propagation beside the joint filter on the same detections, and its control experiment: what the correlation
between agent and features is worth.

Features given the agent, which is one Gaussian (``kept``) or many particles (``particles``); the same code with the
correlation dropped after every step and everything else equal (``dropped``); paper B's form, particles and marginals
(``independent``); and ``joint``.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from dopslam.config.scenario import Scenario
from dopslam.evaluate import mapping
from dopslam.evaluate.run import evaluate_run, summarize
from dopslam.pipeline import file as files
from dopslam.pipeline import problem as build
from dopslam.pipeline import stages
from dopslam.pipeline.stages import Progress, quiet
from dopslam.slam.belief.conditional.filter import Conditional
from dopslam.slam.belief.filter import Belief
from dopslam.slam.belief.records import Assumptions, Form
from dopslam.studies.bp_cases import CASES
from dopslam.studies.bp_study import one_run, summary
from dopslam.studies.traced import NOISES, largest_order, prepare
from estimation import statistics

Assumed = TypeVar("Assumed", bound=Assumptions)

VARIANTS = ("kept", "dropped", "independent")
COMPARED = ("particles", "kept", "dropped", "independent", "joint")
NEAR = 1.0  # m, of a landmark that is found


def assumed(assumptions: Assumed, name: str) -> Assumed:
    """What a variant of belief propagation assumes."""
    features = "independent" if name == "independent" else "conditional"
    return replace(assumptions, features=features, agent="particles" if name == "particles" else "gaussian")


def synthetic(
    runs: int, seed: int = 1, case: str = "aod", particles: int = 1000, steps: int | None = None, variants=VARIANTS
) -> dict:
    """The pedestrian experiment (``case`` of :data:`~dopslam.studies.bp_cases.CASES`): figures of every variant."""
    chosen, found = CASES[case], {}
    if steps is not None:
        chosen = replace(chosen, experiment=replace(chosen.experiment, steps=steps))
    for name in variants:
        parameters = assumed(chosen.experiment.parameters, name)
        filter_ = replace(chosen, parameters=parameters, particles=particles).filter
        if isinstance(filter_, Conditional):
            filter_ = replace(filter_, correlation=name != "dropped")
        found[name] = summary(
            [one_run(chosen.experiment, filter_, particles, (seed, r), informed=chosen.informed) for r in range(runs)]
        )
    return found


def traced(
    scenario: Scenario, seeds: Sequence[int], folder: Path, noise: str = "estimator", jobs: int = 1,
    progress: Progress = quiet, variants: Sequence[str] = VARIANTS, repeats: int = 1,
) -> dict:  # fmt: skip
    """A traced scene: every variant on the same detections, with 95 % intervals over the seeds.

    Parameters
    ----------
    folder : existing folder that keeps the datasets; complete ones are used again
    noise : of :data:`~dopslam.studies.traced.NOISES`
    variants : of :data:`COMPARED`
    repeats : of every run of the first seed, for the time of a step

    Returns
    -------
    dict
        For every variant: ``position_over_bound``, ``nees``; ``found`` landmarks of one reflection within 1 m and how many
        there are, ``of``; likewise ``second_found``, ``second_of`` of two reflections; ``false`` entries of the final maps
        that no landmark explains, within 1 m or three standard deviations; ``ms_per_step``, processor time, the least of
        the repetitions; ``runs``, the figures of every seed.
    """
    runs: dict[str, list[dict]] = {name: [] for name in variants}
    for seed in seeds:
        path = prepare(scenario, seed, folder, jobs, progress)
        own, _ = files.scenario_of(path, (f"source.traced.added_noise={NOISES[noise]}",))
        track, landmarks, paths, _ = files.read_truth(path)
        detections = files.blurred(own, files.read_detections(path), seed)
        problem, bounds = build.problem(own), {}
        scans = problem.scans(detections)
        for name in variants:
            chosen, doppler = _variant(own, name), name != "independent"
            if doppler not in bounds:
                bounds[doppler] = stages.bound(own, track, landmarks, paths, detections, doppler)
            times = []
            for _ in range(repeats if seed == seeds[0] else 1):
                started = time.thread_time()
                history, _ = chosen.run(problem, scans, np.random.default_rng(seed))
                times.append(time.thread_time() - started)
            order = largest_order("joint" if name == "joint" else "bp", landmarks)
            run = summarize(evaluate_run(own, track, landmarks, history, bounds[doppler], order), landmarks, NEAR)
            always = mapping.steps_seen(None, None, landmarks, 0.0)
            fate = mapping.fate(landmarks, history, own.filter.report_existence, *always)
            runs[name].append(
                run | {"seed": seed, "false": len(fate.false), "ms_per_step": 1e3 * min(times) / history.steps}
            )
    return {name: _pooled(found) for name, found in runs.items()}


def _variant(scenario: Scenario, name: str) -> Any:
    """The filter of a variant with the choices of the scenario."""
    if name == "joint":
        return build.chosen_filter(scenario, "joint")
    chosen = build.chosen_filter(scenario, "bp")
    assert isinstance(chosen, Belief)
    return replace(chosen, assumptions=assumed(chosen.assumptions, name), correlation=name != "dropped")


def _pooled(runs: list[dict]) -> dict:
    first = [e for run in runs for e in run["landmark_error_m"].values()]
    second = [e for run in runs for e in run["higher_order_va_error_m"].values()]
    return {
        "position_over_bound": statistics.mean([run["rmse_over_bound"]["position"] for run in runs]),
        "nees": statistics.mean([run["nees"] for run in runs]),
        "found": sum(e is not None and e <= NEAR for e in first),
        "of": len(first),
        "second_found": sum(e is not None and e <= NEAR for e in second),
        "second_of": len(second),
        "false": sum(run["false"] for run in runs),
        "ms_per_step": min(run["ms_per_step"] for run in runs),
        "runs": runs,
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
