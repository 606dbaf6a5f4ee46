"""Intervals over runs: they cover what they should, and agree with each other where they must."""

import numpy as np
import pytest

from estimation import statistics


def test_intervals_of_a_mean_cover_it_and_agree():
    rng = np.random.default_rng(7)
    inside = {"bootstrap": 0, "student": 0}
    for _ in range(300):
        values = rng.normal(2.0, 1.5, 40)
        low, high = statistics.bootstrap(values, draws=300)
        inside["bootstrap"] += low < 2.0 < high
        told = statistics.mean(values)
        inside["student"] += told["low"] < 2.0 < told["high"]
        assert high - low == pytest.approx(told["high"] - told["low"], rel=0.35)
    assert all(270 <= count <= 298 for count in inside.values()), inside  # 285 expected, 4 standard errors


def test_columns_are_drawn_together():
    rng = np.random.default_rng(8)
    error = rng.normal(size=(50, 6))
    assert statistics.bootstrap([error, error], lambda a, b: float(np.abs(a - b).max())) == [0.0, 0.0]


def test_a_single_run_has_no_interval():
    assert statistics.mean([3.0]) == {"mean": 3.0, "low": 3.0, "high": 3.0}
    assert statistics.bootstrap(np.array([3.0])) == [3.0, 3.0]


def test_a_proportion_is_known_at_its_ends():
    assert statistics.proportion(0, 20) == pytest.approx((0.0, 1 - 0.025 ** (1 / 20)))
    assert statistics.proportion(20, 20) == pytest.approx((0.025 ** (1 / 20), 1.0))
    assert statistics.share(0, 0)["high"] == 1.0
