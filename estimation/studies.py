"""Monte Carlo studies of the estimators: accuracy, detection, false alarms, speed; :mod:`~estimation.resolution` apart.

Every function draws its own data from explicit seeds and returns plain dictionaries (JSON), with 95 %
intervals beside the estimates. The reference link has 64 subcarriers over 400 MHz, 16 symbols 125 us apart, a
4 x 4 receiver and an 8 x 8 transmitter at 28 GHz: 1.05 M samples, 60.2 dB of integration gain.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .detections import Detections
from .estimators import find
from .estimators.dense import DenseSearch
from .estimators.detect import detection_probability
from .estimators.nomp import Nomp
from .evaluate import Match, associate, detection_by_band, nees_by_band, summarize
from .scenarios import FRONT, Draw, at_snr, draw_paths, hybrid_link, reference_link, swept_link
from .signal.arrays import ura
from .signal.model import SignalModel
from .signal.paths import PARAMETERS, PathTable
from .signal.schedule import random_phase_beams, sweep
from .signal.synthesis import synthesize
from .signal.waveform import comb
from .statistics import half_width, percentiles, proportion

BANDS = (10, 14, 17, 20, 25, 35, 50, 90)


@dataclass(frozen=True)
class Runs:
    """Matches, processor times [ms] and the estimator's threshold of a series of bursts."""

    matches: list[Match]
    milliseconds: list[float]
    threshold: float
    parameters: int


def run_series(estimator: Nomp, model: SignalModel, cases, seed: int, warm: bool = False) -> Runs:
    """Estimate each of ``cases``, functions ``rng -> (paths, noise_variance)``, each with a seed of its own."""
    matches, times = [], []
    for number, case in enumerate(cases):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
        paths, variance = case(rng)
        signal = synthesize(model, paths, variance, rng)
        start = time.thread_time()
        found: Detections = estimator.run(signal, prior=paths if warm else None)
        times.append(1e3 * (time.thread_time() - start))
        matches.append(associate(model, found, paths, variance))
    return Runs(matches, times, estimator.level, estimator.parameters)


def report_runs(runs: Runs, accuracy_from_db: float = 18.0) -> dict:
    """The figures of a series as plain numbers."""
    total = summarize(runs.matches, 10 ** (accuracy_from_db / 10))
    rho = np.concatenate([m.rho for m in runs.matches])
    decibels = 10 * np.log10(np.maximum(rho, 1e-9))
    detect = {}
    for (low, high), (found, present) in zip(pairwise(BANDS), detection_by_band(runs.matches, BANDS), strict=True):
        if present:
            inside = (decibels >= low) & (decibels < high)
            law = detection_probability(rho[inside], runs.threshold, runs.parameters)
            detect[f"{low}-{high}"] = {
                "p_detect": found / present,
                "interval": proportion(found, present),
                "paths": present,
                "model": float(law.mean()),
            }
    nees = {
        f"{a}-{b}": {"nees_over_6": value, "paths": count}
        for (a, b), (value, count) in zip(pairwise(BANDS), nees_by_band(runs.matches, BANDS), strict=True)
        if count
    }
    false = np.array([m.false for m in runs.matches])
    width = half_width(np.sqrt(max(false.mean(), 1 / len(false))), len(false))
    return {
        "rmse_over_crb": dict(zip(PARAMETERS, total.rmse_over_crb.tolist(), strict=True)),
        "rmse_interval": dict(zip(PARAMETERS, total.rmse_interval.tolist(), strict=True)),
        "associations": total.associations,
        "gross_errors": total.gross,
        "p_detect": detect,
        "false_per_snapshot": float(false.mean()),
        "false_interval": [max(float(false.mean() - width), 0.0), float(false.mean() + width)],
        "nees_over_6": total.nees_over_n,
        "nees_interval": total.nees_interval.tolist(),
        "nees_per_parameter": dict(zip(PARAMETERS, total.nees_per_parameter.tolist(), strict=True)),
        "nees_by_band": nees,
        "ms_per_snapshot": float(np.median(runs.milliseconds)),
        "ms_fastest": float(np.min(runs.milliseconds)),
        "snapshots": len(runs.matches),
        "threshold": runs.threshold,
    }


def accuracy(name: str, snapshots: int, snrs_db=(-20, -10, 0, 10, 20), seed: int = 1, warm: bool = False) -> dict:
    """Reference link: ``snapshots`` bursts of eight paths at each per-sample SNR of the strongest; pooled and
    per SNR.
    """
    model = reference_link()
    estimator = find(name)(model, arrival_view=FRONT, departure_view=FRONT)
    series = {}
    for number, level in enumerate(snrs_db):
        cases = [lambda rng, v=10 ** (-level / 10): (draw_paths(model, rng), v)] * snapshots
        series[level] = run_series(estimator, model, cases, seed + number, warm)
    pooled = Runs(
        [m for r in series.values() for m in r.matches],
        [t for r in series.values() for t in r.milliseconds],
        estimator.level,
        estimator.parameters,
    )
    return report_runs(pooled) | {"per_snr": {str(level): report_runs(runs) for level, runs in series.items()}}


def weak_paths(
    snapshots: int, link: SignalModel | None = None, span=(12.0, 24.0), paths: int = 4, seed: int = 11
) -> dict:
    """Detection near the threshold: bursts of few paths with rho uniform over ``span`` [dB]."""
    model = reference_link() if link is None else link
    estimator = Nomp(model, arrival_view=FRONT, departure_view=FRONT)
    draw = Draw(paths=paths)
    cases = [
        lambda rng: (at_snr(model, draw_paths(model, rng, draw), 10 ** (rng.uniform(*span, paths) / 10)), 1.0)
    ] * snapshots
    return report_runs(run_series(estimator, model, cases, seed))


def hybrid(snapshots: int, seed: int = 21) -> dict:
    """Eq. (2) with precoders and combiners, five paths with rho between 18 and 40 dB."""
    return weak_paths(snapshots, hybrid_link(), (18.0, 40.0), 5, seed)


def swept(snapshots: int, seed: int = 22) -> dict:
    """The radio of ring_road on random directions all round: six paths with rho between 13 and 48 dB."""
    model = swept_link()

    def case(rng: np.random.Generator):
        aoa, aod = (np.c_[rng.uniform(-np.pi, np.pi, 6), rng.uniform(-0.8, 0.8, 6)] for _ in range(2))
        delay, speed = rng.uniform(0, 2e-6, 6), rng.uniform(-22, 22, 6)
        unit = PathTable(delay, aoa, aod, speed, np.exp(2j * np.pi * rng.random(6)))
        return at_snr(model, unit, 10 ** rng.uniform(1.3, 4.8, 6)), 1.0

    return report_runs(run_series(Nomp(model), model, [case] * snapshots, seed))


def false_alarms(rates, snapshots: int, seed: int = 31) -> list[dict]:
    """Noise alone on the reference link: nominal against measured false paths per snapshot."""
    model = reference_link()
    estimator = Nomp(model, arrival_view=FRONT, departure_view=FRONT)
    suprema = estimator.suprema(snapshots, seed)
    from .estimators.detect import threshold_for

    rows = []
    for rate in rates:
        threshold = threshold_for(rate, estimator.volume, estimator.parameters)
        above = int(np.sum(suprema > threshold))
        rows.append(
            {
                "nominal": rate,
                "threshold": threshold,
                "measured": above / snapshots,
                "interval": proportion(above, snapshots),
            }
        )
    return rows


def speed(
    sizes=(
        (64, 8, (2, 2), (4, 4)),
        (64, 16, (4, 4), (4, 4)),
        (64, 16, (4, 4), (8, 8)),
        (128, 16, (4, 4), (8, 8)),
    ),
    bursts: int = 8,
) -> list[dict]:
    """Median over some bursts of the fastest of three runs of each, per size, cold and warm, beside the floor: the
    arithmetic of one search at the rate of a large matrix product.
    """
    rows = []
    square = np.ones((512, 512), np.complex64)
    rate = 8 * 512**3 / min(_timed(lambda: square @ square) for _ in range(9))
    for size in sizes:
        model = reference_link(*size)
        estimator = Nomp(model, arrival_view=FRONT, departure_view=FRONT)
        draw = Draw(delays=(20e-9, 140e-9))
        cases = [lambda rng, m=model, d=draw: (draw_paths(m, rng, d), 100.0 * np.prod(m.shape) / 2**20)] * bursts
        cold, warm = (
            np.median(np.min([run_series(estimator, model, cases, 51, w).milliseconds for _ in range(3)], axis=0))
            for w in (False, True)
        )
        paths = draw_paths(model, np.random.default_rng(1))
        noise = np.random.default_rng(0)
        synthesis = min(_timed(lambda m=model, p=paths, r=noise: synthesize(m, p, 1.0, r)) for _ in range(9))
        search = estimator._search
        assert isinstance(search, DenseSearch)
        floor = 1e3 * search.operations(model) / rate
        rows.append(
            {
                "samples": int(np.prod(model.shape)),
                "ms_cold": float(cold),
                "ms_warm": float(warm),
                "ms_synthesis_per_million": 1e9 * synthesis / np.prod(model.shape),
                "cgemm_gflops": rate / 1e9,
                "ms_floor": floor,
                "cold_over_floor": float(cold) / floor,
            }
        )
    return rows


def _timed(function) -> float:
    start = time.thread_time()
    function()
    return time.thread_time() - start


def schedules(max_speed: float = 25.0, seed: int = 61) -> dict:
    """Ambiguity of beam schedules on an 8 x 8 transmitter, 64 beams x 8 sweeps, 8.92 us per beam."""
    from .ambiguities import ambiguity
    from .signal.schedule import ORDERS, antenna_switching, dft_beams

    rng = np.random.default_rng(seed)
    books = {
        "dft": dft_beams(8, 8),
        "antenna_switching": antenna_switching(64),
        "random_phase": random_phase_beams(64, 64, rng),
    }
    rows = {}
    for label, book in books.items():
        for order in ORDERS:
            schedule = sweep(book, 8, 8.92e-6, order=order, rng=rng)
            model = SignalModel(comb(28e9, 6.25e6, 8), schedule, ura(8, 8), ura(2, 2))
            result = ambiguity(model, max_speed, FRONT)
            median, high, worst = np.percentile(result.level, [50, 90, 100])
            rows[f"{label}, {order}"] = {
                "median": float(median),
                "p90": float(high),
                "max": float(worst),
                "ambiguous_speeds": result.ambiguous_speeds[:6].tolist(),
                "speeds": result.speeds.tolist(),
                "profile": result.profile.tolist(),
            }
    return rows


def search_loss(
    link: SignalModel | None = None, rhos_db=(13, 14, 15, 16, 17), trials: int = 40, seed: int = 71
) -> dict:
    """How much SNR the coarse search gives away against a likelihood ratio refined from the truth, single
    paths in noise.

    Both curves are fitted by the model p_D(rho) with a shift in dB (maximum likelihood); the loss is the
    difference of the shifts.
    """
    from scipy.optimize import minimize_scalar

    from .estimators.polish import ResidualProjector, separate_fit
    from .estimators.projector import Bases, Projector

    model = swept_link() if link is None else link
    estimator = Nomp(model)
    basis = Bases.build(model)
    outcome = np.zeros((2, len(rhos_db), trials), bool)
    for row, level in enumerate(rhos_db):
        for trial in range(trials):
            rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(row, trial)))
            aoa, aod = (np.array([[rng.uniform(-3.1, 3.1), rng.uniform(-0.9, 0.9)]]) for _ in range(2))
            delay, speed = rng.uniform(0, model.waveform.max_delay), rng.uniform(-22, 22)
            gain = np.exp(2j * np.pi * rng.random(1))
            path = PathTable(np.array([delay]), aoa, aod, np.array([speed]), gain)
            path = at_snr(model, path, [10 ** (level / 10)])
            signal = synthesize(model, path, 1.0, rng)
            found = estimator.run(signal, noise_variance=1.0)
            outcome[0, row, trial] = associate(model, found, path, 1.0).detected[0]
            data = Projector(model, signal, basis)
            _, energy = separate_fit(ResidualProjector(data, None), path.geometry, 1.0, np.inf, iterations=12)
            outcome[1, row, trial] = energy[0] > estimator.level
    hits = outcome.sum(axis=2)

    def shift(counts) -> float:
        def loss(delta: float) -> float:
            rho = 10 ** ((np.array(rhos_db) - delta) / 10)
            p = np.clip(detection_probability(rho, estimator.level, estimator.parameters), 1e-9, 1 - 1e-9)
            return -float(np.sum(counts * np.log(p) + (trials - counts) * np.log(1 - p)))

        best = minimize_scalar(loss, bounds=(-2, 4), method="bounded")
        return float(best.x)  # pyright: ignore[reportAttributeAccessIssue]  # SciPy's stub knows no result

    rng = np.random.default_rng(seed)
    boot = []
    for _ in range(200):
        pick = rng.integers(trials, size=(len(rhos_db), trials))
        sample = np.take_along_axis(outcome, np.broadcast_to(pick, outcome.shape), axis=2).sum(axis=2)
        boot.append(shift(sample[0]) - shift(sample[1]))
    return {
        "rho_db": list(rhos_db),
        "search": (hits[0] / trials).tolist(),
        "from_truth": (hits[1] / trials).tolist(),
        "loss_db": shift(hits[0]) - shift(hits[1]),
        "interval_db": percentiles(boot),
        "threshold": estimator.level,
        "trials": trials,
    }
