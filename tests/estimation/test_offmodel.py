"""Bursts that the estimator was told nothing of make no ghosts, and what the study adds to them is what it says."""

import numpy as np
import pytest

from estimation import SignalModel, comb, digital, random_phase_beams, sweep, ura
from estimation.offmodel import CASES, burst, echoes, interferer, louder, off_model, unequal

SMALL = SignalModel(comb(28e9, 6.25e6, 64), digital(12, 125e-6), ura(2, 4), ura(2, 4))


# The others have tests of their own (test_mismatch, test_colored, test_haze).
@pytest.mark.parametrize("name", ["path at 150 of 145 ns", "bad symbol 20 dB", "bad pilot 20 dB", "unequal ports"])
def test_no_case_makes_ghosts(name):
    row = burst(CASES[name], 4)
    assert row["ghosts"] <= 1 and row["strong"] >= 0.9 and np.mean(row["nees"]) <= 2.5


def test_what_is_added_is_as_strong_as_it_says():
    rng = np.random.default_rng(0)
    assert np.mean(np.abs(echoes(-10.0)(SMALL, rng)) ** 2) == pytest.approx(0.1, rel=1e-3)
    assert np.mean(np.abs(interferer(10.0)(SMALL, rng)) ** 2) == pytest.approx(10, rel=0.15)
    one = np.mean(np.abs(louder(1, 20.0)(SMALL, rng)) ** 2, axis=(0, 2, 3))
    assert np.sum(one > 0) == 1 and one.max() == pytest.approx(100, rel=0.1)
    assert np.ptp(np.mean(np.abs(unequal(SMALL, rng)) ** 2, axis=(0, 1, 3))) > 1


def test_an_interferer_comes_through_combiners():
    rng = np.random.default_rng(1)
    square = np.linalg.qr(rng.standard_normal((8, 8)) + 1j * rng.standard_normal((8, 8)))[0]
    combiners = np.stack([square[:, :4], square[:, 4:]])
    schedule = sweep(random_phase_beams(4, 8, rng), 2, 30e-6, combiners=combiners, rng=rng)
    model = SignalModel(comb(28e9, 6.25e6, 32), schedule, ura(2, 4), ura(2, 4))
    received = interferer(10.0)(model, rng)
    assert received.shape == model.shape
    # Of one direction: at each setting of the combiner a single combination of the ports.
    for setting in range(2):
        rows = received[:, schedule.combiner_index == setting].reshape(-1, 4)
        values = np.linalg.svd(rows, compute_uv=False)
        assert values[1] < 1e-5 * values[0]


def test_a_study_is_a_table_of_cases_and_the_same_every_time():
    first = off_model([5], ["clean", "half the variance"])
    again = off_model([5], ["clean", "half the variance"])
    assert list(first) == ["clean", "half the variance"]
    for name, row in first.items():
        assert row["snapshots"] == 1 and row["over_clean"] is not None
        assert row["nees_over_6"] == again[name]["nees_over_6"]
