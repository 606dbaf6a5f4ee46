"""Pairs in one detection whose residual is in phase: told apart, or flagged and covered, and lone paths left alone."""

import numpy as np
import pytest

from estimation import Flag, Nomp, SignalModel, comb, digital, synthesize, ura
from estimation.estimators.noise import Noise
from estimation.estimators.pairs import gained_alone, local_level, steps_between, suspects, told_apart
from estimation.estimators.projector import Bases, Projector
from estimation.estimators.refine import joint_fit, metric
from estimation.evaluate import associate
from estimation.resolution import likelihood_gain
from estimation.scenarios import FRONT, Draw, at_snr, draw_paths
from estimation.signal.algebra import gram_diagonal, signal_of
from estimation.signal.paths import Geometry


def signature(model, geometry: Geometry):
    return signal_of(model, model.evaluate(geometry), np.ones(1)).ravel().astype(complex)


def test_the_score_is_what_least_squares_gains(model, paths):
    """A second path at the reported point, with the known paths' gains and small moves free, by brute force."""
    if model.subbands > 1:
        pytest.skip("sub-bands are not tested for pairs")
    rng = np.random.default_rng(3)
    one = at_snr(model, paths.take([0]), [300.0])
    data = Projector(model, model.whiten(synthesize(model, one, 1.0, rng)), Bases.build(model))
    lin = joint_fit(data, one.geometry, 1.0, 1e-6)
    found = suspects(data, lin, 1.0)
    center, active = lin.geometry, np.flatnonzero(model.active)
    basis = [signature(model, center), 1j * signature(model, center)]
    lengths = metric(gram_diagonal(model, model.evaluate(center)), model.active)[0]
    for a in active:
        step = np.zeros((1, 6))
        step[0, a] = 1e-3 / np.sqrt(lengths[a, a])
        slope = signature(model, center.moved(step)) - signature(model, center.moved(-step))
        basis.append(lin.gain[0] * slope)

    def rest(columns):
        matrix = np.array([np.concatenate([c.real, c.imag]) for c in columns]).T
        matrix = matrix / np.linalg.norm(matrix, axis=0)
        wanted = np.concatenate([data.signal.ravel().real, data.signal.ravel().imag]).astype(float)
        return np.sum((wanted - matrix @ np.linalg.lstsq(matrix, wanted, rcond=1e-10)[0]) ** 2)

    second = signature(model, center.moved(found.step))
    gained = rest(basis) - rest([*basis, second, 1j * second])
    assert found.statistic[0] == pytest.approx(gained, rel=0.03, abs=0.1)


def test_a_suspect_without_neighbors_is_fitted_with_its_own_path_free(link):
    """By the fit of both at once: nothing is held, since nothing else is there."""
    rng = np.random.default_rng(8)
    one = at_snr(link, draw_paths(link, rng, Draw(paths=1)), [800.0])
    data = Projector(link, link.whiten(synthesize(link, one, 1.0, rng)), Bases.build(link))
    lin = joint_fit(data, one.geometry, 1.0, 1e-6)
    second = lin.geometry.moved(suspects(data, lin, 1.0).step)
    both = joint_fit(data, lin.geometry.joined(second), 1.0, 0.5)
    assert gained_alone(data, lin, 0, second, 1.0) == pytest.approx(both.explained - lin.explained, abs=1e-3)


def test_steps_between_paths_lead_there(paths):
    start, step = paths.geometry.take([0]), 1e-3 * np.arange(1.0, 7.0)[None] * [1e-9, 1, 1, 1, 1, 1]
    assert np.allclose(steps_between(start, start.moved(step)), step, rtol=1e-3, atol=0)


def test_a_lobe_holds_fewer_peaks_than_a_search_and_more_with_more_parameters():
    levels = [local_level(0.005, count) for count in range(1, 7)]
    assert np.all(np.diff(levels) > 0) and levels[-1] < 16
    assert local_level(0.0005, 6) - levels[-1] == pytest.approx(np.log(10), abs=1.0)


@pytest.fixture(scope="module")
def link() -> SignalModel:
    return SignalModel(comb(28e9, 6.25e6, 64), digital(8, 125e-6), ura(2, 4), ura(2, 4))


@pytest.fixture(scope="module")
def nomp(link) -> Nomp:
    return Nomp(link, arrival_view=FRONT, departure_view=FRONT)


def in_phase(link, rng, distance, decibel):
    """Two paths in phase, the second half as strong and ``distance`` resolution units off in delay and one direction."""
    path = at_snr(link, draw_paths(link, rng, Draw(paths=1)), [10 ** (decibel / 10)])
    lengths = metric(gram_diagonal(link, link.evaluate(path.geometry)), link.active)[0]
    step = np.array([1.0, rng.choice([-1, 1]), 0, 0, 0, 0]) / np.sqrt(np.diag(lengths))
    step *= distance / np.sqrt(step @ lengths @ step)
    return path.geometry.joined(path.geometry.moved(step[None])).table(path.gain * np.array([1.0, 0.5]))


def test_pairs_in_phase_are_told_apart_or_flagged_and_covered(link, nomp):
    seen, weak, right = [], [], []
    for seed in range(14):
        rng = np.random.default_rng(seed)
        both = in_phase(link, rng, 0.85, 29.0)
        signal = synthesize(link, both, 1.0, rng)
        found = nomp.run(signal)
        weak.append(likelihood_gain(link, signal, both) < nomp.level)
        seen.append(len(found) == 2 or bool(found.flags[0] & Flag.MERGED))
        if len(found) == 2:
            right.append(associate(link, found, both, 1.0).detected.all())
    # Few would pass the threshold of a whole search, whoever looked; and all that is reported as two is two.
    assert np.mean(weak) > 0.6 and np.mean(seen) > 0.75
    assert len(right) > 5 and np.mean(right) > 0.85


def test_lone_paths_are_left_alone(link, nomp):
    for seed in range(25):
        rng = np.random.default_rng(seed)
        path = at_snr(link, draw_paths(link, rng, Draw(paths=1)), [10 ** rng.uniform(2, 5)])
        data = Projector(link, synthesize(link, path, 1.0, rng), Bases.build(link))
        lin = joint_fit(data, path.geometry, 1.0, 1e-3)
        after, spread = told_apart(nomp, data, lin, Noise(float(data.signal.size), data.signal.size, 1.0))
        assert len(after.gain) == 1 and not spread.any(), seed
