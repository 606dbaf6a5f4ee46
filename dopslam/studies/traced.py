"""Several traced runs of one scenario, every filter variant on the same detections, with intervals over the runs.

Each seed draws its own track, scatterer phases and noise; it is traced and estimated once, and all variants filter
the same
detections. Twice: with the estimator's own covariances, and with noise of the model source's R (paper A's values)
added.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dopslam.config.scenario import Scenario
from dopslam.evaluate import detections as matching
from dopslam.evaluate.run import Evaluation, evaluate_run, summarize
from dopslam.pipeline import file as stages
from dopslam.pipeline import stages as pipeline
from dopslam.pipeline.judge import largest_order, match_series
from dopslam.pipeline.stages import Progress, quiet
from dopslam.store import file as dataset
from estimation import statistics

COMPARED = ("joint", "marginal", "smoother", "bp")
NOISES = {"estimator": "none", "paper": "model"}
FIGURES = ("position_rmse_m", "heading_rmse_deg", "clock_bias_rmse_m", "nees", "gospa_va_m", "gospa_sp_m")


def prepare(scenario: Scenario, seed: int, folder: Path, jobs: int, progress: Progress = quiet) -> Path:
    """Dataset of one seed with track, paths and detections; a complete one from an earlier call is kept."""
    path = Path(folder) / f"{scenario.name}-{seed}.h5"
    if path.exists() and dataset.read_root(path) == (scenario.to_toml(), seed) and "detections" in dataset.groups(path):
        return path
    path.unlink(missing_ok=True)
    stages.trace(path, scenario, seed, progress)
    stages.estimate(path, (), jobs, progress)
    return path


def evaluations(path: Path, noise: str, filters=COMPARED, told=()) -> tuple[dict[str, Evaluation], dict[str, dict]]:
    """Every filter variant on the detections of one dataset, which is left as it was: evaluations, and their figures."""
    settings = (f"source.traced.added_noise={NOISES[noise]}", *told)
    scenario, seed = stages.scenario_of(path, settings)
    track, landmarks, paths, _ = stages.read_truth(path)
    detections = stages.blurred(scenario, stages.read_detections(path), seed)
    found, bounds = {}, {}
    for filter_name, doppler in stages.variants_of(scenario, filters):
        name = stages.variant_name(filter_name, doppler)
        history = pipeline.slam(scenario, detections, filter_name, doppler, seed)
        order, kind = largest_order(filter_name, landmarks), (doppler, *pipeline.reads_later(scenario, filter_name))
        if kind not in bounds:
            bounds[kind] = pipeline.bound(scenario, track, landmarks, paths, detections, *kind[:2], lag=kind[2])
        found[name] = evaluate_run(scenario, track, landmarks, history, bounds[kind], order)
    radius = scenario.evaluation.found_radius
    return found, {name: summarize(e, landmarks, radius) for name, e in found.items()}


def study(
    scenario: Scenario,
    seeds,
    folder: Path,
    jobs: int = 1,
    progress: Progress = quiet,
    noises=tuple(NOISES),
    filters=COMPARED,
    told=(),
) -> dict:
    """Run the study.

    Parameters
    ----------
    scenario : a traced scenario
    seeds : one run each
    folder : existing folder that keeps the datasets; complete ones are used again
    jobs : worker processes of the estimation
    noises : which of :data:`NOISES`
    filters : names of the filters
    told : ``key=value`` settings that only filters read, ``filter.start=snapshot`` for instance

    Returns
    -------
    dict
        ``detections``: pooled figures of the estimator; ``line_of_sight``: (K,) share of the runs that have one;
        ``estimator`` and ``paper``: for every filter variant mean and 95 % interval of RMSEs, NEES, GOSPA and
        ``rmse_over_bound``, landmarks found and ``steps``, the RMSE over the runs at every step; ``doppler_gain``:
        position RMSE without over with Doppler, paired over the runs; ``runs``: every single figure.
    """
    seeds = list(seeds)
    paths = [prepare(scenario, seed, folder, jobs, progress) for seed in seeds]
    matches, sight = [], []
    for path in paths:
        track, _, traced, _ = stages.read_truth(path)
        assert traced is not None  # the datasets that this study prepares hold paths
        matches += match_series(scenario, track, traced, stages.read_detections(path))
        sight.append([bool(np.any(traced.landmark[traced.rows(k)] == 0)) for k in range(traced.steps)])
    result: dict = {
        "scenario": scenario.name,
        "estimator_kind": scenario.estimator.kind,
        "seeds": seeds,
        "detections": matching.figures(matches),
        "line_of_sight": np.mean(sight, axis=0).tolist(),
        "runs": {},
    }
    for noise in noises:
        found, runs = zip(*(evaluations(path, noise, filters, told) for path in paths), strict=True)
        result[noise] = {
            name: _pooled([run[name] for run in runs]) | {"steps": _by_step([f[name] for f in found])}
            for name in found[0]
        }
        result[noise]["doppler_gain"] = {
            density: statistics.mean([
                run[f"{density}, no Doppler"]["position_rmse_m"] / run[density]["position_rmse_m"] for run in runs
            ])
            for density in ("joint", "marginal")
            if density in filters
        }  # fmt: skip
        result["runs"][noise] = list(runs)
    return result


def _by_step(runs: list[Evaluation]) -> dict[str, list[float]]:
    """Root mean square over the runs at every step, errors beside bounds."""
    columns = {
        "position_rmse_m": [run.position_error for run in runs],
        "heading_rmse_deg": [np.degrees(run.heading_error) for run in runs],
        "peb_m": [run.peb for run in runs],
        "heb_deg": [np.degrees(run.heb) for run in runs],
    }
    return {name: np.sqrt(np.mean(np.square(values), axis=0)).tolist() for name, values in columns.items()}


def _pooled(runs: list[dict]) -> dict:
    pooled: dict = {name: statistics.mean([run[name] for run in runs]) for name in FIGURES}
    pooled["rmse_over_bound"] = {
        name: statistics.mean([run["rmse_over_bound"][name] for run in runs])
        for name in ("position", "heading", "clock")
    }
    errors = [e for run in runs for e in run["landmark_error_m"].values()]
    pooled["lost"] = sum(run["diverged"] for run in runs)
    pooled["landmarks_within_1_m"] = _within(errors)
    pooled["higher_order_va_within_1_m"] = _within([e for run in runs for e in run["higher_order_va_error_m"].values()])
    return pooled


def _within(errors: list[float | None], radius: float = 1.0) -> dict[str, int]:
    return {"found": sum(e is not None and e <= radius for e in errors), "of": len(errors)}
