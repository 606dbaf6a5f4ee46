"""GOSPA against enumeration and its axioms, RMSE and NEES."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dopslam.evaluate.metrics import gospa, nees, rmse_over_bound, squared_errors, state_errors


def by_enumeration(truth, estimate, c, p):
    """α = 2: best over all partial matchings."""
    if len(truth) > len(estimate):
        truth, estimate = estimate, truth
    best = np.inf
    for choice in permutations(range(len(estimate)), len(truth)):
        d = np.array([np.linalg.norm(t - estimate[j]) for t, j in zip(truth, choice, strict=True)])
        near = d < c
        total = (d[near] ** p).sum() + c**p / 2 * (2 * (~near).sum() + len(estimate) - len(truth))
        best = min(best, total)
    return best ** (1 / p)


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 4), st.integers(0, 4), st.integers(0, 10_000), st.sampled_from([1.0, 2.0]))
def test_matches_enumeration(count_true, count_found, seed, p):
    rng = np.random.default_rng(seed)
    truth, estimate = rng.uniform(0, 30, (count_true, 3)), rng.uniform(0, 30, (count_found, 3))
    result = gospa(truth, estimate, 20.0, p)
    assert result.distance == pytest.approx(by_enumeration(truth, estimate, 20.0, p), abs=1e-9)
    assert result.distance**p == pytest.approx(result.localization + result.missed + result.false)
    assert gospa(estimate, truth, 20.0, p).distance == pytest.approx(result.distance)


def test_four_missing_landmarks_of_the_paper():
    truth = np.eye(4, 3) * 100
    values = [gospa(truth, truth[:found]).distance for found in range(5)]
    np.testing.assert_allclose(values, [28.284, 24.495, 20.0, 14.142, 0.0], atol=1e-3)
    assert gospa(truth, np.empty((0, 3))).missed_count == 4
    assert gospa(np.empty((0, 3)), truth).false_count == 4


def test_errors_wrap_the_heading():
    error = state_errors(np.array([1.0, 2.0, np.pi - 0.1, 0.0]), np.array([0.0, 0.0, -np.pi + 0.1, 1.0]))
    np.testing.assert_allclose(error, [1, 2, -0.2, -1])
    assert squared_errors(error)["position"] == pytest.approx(5.0)


def test_nees_and_ratio():
    rng = np.random.default_rng(2)
    root = rng.normal(size=(4, 4))
    errors = rng.normal(size=(20000, 4)) @ root.T
    assert nees(errors, np.broadcast_to(root @ root.T, (20000, 4, 4))).mean() == pytest.approx(4, abs=0.1)
    assert rmse_over_bound(np.full((5, 3), 4.0), np.full((5, 3), 1.0)) == 2.0


def test_nees_where_a_state_is_known_or_nothing_is_known_of_it():
    covariance = np.diag([4.0, 9.0, 0.0, np.inf])
    assert nees(np.array([2.0, 3.0, 0.0, 5.0]), covariance) == pytest.approx(2.0)
    assert nees(np.array([2.0, 3.0, 0.1, 5.0]), covariance) == np.inf
    tied = np.array([[1.0, 1.0], [1.0, 1.0]])  # the difference is known
    assert nees(np.array([2.0, 2.0]), tied) == pytest.approx(4.0)
    assert nees(np.array([2.0, 1.0]), tied) > 1e12
    values = nees(np.ones((2, 2)), np.array([np.eye(2), np.full((2, 2), np.nan)]))
    assert values[0] == 2.0 and np.isnan(values[1])


def test_impossible_parameters_are_refused():
    with pytest.raises(Exception, match="cutoff"):
        gospa(np.zeros((1, 3)), np.zeros((1, 3)), cutoff=0)
