"""Monte Carlo: at the bound, calibrated covariances, detection law, false paths (about half a minute on one core)."""

from __future__ import annotations

import numpy as np
import pytest

from estimation import Nomp, SignalModel, comb, detection_probability, digital, unit_vectors, ura
from estimation.evaluate import summarize
from estimation.resolution import close_pair, resolution
from estimation.scenarios import FRONT, Draw, at_snr, draw_paths, reference_link, swept_link
from estimation.studies import run_series

pytestmark = pytest.mark.mc


@pytest.fixture(scope="module")
def runs():
    """Sixty bursts of five paths with rho uniform over 12 to 45 dB on a sixteenth of the reference link."""
    model = SignalModel(comb(28e9, 6.25e6, 64), digital(16, 125e-6), ura(2, 4), ura(2, 4))
    estimator = Nomp(model, arrival_view=FRONT, departure_view=FRONT)
    draw = Draw(paths=5, separation=1.2)
    cases = [lambda rng: (at_snr(model, draw_paths(model, rng, draw), 10 ** rng.uniform(1.2, 4.5, 5)), 1.0)] * 60
    return run_series(estimator, model, cases, seed=3)


def test_errors_are_at_the_bound_and_covariances_are_honest(runs):
    total = summarize(runs.matches, 10**1.8)
    assert total.associations > 200 and total.gross == 0
    # Standard error of an RMSE ratio over 200 associations is 0.05.
    assert np.all((total.rmse_over_crb > 0.85) & (total.rmse_over_crb < 1.15)), total.rmse_over_crb
    assert 0.88 < total.nees_over_n < 1.12
    # Negative control: covariances twice as large would fall out.
    assert not 0.88 < total.nees_over_n / 2 < 1.12


def test_detection_follows_the_law_and_false_paths_the_nominal_rate(runs):
    rho = np.concatenate([m.rho for m in runs.matches])
    found = np.concatenate([m.detected for m in runs.matches])
    law = detection_probability(rho, runs.threshold, runs.parameters)
    spread = np.sqrt(np.sum(law * (1 - law)) + 1)
    assert abs(found.sum() - law.sum()) < 4 * spread
    assert found[rho > 10**1.9].all()
    # Nominal 0.01 per burst: 0.6 expected over 60.
    assert sum(m.false for m in runs.matches) <= 4


def test_swept_link_at_the_bound():
    model = swept_link()
    estimator = Nomp(model)

    def case(rng):
        from estimation import PathTable

        count = 5
        angles = [np.c_[rng.uniform(-3.1, 3.1, count), rng.uniform(-0.8, 0.8, count)] for _ in range(2)]
        delay, speed = rng.uniform(0, 2e-6, count), rng.uniform(-22, 22, count)
        unit = PathTable(delay, *angles, speed, np.exp(2j * np.pi * rng.random(count)))
        return at_snr(model, unit, 10 ** rng.uniform(1.9, 4.5, count)), 1.0

    runs = run_series(estimator, model, [case] * 20, seed=5)
    total = summarize(runs.matches, 10**1.8)
    assert total.associations == 100 and total.gross == 0
    assert np.all((total.rmse_over_crb > 0.8) & (total.rmse_over_crb < 1.2)), total.rmse_over_crb
    assert 0.83 < total.nees_over_n < 1.17
    assert sum(m.false for m in runs.matches) <= 2


def test_close_pairs_are_told_apart_where_a_likelihood_ratio_could():
    """AOA at 0.3 bins: in phase the pair may stay below any threshold, in opposition a fit may be stuck."""
    row = resolution(1, (0.3,), 40.0, 16)[0]
    assert row["possible"] > 0.8
    assert row["resolved"] >= row["possible"] - 0.13


def test_pairs_are_as_far_apart_as_asked():
    model = reference_link(64, 16, (4, 4), (4, 4))
    for dimension in range(4):
        pair = close_pair(model, dimension, 0.5, 30.0, np.random.default_rng(3))
        bins = [
            np.diff(pair.delay) * 400e6,
            np.diff(unit_vectors(pair.aoa)[:, 1]) * 2,
            np.diff(unit_vectors(pair.aod)[:, 1]) * 2,
            np.diff(pair.radial_velocity) * 2e-3 / model.waveform.wavelength,
        ]
        assert np.allclose(np.ravel(bins), 0.5 * (np.arange(4) == dimension), atol=1e-9)
        assert np.allclose(np.abs(pair.gain) ** 2 * np.prod(model.shape), 1e3)
