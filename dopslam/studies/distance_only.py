"""Many runs of the distance-only setting, with 95 % intervals."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed

from dopslam.errors import FilterError
from dopslam.evaluate.belief import distance_bound
from dopslam.slam.belief.distance_only.filter import RangeOnly, RangeParameters
from dopslam.slam.belief.distance_only.scene import RangeScenario, office
from dopslam.studies.bp_study import interval

PARTICLES = 10_000
_NEAR = 0.5  # m, radius of a feature found


@dataclass(frozen=True)
class RangeResult:
    """One run: position errors (K,) m; of every anchor the features found and the false ones at the last step, the
    median distance [m] of the found from the truth; time per step by the clock [s]."""

    position_error: np.ndarray
    found: tuple[int, ...]
    false: tuple[int, ...]
    map_error: float
    seconds_per_step: float

    @property
    def position_rmse(self) -> float:
        """m, over all steps."""
        return float(np.sqrt(np.mean(self.position_error**2)))


def one_run(scenario: RangeScenario, parameters: RangeParameters, particles: int, seed: Sequence[int]) -> RangeResult:
    """Draw, filter and score one run; it depends on ``seed`` only."""
    data, own, spare = (np.random.default_rng(s) for s in np.random.SeedSequence(list(seed)).spawn(3))
    scans = scenario.draw(data, parameters)
    filter_ = RangeOnly(parameters)
    short = filter_.init(spare, scenario.anchors, scenario.track[0], 64)
    filter_.step(spare, short, scans[0])  # loads the compiled code, so that times exclude it
    state = filter_.init(own, scenario.anchors, scenario.track[0], particles)
    positions, begin = [], time.perf_counter()
    for scan in scans:
        state, info = filter_.step(own, state, scan)
        positions.append(info.position)
    seconds = (time.perf_counter() - begin) / len(scans)
    gaps = [
        np.linalg.norm(truth[:, None] - found, axis=2)
        for truth, found in zip(scenario.features, info.features, strict=True)
    ]
    nearest = np.concatenate([g.min(axis=1)[1:] for g in gaps])
    return RangeResult(
        np.linalg.norm(np.array(positions) - scenario.track, axis=1),
        tuple(int((g.min(axis=1) < _NEAR).sum()) for g in gaps),
        tuple(int((g.min(axis=0) > _NEAR).sum()) for g in gaps),
        float(np.median(nearest)),
        seconds,
    )


def study(
    runs: int,
    seed: int = 1,
    particles: int = PARTICLES,
    parameters: RangeParameters | None = None,
    scenario: RangeScenario | None = None,
    jobs: int = 1,
) -> list[RangeResult]:
    """``runs`` independent runs; run r depends on (seed, r) only, whatever the number of worker processes."""
    if runs < 1:
        raise FilterError(f"study: runs is {runs}; it must be at least 1")
    parameters, scenario = parameters or RangeParameters(), scenario or office()
    tasks = (delayed(one_run)(scenario, parameters, particles, (seed, r)) for r in range(runs))
    return [result for result in Parallel(n_jobs=jobs)(tasks) if result is not None]


def summary(
    results: Sequence[RangeResult], parameters: RangeParameters | None = None, scenario: RangeScenario | None = None
) -> dict:
    """Figures of a study, ready for JSON; RMSE and bound are root mean squares over runs and steps."""
    parameters, scenario = parameters or RangeParameters(), scenario or office()
    rmse = interval(np.array([r.position_rmse**2 for r in results]))
    total = sum(len(f) for f in scenario.features)
    return {
        "runs": len(results),
        "steps": len(scenario.track),
        "position_rmse_m": rmse[0],
        "position_rmse_interval_m": list(rmse[1:]),
        "position_bound_m": float(np.sqrt(np.mean(distance_bound(scenario, parameters) ** 2))),
        "worst_run_m": max(r.position_rmse for r in results),
        "features": total,
        "features_found": float(np.mean([sum(r.found) for r in results])),
        "found_all_runs": sum(sum(r.found) == total for r in results),
        "false_features": float(np.mean([sum(r.false) for r in results])),
        "map_error_m": float(np.median([r.map_error for r in results])),
        "seconds_per_step": float(np.median([r.seconds_per_step for r in results])),
    }
