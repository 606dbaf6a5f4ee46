"""Many runs of a synthetic experiment and what they say, with 95 % intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dopslam.evaluate.belief import bound
from dopslam.evaluate.metrics import rmse_over_bound
from dopslam.slam.belief.conditional.filter import Conditional
from dopslam.slam.belief.experiment import Experiment, draw
from dopslam.slam.belief.motion import ConstantVelocity
from dopslam.slam.belief.rao_blackwell import RaoBlackwell
from dopslam.slam.belief.records import Form
from dopslam.slam.belief.stacked.stacked import Stacked
from dopslam.slam.belief.start import Box
from dopslam.studies.bp_run import Score, evaluate, run
from estimation.statistics import average_and_last, bootstrap

LOST = 0.1  # m, position RMSE from which a run counts as lost


@dataclass(frozen=True)
class RunResult:
    """One run: its score, the bounds per step (K,) in m and rad, time per step [s], median ESS and the first counted
    step."""

    score: Score
    position_bound: np.ndarray
    heading_bound: np.ndarray
    seconds_per_step: float
    effective: float
    skip: int = 0


def start_box(experiment: Experiment) -> Box:
    """The start prior of paper B, Section VI-A; in space also ±0.5 m in height."""
    if experiment.spatial:
        return Box(experiment.start, half_height=0.5, half_climb=0.1)
    return Box(experiment.start)


def motion_of(experiment: Experiment, speed_increment: float = 0.02) -> ConstantVelocity:
    """Near-constant velocity with the same increment in all the experiment's dimensions."""
    return ConstantVelocity(experiment.interval, speed_increment, speed_increment if experiment.spatial else 0.0)


def one_run(
    experiment: Experiment,
    filter_: RaoBlackwell | Conditional | Stacked,
    particles: int,
    seed: Sequence[int],
    *,
    informed=True,
    skip=0,
) -> RunResult:
    """Draw, filter and score one run; ``seed`` is the spawn key, so runs do not depend on each other."""
    data, own = (np.random.default_rng(s) for s in np.random.SeedSequence(list(seed)).spawn(2))
    truth, scans, _ = draw(experiment, data)
    history = run(filter_, own, scans, start_box(experiment), particles, informed=informed)
    types = filter_.parameters.types
    limits = bound(experiment, truth, motion_of(experiment), aod_for_va=Form.VA_AOD in types)
    return RunResult(
        evaluate(experiment, truth, history, types, skip=skip),
        limits.position,
        limits.heading,
        history.seconds_per_step,
        float(np.median([info.effective for info in history.infos])),
        skip,
    )


def interval(squares: np.ndarray) -> tuple[float, float, float]:
    """Root mean square over runs and its bootstrap interval, from per-run mean squares (R,)."""
    low, high = bootstrap(squares, _root_mean, draws=2000)
    return _root_mean(squares), low, high


def _root_mean(squares: np.ndarray) -> float:
    return float(np.sqrt(squares.mean()))


def summary(results: Sequence[RunResult]) -> dict:
    """Figures of a study, ready for JSON: RMSE with interval and ratio to the bound, lost runs, map and types, time.

    RMSEs and bounds are root mean squares over runs and counted steps; the ratio is the mean over these steps of
    RMSE_k/bound_k, its interval a bootstrap over runs. GOSPA and NEES are means over runs. ``per_step`` has all steps.
    """
    scores, skip = [r.score for r in results], results[0].skip
    every = {
        "rmse_position": np.array([s.position_error**2 for s in scores]),
        "rmse_heading": np.array([s.heading_error**2 for s in scores]),
        "bound_position": np.array([r.position_bound**2 for r in results]),
        "bound_heading": np.array([r.heading_bound**2 for r in results]),
    }
    squared = {name: every[f"rmse_{name}"][:, skip:] for name in ("position", "heading")}
    limits = {name: every[f"bound_{name}"][:, skip:] for name in squared}
    rmse = {name: interval(values.mean(axis=1)) for name, values in squared.items()}
    lowest = {name: float(np.sqrt(values.mean())) for name, values in limits.items()}
    ratio = {name: rmse_over_bound(squared[name], limits[name]) for name in squared}
    ratio_interval = {name: bootstrap([squared[name], limits[name]], rmse_over_bound) for name in squared}
    nees = np.array([s.nees[skip:].mean() for s in scores])
    belief = np.mean([s.type_history for s in scores], axis=0)
    below = [np.flatnonzero(column < 0.9) for column in belief.T]
    seconds = float(np.median([r.seconds_per_step for r in results]))
    gospa = {kind: np.array([getattr(s, f"gospa_{kind}") for s in scores]) for kind in ("va", "sp")}
    steps = {name: np.sqrt(values.mean(axis=0)).tolist() for name, values in every.items()}
    steps |= {f"gospa_{kind}_m": values[..., 0].mean(axis=0).tolist() for kind, values in gospa.items()}
    steps |= {"nees": np.mean([s.nees for s in scores], axis=0).tolist(), "type_belief_true": belief.tolist()}
    return {
        "runs": len(results),
        "steps": len(scores[0].position_error),
        "rmse_over_bound": ratio,
        "rmse_over_bound_interval": ratio_interval,
        "position_rmse_m": rmse["position"][0],
        "position_rmse_interval_m": list(rmse["position"][1:]),
        "position_bound_m": lowest["position"],
        "heading_rmse_rad": rmse["heading"][0],
        "heading_bound_rad": lowest["heading"],
        "heading_rmse_deg": float(np.degrees(rmse["heading"][0])),
        "orientation_rmse_deg": float(np.degrees(rmse["heading"][0])),
        "orientation_rmse_interval_deg": [float(np.degrees(v)) for v in rmse["heading"][1:]],
        "orientation_bound_deg": float(np.degrees(lowest["heading"])),
        "nees_mean": float(nees.mean()),
        "nees_interval": bootstrap(nees),
        "nees_expected": 3,
        "gospa_va_m": average_and_last(gospa["va"][..., 0]),
        "gospa_sp_m": average_and_last(gospa["sp"][..., 0]),
        "worst_run_m": max(s.position_rmse for s in scores),
        "diverged": sum(s.position_rmse > LOST for s in scores),
        "failures": [],
        "ghost_runs": sum(s.ghost for s in scores),
        "found_all_runs": sum(s.found == len(s.map_error) for s in scores),
        "false_features": float(np.mean([s.false for s in scores])),
        "map_error_m": np.median([s.map_error for s in scores], axis=0).tolist(),
        "type_belief_true": np.mean([s.true_type for s in scores], axis=0).tolist(),
        "type_belief_above_0.9_from_step": [int(b[-1]) + 2 if b.size else 1 for b in below],
        "seconds_per_step": seconds,
        "microseconds_per_step": 1e6 * seconds,
        "effective_particles": float(np.median([r.effective for r in results])),
        "per_step": steps,
    }
