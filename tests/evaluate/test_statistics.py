"""Intervals over runs and over steps hold what they promise; an interval over steps minds that errors last."""

import numpy as np
import pytest

from dopslam.evaluate.statistics import block_length, over_runs, over_steps


def test_over_runs_against_hand_computation():
    found = over_runs([1.0, 2.0, 3.0])
    np.testing.assert_allclose(found, (2.0, 2 - 4.302652729911275 / np.sqrt(3), 2 + 4.302652729911275 / np.sqrt(3)))
    assert np.isnan(over_runs([1.0]).low) and np.isnan(over_runs([]).value)


def test_the_interval_over_runs_holds_the_mean_95_times_of_100():
    draws = np.random.default_rng(0).normal(3.0, 1.0, (2000, 5))
    inside = [low <= 3.0 <= high for _, low, high in map(over_runs, draws)]
    assert 0.935 < np.mean(inside) < 0.965


def lasting(rng, count, steps, memory):
    """Errors of a first-order process of unit variance."""
    errors = rng.normal(size=(count, steps))
    for k in range(1, steps):
        errors[:, k] = memory * errors[:, k - 1] + np.sqrt(1 - memory**2) * errors[:, k]
    return errors


def test_blocks_hold_the_truth_more_often_than_single_steps_where_errors_last(monkeypatch):
    from dopslam.evaluate import statistics

    errors = lasting(np.random.default_rng(1), 200, 200, 0.8)

    def coverage():
        return np.mean([low <= 1.0 <= high for _, low, high in map(over_steps, errors)])

    blocked = coverage()
    monkeypatch.setattr(statistics, "block_length", lambda steps: 1)
    assert coverage() < 0.75 < blocked


def test_differences_over_steps_are_paired():
    rng = np.random.default_rng(2)
    common = 5.0 + rng.normal(size=60)
    found = over_steps(common + 0.1, common)
    assert 0.09 < found.low < found.value < found.high < 0.11
    assert over_steps(common, common) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("steps", [1, 5])
def test_a_few_steps_get_no_interval(steps):
    assert steps < 2 * block_length(steps)
    assert np.isnan(over_steps(np.ones(steps)).low)
