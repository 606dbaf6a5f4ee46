"""Many runs of a filter on detections drawn from the model, beside their bounds.

Run r of a study depends on (seed, r) only, never on the number of workers or their order. Ratios to the
bound are means over steps of RMSE_k/bound_k, the bound being the root of the run-averaged inverse
information with the detections that were drawn; intervals are 95 % percentile bootstraps over runs.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from dopslam.errors import DopslamError, FilterError
from dopslam.evaluate.bounds import detection_mask, situation_bound
from dopslam.evaluate.metrics import gospa, nees, rmse_over_bound, squared_errors, state_errors
from dopslam.models.measurement import SP, VA
from dopslam.models.scans import Scans
from dopslam.pipeline.problem import told
from dopslam.simulate.world import Situation, simulate
from dopslam.slam.filter import Filter, Problem, later, uses_doppler
from dopslam.slam.filter import run as run_filter
from dopslam.slam.history import Diagnostics, History
from dopslam.slam.pmb.density import BS_TRACK, NO_TRACK
from estimation.statistics import average_and_last, bootstrap

Array = NDArray[np.float64]

FILTER = 3  # component of a run's random numbers: 0 to 2 are track, detections and clutter
LOST = 5.0  # m; a run whose position error exceeds this at any step counts as diverged
ESTABLISHED = 0.3  # existence from which a track is the right place for its landmark's measurement


@dataclass(frozen=True, slots=True)
class Study:
    """What is run: a world, a filter, and what the filter believes about the world.

    Run r draws the same track and detections whatever the filter: studies of one world are paired.

    Attributes
    ----------
    situation : Situation
        The truth.
    chosen : Filter
    problem : Problem or None
        What the filter is told; None: the truth.
    cutoff, order : GOSPA cutoff [m] and order
    report : float
        Existence from which a landmark is reported.
    """

    situation: Situation
    chosen: Filter
    problem: Problem | None = None
    cutoff: float = 20.0
    order: float = 2.0
    report: float = 0.5

    @property
    def told(self) -> Problem:
        """What the filter is told."""
        return told(self.situation) if self.problem is None else self.problem


@dataclass(frozen=True, slots=True)
class RunResult:
    """Errors of one run, per step.

    Attributes
    ----------
    squared, bound : dict of (K,) arrays; squared errors and squared bounds
    nees, nis : (K,) arrays; NEES, and NIS per degree of freedom
    gospa_va, gospa_sp : (K, 4) arrays; distance [m] and its parts localization, missed, false [m²]
    correct_weight : (K,) array; weight of the true data association
    seconds : float; CPU time of the filter
    failure : str; empty unless the filter raised
    """

    squared: dict[str, Array]
    bound: dict[str, Array]
    nees: Array
    nis: Array
    gospa_va: Array
    gospa_sp: Array
    correct_weight: Array
    seconds: float
    failure: str = ""


def correct_association_weight(scans: Scans, diagnostics: Diagnostics, history: History) -> Array:
    """Normalized weight (K,) of the true data association among those kept.

    True means: every measurement goes to the BS, to the established track born from the same landmark, or to
    "new" when there is none or it is clutter; types are not counted. Needs `scans.label`.
    """
    if scans.label is None:
        raise FilterError("correct_association_weight needs Scans.label, the truth of simulated data")
    weight = np.zeros(scans.steps)
    established: dict[int, float] = {}
    for k in range(scans.steps):
        labels = scans.label[scans.rows(k)]
        owner: dict[int, int] = {}
        for track, existence in sorted(established.items(), key=lambda item: item[1]):
            if existence > ESTABLISHED and scans.label[track] >= 0:
                owner[int(scans.label[track])] = track
        expected = np.array([BS_TRACK if x == 0 else owner.get(int(x), NO_TRACK) for x in labels], dtype=np.int64)
        match = (diagnostics.associations[k] == expected).all(axis=1)
        weight[k] = diagnostics.weights[k][match].sum() / diagnostics.weights[k].sum()
        rows = history.rows(k)
        established = dict(zip(history.track[rows].tolist(), history.existence[rows].tolist(), strict=True))
    return weight


def run_seed(seed: int, run: int) -> int:
    """Seed of what a filter draws itself in one run, apart from the world's."""
    return int(np.random.SeedSequence(seed, spawn_key=(0, run, FILTER)).generate_state(1)[0])


def run_once(study: Study, seed: int, run: int) -> RunResult:
    """Simulate and filter one run."""
    world = study.situation
    states, scans = simulate(world, seed, run)
    assert scans.label is not None  # it was drawn
    mask = detection_mask(scans.label, scans.offsets, len(world.kind))
    smoothed, lag = later(study.chosen)
    own = {"doppler": uses_doppler(study.chosen), "smoothed": smoothed, "lag": lag}
    bound = situation_bound(world, states, detected=mask, **own).squared()
    started = time.thread_time()
    try:
        history, diagnostics = run_filter(study.told, scans, study.chosen, run_seed(seed, run))
    except (FilterError, np.linalg.LinAlgError) as error:
        nothing, no_map = np.full(world.steps, np.nan), np.full((world.steps, 4), np.nan)
        gone = {name: nothing for name in bound}
        return RunResult(gone, bound, nothing, nothing, no_map, no_map, nothing, np.nan, f"run {run}: {error}")
    seconds = time.thread_time() - started
    n = min(history.mean.shape[1], states.shape[1])
    error = state_errors(history.mean[:, :n], states[:, :n])
    maps = []
    for kind in (VA, SP):
        truth = world.landmarks(kind)
        results = [
            gospa(truth, history.reported(k, kind, study.report), study.cutoff, study.order) for k in range(world.steps)
        ]
        maps.append(np.array([[g.distance, g.localization, g.missed, g.false] for g in results]))
    return RunResult(
        squared=squared_errors(error, world.motion.names[:n]),
        bound=bound,
        nees=nees(error, history.covariance[:, :n, :n]),
        nis=diagnostics.nis / np.maximum(diagnostics.nis_rows, 1),
        gospa_va=maps[0],
        gospa_sp=maps[1],
        correct_weight=correct_association_weight(scans, diagnostics, history)
        if any(len(w) for w in diagnostics.weights)
        else np.full(world.steps, np.nan),
        seconds=seconds,
    )


def warm_up(study: Study) -> float:
    """Compile (or load) every kernel the study needs; returns the seconds it took."""
    started = time.perf_counter()
    run_once(study, 0, 0)
    return time.perf_counter() - started


def run_study(
    study: Study, runs: int, seed: int = 0, jobs: int = 1, told: Callable[[int], None] | None = None
) -> list[RunResult]:
    """`runs` independent runs, the same numbers for any `jobs`; ``told`` is called with the number that is done."""
    if runs < 1:
        raise DopslamError(f"montecarlo: runs is {runs}; it must be at least 1")
    warm_up(study)  # fills the cache of compiled code before the workers ask for it
    told = told or (lambda done: None)

    def counted(results) -> list[RunResult]:
        kept = []
        for result in results:
            kept.append(result)
            told(len(kept))
        return kept

    if jobs == 1:
        return counted(run_once(study, seed, r) for r in range(runs))
    # Fixed batches of some tenths of a second: joblib's own grow until the last one keeps a single worker busy.
    parallel = Parallel(n_jobs=jobs, batch_size=_BATCH, return_as="generator")  # pyright: ignore[reportArgumentType]  # stub
    return counted(parallel(delayed(_warm_run)(study, seed, r) for r in range(runs)))


_BATCH = 4  # runs that a worker takes at a time
_warm = False


def _warm_run(study: Study, seed: int, run: int) -> RunResult:
    """One run in a worker, whose first call only loads the compiled code so that timings exclude it."""
    global _warm
    if not _warm:
        run_once(study, 0, 0)
        _warm = True
    return run_once(study, seed, run)


def summarize(results: list[RunResult], study: Study) -> dict[str, Any]:
    """The study as plain numbers and lists, ready for JSON.

    Failed and diverged runs are counted; statistics are over the runs that did not fail, diverged ones
    included.
    """
    good = [r for r in results if not r.failure]
    if not good:
        raise FilterError(f"all {len(results)} runs failed; the first: {results[0].failure}")
    names = list(good[0].squared)
    squared = {name: np.array([r.squared[name] for r in good]) for name in names}
    bound = {name: np.array([r.bound[name] for r in good]) for name in names if name in good[0].bound}
    diverged = int(np.sum(np.sqrt(squared["position"].max(axis=1)) > LOST)) + len(results) - len(good)
    gospa_va, gospa_sp = np.array([r.gospa_va for r in good]), np.array([r.gospa_sp for r in good])
    per_run_nees = np.array([r.nees.mean() for r in good])
    weight = np.array([r.correct_weight.mean() for r in good])
    steps = {f"rmse_{name}": np.sqrt(squared[name].mean(axis=0)).tolist() for name in names} | {
        f"bound_{name}": np.sqrt(value.mean(axis=0)).tolist() for name, value in bound.items()
    }
    steps |= {
        "nees": np.mean([r.nees for r in good], axis=0).tolist(),
        "nis_per_row": [_finite(v) for v in np.mean([r.nis for r in good], axis=0)],
        "gospa_va_m": gospa_va[..., 0].mean(axis=0).tolist(),
        "gospa_sp_m": gospa_sp[..., 0].mean(axis=0).tolist(),
        "correct_da_weight": [_finite(v) for v in np.mean([r.correct_weight for r in good], axis=0)],
    }
    for kind, values in (("va", gospa_va), ("sp", gospa_sp)):
        for column, part in enumerate(("localization", "missed", "false"), start=1):
            steps[f"gospa_{kind}_{part}_m2"] = values[..., column].mean(axis=0).tolist()
    ratios = {
        name: {
            "value": rmse_over_bound(squared[name], bound[name]),
            "interval": bootstrap([squared[name], bound[name]], rmse_over_bound),
        }
        for name in bound
    }
    units = {"position": "m", "heading": "rad", "clock": "m", "speed": "m_s", "turn_rate": "rad_s"}
    return {
        "runs": len(results),
        "steps": study.situation.steps,
        "rmse_over_bound": {name: r["value"] for name, r in ratios.items()},
        "rmse_over_bound_interval": {name: r["interval"] for name, r in ratios.items()},
        **{f"{name}_rmse_{units[name]}": float(np.sqrt(squared[name].mean(axis=0)).mean()) for name in names},
        **{f"{name}_bound_{units[name]}": float(np.sqrt(bound[name].mean(axis=0)).mean()) for name in bound},
        "heading_rmse_deg": float(np.degrees(np.sqrt(squared["heading"].mean(axis=0)).mean())),
        "nees_mean": float(per_run_nees.mean()),
        "nees_interval": bootstrap(per_run_nees),
        "nees_expected": len(names) + 1,  # a position has two states
        "nis_per_row": _finite(float(np.mean([r.nis for r in good]))),
        "gospa_va_m": average_and_last(gospa_va[..., 0]),
        "gospa_sp_m": average_and_last(gospa_sp[..., 0]),
        "correct_da_weight": float(weight.mean()) if np.isfinite(weight).all() else None,
        "correct_da_weight_interval": bootstrap(weight) if np.isfinite(weight).all() else None,
        "intensity_va_per_m3": float(study.told.undetected[0]),
        "intensity_sp_per_m3": float(study.told.undetected[1]),
        "diverged": diverged,
        "failures": [r.failure for r in results if r.failure],
        "microseconds_per_step": float(np.median([r.seconds for r in good]) / study.situation.steps * 1e6),
        "per_step": steps,
        "per_run": _per_run(results),
    }


def _per_run(results: list[RunResult]) -> dict[str, list]:
    """Figures of every run that did not fail, by its number: what pairs studies of the same seed."""
    good = [(number, r) for number, r in enumerate(results) if not r.failure]
    root = {
        name: [float(np.sqrt(r.squared[name].mean())) for _, r in good] for name in ("position", "heading", "clock")
    }
    return {
        "run": [number for number, _ in good],
        "position_rmse_m": root["position"],
        "heading_rmse_deg": np.degrees(root["heading"]).tolist(),
        "clock_bias_rmse_m": root["clock"],
        "position_over_bound": [
            error / float(np.sqrt(r.bound["position"].mean()))
            for error, (_, r) in zip(root["position"], good, strict=True)
        ],
        "nees": [float(r.nees.mean()) for _, r in good],
        "gospa_va_m": [float(r.gospa_va[-1, 0]) for _, r in good],
        "gospa_sp_m": [float(r.gospa_sp[-1, 0]) for _, r in good],
    }


def _finite(value: float) -> float | None:
    """A number for JSON; None where a filter has no such figure."""
    return float(value) if np.isfinite(value) else None
