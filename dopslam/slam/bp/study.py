"""Many runs of a synthetic experiment and what they say, with 95 % intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dopslam.slam.bp.bound import bound
from dopslam.slam.bp.experiment import Experiment, draw
from dopslam.slam.bp.motion import ConstantVelocity
from dopslam.slam.bp.rao_blackwell import RaoBlackwell
from dopslam.slam.bp.records import Form
from dopslam.slam.bp.run import Score, evaluate, run
from dopslam.slam.bp.start import Box

LOST = 0.1  # m, position RMSE from which a run counts as lost


@dataclass(frozen=True)
class RunResult:
    """One run: its score, the bounds' RMS over the counted steps (m, rad), CPU time [s] and median ESS."""

    score: Score
    position_bound: float
    heading_bound: float
    seconds_per_step: float
    effective: float


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
    filter_: RaoBlackwell,
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
        float(np.sqrt(np.mean(limits.position[skip:] ** 2))),
        float(np.sqrt(np.mean(limits.heading[skip:] ** 2))),
        history.seconds_per_step,
        float(np.median([info.effective for info in history.infos])),
    )


def interval(squares: np.ndarray, seed: int = 0) -> tuple[float, float, float]:
    """Root mean square over runs and its 95 % bootstrap interval, from per-run mean squares (R,)."""
    rng = np.random.default_rng(seed)
    draws = np.sqrt(squares[rng.integers(0, squares.size, (2000, squares.size))].mean(axis=1))
    low, high = np.percentile(draws, [2.5, 97.5])
    return float(np.sqrt(squares.mean())), float(low), float(high)


def summary(results: Sequence[RunResult]) -> dict:
    """Figures of a study: RMSE with interval and ratio to the bound, lost runs, map and types, CPU time."""
    scores = [r.score for r in results]
    position = interval(np.array([s.position_rmse**2 for s in scores]))
    heading = interval(np.array([s.heading_rmse**2 for s in scores]))
    belief = np.mean([s.type_history for s in scores], axis=0)
    below = [np.flatnonzero(column < 0.9) for column in belief.T]
    limit = float(np.sqrt(np.mean([r.position_bound**2 for r in results])))
    return {
        "runs": len(results),
        "position_rmse_m": position[0],
        "position_rmse_interval_m": position[1:],
        "position_bound_m": limit,
        "rmse_over_bound": position[0] / limit,
        "orientation_rmse_deg": float(np.degrees(heading[0])),
        "orientation_rmse_interval_deg": tuple(float(np.degrees(v)) for v in heading[1:]),
        "orientation_bound_deg": float(np.degrees(np.sqrt(np.mean([r.heading_bound**2 for r in results])))),
        "worst_run_m": max(s.position_rmse for s in scores),
        "lost_runs": sum(s.position_rmse > LOST for s in scores),
        "ghost_runs": sum(s.ghost for s in scores),
        "found_all_runs": sum(s.found == len(s.map_error) for s in scores),
        "false_features": float(np.mean([s.false for s in scores])),
        "map_error_m": np.median([s.map_error for s in scores], axis=0).tolist(),
        "type_belief_true": np.mean([s.true_type for s in scores], axis=0).tolist(),
        "type_belief_above_0.9_from_step": [int(b[-1]) + 2 if b.size else 1 for b in below],
        "seconds_per_step": float(np.median([r.seconds_per_step for r in results])),
        "effective_particles": float(np.median([r.effective for r in results])),
    }
