"""Loopy data association against enumeration."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dopslam.errors import FilterError
from dopslam.slam.association.loopy import exact_association, loopy_association
from dopslam.studies.loopy import error_distribution


def enumerate_marginals(missed, detected, new):
    """Plain sum over all injective associations, in the linear domain."""
    features, measurements = detected.shape
    marginal = np.zeros((features, measurements + 1))
    for joint in itertools.product(range(measurements + 1), repeat=features):
        used = [m for m in joint if m]
        if len(set(used)) < len(used):
            continue
        weight = np.prod([missed[k] if m == 0 else detected[k, m - 1] for k, m in enumerate(joint)])
        weight *= np.prod([new[m] for m in range(measurements) if m + 1 not in used])
        for k, m in enumerate(joint):
            marginal[k, m] += weight
    return marginal / marginal.sum(axis=1, keepdims=True)


def random_case(rng, features, measurements, spread=2.0):
    return (
        rng.normal(0, spread, features),
        rng.normal(0, spread, (features, measurements)),
        rng.normal(0, spread, measurements),
    )


def test_exact_association_is_enumeration():
    rng = np.random.default_rng(1)
    for features, measurements in [(1, 1), (1, 3), (3, 1), (2, 3), (3, 3), (4, 4)]:
        case = random_case(rng, features, measurements)
        np.testing.assert_allclose(exact_association(*case), enumerate_marginals(*map(np.exp, case)), rtol=1e-10)


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1)])
def test_exact_on_stars(shape):
    rng = np.random.default_rng(2)
    for _ in range(20):
        case = random_case(rng, *shape)
        result = loopy_association(*case)
        assert result.converged
        np.testing.assert_allclose(result.marginal, exact_association(*case), atol=1e-9)


def test_exact_on_a_chain():
    """Features and measurements linked as a path graph form a tree."""
    rng = np.random.default_rng(3)
    missed, detected, new = random_case(rng, 4, 4)
    mask = np.eye(4, dtype=bool) | np.eye(4, k=1, dtype=bool)
    detected = np.where(mask, detected, -np.inf)
    result = loopy_association(missed, detected, new, tolerance=1e-12)
    np.testing.assert_allclose(result.marginal, exact_association(missed, detected, new), atol=1e-9)


def test_error_on_loopy_cases_is_moderate():
    """Worst marginal error about 0.1 in small loopy cases (theory §5)."""
    rng = np.random.default_rng(4)
    errors = []
    for _ in range(300):
        case = random_case(rng, int(rng.integers(2, 6)), int(rng.integers(2, 6)))
        result = loopy_association(*case)
        assert result.converged
        errors.append(np.abs(result.marginal - exact_association(*case)).max())
    assert np.median(errors) < 0.02
    assert max(errors) < 0.2
    assert max(errors) > 1e-3  # the cases are loopy enough for the oracle to tell the difference


def test_huge_ratios_keep_small_terms():
    """A feature 1e15 times surer of measurement 0 still sends the right message to measurement 1."""
    log_detected = np.array([[35.0, 0.0], [-np.inf, 0.0]])
    result = loopy_association(np.zeros(2), log_detected, np.zeros(2), tolerance=1e-12)
    exact = exact_association(np.zeros(2), log_detected, np.zeros(2))
    np.testing.assert_allclose(np.log(result.marginal[0, 2]), np.log(exact[0, 2]), atol=1e-6)
    np.testing.assert_allclose(result.marginal[1], exact[1], atol=1e-9)


def test_extreme_logs_do_not_overflow():
    result = loopy_association(np.array([-4.0]), np.array([[900.0, -900.0]]), np.array([0.0, 0.0]))
    assert np.isfinite(result.log_nu).all()
    np.testing.assert_allclose(result.marginal, [[0, 1, 0]], atol=1e-12)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.integers(1, 5))
def test_permutation_and_column_scaling(seed, features, measurements):
    rng = np.random.default_rng(seed)
    missed, detected, new = random_case(rng, features, measurements)
    base = loopy_association(missed, detected, new).marginal
    rows, columns = rng.permutation(features), rng.permutation(measurements)
    permuted = loopy_association(missed[rows], detected[rows][:, columns], new[columns]).marginal
    np.testing.assert_allclose(permuted[:, 1:], base[rows][:, 1 + columns], atol=1e-5)
    shift = rng.normal(0, 30, measurements)
    np.testing.assert_allclose(loopy_association(missed, detected + shift, new + shift).marginal, base, atol=1e-5)


def test_empty_sides():
    assert loopy_association(np.zeros(2), np.zeros((2, 0)), np.zeros(0)).marginal.shape == (2, 1)
    result = loopy_association(np.zeros(0), np.zeros((0, 3)), np.zeros(3))
    np.testing.assert_array_equal(result.new, np.ones(3))


def test_errors_name_the_remedy():
    with pytest.raises(FilterError, match="shape"):
        loopy_association(np.zeros(2), np.zeros((3, 2)), np.zeros(2))
    with pytest.raises(FilterError, match="NaN"):
        loopy_association(np.zeros(1), np.full((1, 1), np.nan), np.zeros(1))


def test_error_distribution_repeats_and_covers_what_it_says():
    first, second = error_distribution(40), error_distribution(40)
    assert first.table() == second.table()
    table = first.table()
    assert len(table) == 4
    for row in table.values():
        assert row["cases"] == 40 and row["unconverged"] == 0
        assert row["quantile_0.5"] <= row["quantile_0.9"] <= row["quantile_1"] < 0.5
        assert row["likeliest_differs"] < 0.05
    medians = [row["quantile_0.5"] for row in table.values()]
    assert medians[1] < 1e-2 < max(medians[2:])  # features far apart hardly compete, close ones do
