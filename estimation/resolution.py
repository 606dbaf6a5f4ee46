"""Resolution: how close two equal paths may come in one dimension, and how close any estimator could let them come.

Beside the share of bursts in which both paths are found and nothing else stands the share in which a likelihood ratio that
knows the truth would tell that there are two: the pair, fitted from the truth, against the best single path. Where it
stays below the threshold of the false-path rate, reporting two paths would be guessing.
"""

from __future__ import annotations

import numpy as np

from .estimators.nomp import Nomp
from .estimators.projector import Bases, Projector
from .estimators.refine import joint_fit
from .evaluate import associate
from .scenarios import FRONT, Draw, draw_paths, reference_link
from .signal.model import SignalModel
from .signal.paths import Geometry, PathTable
from .signal.synthesis import synthesize
from .statistics import proportion

DIMENSIONS = ("delay", "aoa", "aod", "speed")


def close_pair(
    model: SignalModel, dimension: int, separation: float, rho_db: float, rng: np.random.Generator
) -> PathTable:
    """Two equal paths with random phases, ``separation`` bins apart in one of delay, AOA, AOD, speed (0, 1, 2, 3).

    A bin is the reciprocal bandwidth, half a direction cosine (four elements half a wavelength apart), or wavelength over
    duration.
    """
    period = np.diff(model.schedule.times[:2])[0] * model.schedule.symbols
    bins = (1 / model.waveform.bandwidth, 0.5, 0.5, model.waveform.wavelength / period)
    single = draw_paths(model, rng, Draw(paths=1, speeds=(-15.0, 15.0)))
    step = separation * bins[dimension]
    first = [single.delay, single.aoa, single.aod, single.radial_velocity]
    second = list(first)
    if dimension in (1, 2):
        elevation = first[dimension][0, 1]
        start = rng.uniform(-0.4, 0.4 - step) if step < 0.8 else -0.4
        for paths, cosine in ((first, start), (second, start + step)):
            paths[dimension] = np.array([[np.arcsin(cosine / np.cos(elevation)), elevation]])
    else:
        second[dimension] = first[dimension] + step
    amplitude = np.sqrt(10 ** (rho_db / 10) / np.prod(model.shape))
    delay, aoa, aod, speed = (np.concatenate(pair) for pair in zip(first, second, strict=True))
    return PathTable(delay, aoa, aod, speed, amplitude * np.exp(2j * np.pi * rng.random(2)))


def likelihood_gain(model: SignalModel, signal, pair: PathTable) -> float:
    """Log-likelihood that two paths, fitted from the truth, gain over the best single one, in unit noise."""
    data, both = Projector(model, signal, Bases.build(model)), pair.geometry
    middle = Geometry(
        both.delay.mean(keepdims=True),
        unit(both.arrival.mean(axis=0, keepdims=True)),
        unit(both.departure.mean(axis=0, keepdims=True)),
        both.speed.mean(keepdims=True),
    )
    single = [joint_fit(data, start, 1.0, 1e-3, 60).explained for start in (both.take([0]), both.take([1]), middle)]
    return joint_fit(data, both, 1.0, 1e-3, 60).explained - max(single)


def unit(vectors):
    """Vectors (P, 3) at unit length."""
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def resolution(dimension: int, separations, rho_db: float, trials: int, seed: int = 41) -> list[dict]:
    """A row for every separation [bins] in ``dimension`` (a number of :data:`DIMENSIONS`)."""
    model = reference_link(64, 16, (4, 4), (4, 4))
    estimator = Nomp(model, arrival_view=FRONT, departure_view=FRONT)
    rows = []
    for number, separation in enumerate(separations):
        good = possible = 0
        for trial in range(trials):
            rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(dimension, number, trial)))
            pair = close_pair(model, dimension, separation, rho_db, rng)
            signal = synthesize(model, pair, 1.0, rng)
            match = associate(model, estimator.run(signal), pair, 1.0)
            good += bool(match.detected.all() and match.false == 0)
            possible += likelihood_gain(model, signal, pair) > estimator.level
        rows.append(
            {
                "separation": separation,
                "resolved": good / trials,
                "interval": proportion(good, trials),
                "possible": possible / trials,
                "trials": trials,
            }
        )
    return rows
