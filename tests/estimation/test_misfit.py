"""Two paths in one detection: seen in the residual, flagged, and covered by the covariance."""

from dataclasses import replace

import numpy as np
import pytest

from estimation import Flag, Nomp, SignalModel, comb, digital, synthesize, ura
from estimation.estimators.refine import metric
from estimation.scenarios import FRONT, Draw, at_snr, draw_paths
from estimation.signal.algebra import gram_diagonal


@pytest.fixture(scope="module")
def link() -> SignalModel:
    return SignalModel(comb(28e9, 6.25e6, 64), digital(8, 125e-6), ura(2, 4), ura(2, 4))


@pytest.fixture(scope="module")
def nomp(link) -> Nomp:
    return Nomp(link, threshold=25.0, arrival_view=FRONT, departure_view=FRONT)


def pair(link, rng, distance, phase, ratio=0.4, decibel=40.0):
    """A path and a weaker one ``distance`` resolution units from it, so and so far out of phase."""
    path = at_snr(link, draw_paths(link, rng, Draw(paths=1)), [10 ** (decibel / 10)])
    lengths = metric(gram_diagonal(link, link.evaluate(path.geometry)), link.active)[0]
    step = rng.standard_normal(6) / np.sqrt(np.diag(lengths))
    step *= distance / np.sqrt(step @ lengths @ step)
    both = path.geometry.joined(path.geometry.moved(step[None]))
    return path, both.table(path.gain * np.array([1.0, ratio * np.exp(1j * phase)]))


def nees(found, path) -> float:
    error = found.vector[0] - path.vector[0]
    return error @ np.linalg.solve(found.covariance[0], error) / 6


def test_a_merged_pair_is_flagged_and_its_covariance_covers_either_path(link, nomp):
    values, bare, flagged = [], [], []
    for seed in range(16):
        rng = np.random.default_rng(seed)
        path, both = pair(link, rng, 0.15, rng.choice([-1, 1]) * rng.uniform(0.8, 2.2))
        found = nomp.run(synthesize(link, both, 1.0, rng))
        if len(found) != 1:
            continue
        flagged.append(bool(found.flags[0] & Flag.MERGED))
        values.append(nees(found, path))
        single = replace(path, gain=path.gain * abs(both.gain.sum() / path.gain[0]))
        clean = nomp.run(synthesize(link, single, 1.0, np.random.default_rng(seed)))
        bare.append(nees(replace(found, covariance=clean.covariance), path))
    assert len(values) >= 8 and np.mean(flagged) > 0.8
    assert np.mean(values) < 2 < 3 < np.mean(bare)


def test_lone_paths_are_not_taken_for_pairs(link, nomp):
    flagged, values = [], []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        path = at_snr(link, draw_paths(link, rng, Draw(paths=1)), [10 ** rng.uniform(2, 6)])
        found = nomp.run(synthesize(link, path, 1.0, rng))
        flagged.append(bool(found.flags[0] & Flag.MERGED))
        values.append(nees(found, path))
    assert np.sum(flagged) <= 4 and 0.7 < np.mean(values) < 1.3


def test_a_weak_second_path_in_the_same_cell_is_still_resolved(link, nomp):
    found = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        path = at_snr(link, draw_paths(link, rng, Draw(paths=1)), [10**5])
        later = path.geometry.moved(np.eye(6)[:1] / link.waveform.bandwidth)
        both = path.geometry.joined(later).table(path.gain * np.array([1.0, 0.1 * np.exp(2j * np.pi * rng.random())]))
        found.append(len(nomp.run(synthesize(link, both, 1.0, rng))) == 2)
    assert np.mean(found) >= 0.9
