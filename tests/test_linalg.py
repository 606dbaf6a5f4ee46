"""Small matrices of compiled code against the NumPy expressions they are."""

import numpy as np
import pytest

from dopslam.compute import linalg


@pytest.mark.parametrize("size", [1, 3, 6])
def test_each_is_its_numpy_expression(size):
    rng = np.random.default_rng(size)
    root = rng.normal(size=(size, size))
    matrix = root @ root.T + 0.1 * np.eye(size)
    factor = np.array(matrix)
    assert linalg.cholesky(factor, size)
    lower = np.linalg.cholesky(matrix)
    np.testing.assert_allclose(np.tril(factor), lower, rtol=1e-12)
    rows, vector = rng.normal(size=(size, 4)), rng.normal(size=size)
    expected = np.linalg.solve(lower, rows), np.linalg.solve(lower, vector)
    linalg.solve_lower(factor, size, rows)
    np.testing.assert_allclose(rows, expected[0], rtol=1e-10)
    assert linalg.solve_lower_vector(factor, size, vector) == pytest.approx(expected[1] @ expected[1])
    np.testing.assert_allclose(vector, expected[1], rtol=1e-10)


def test_what_rounding_made_indefinite_is_factorized_all_the_same():
    flat = np.outer([1.0, 2.0, 3.0], [1.0, 2.0, 3.0]) - 1e-13 * np.eye(3)
    assert not linalg.cholesky(flat.copy(), 3)
    factor = flat.copy()
    assert linalg.factorize(factor, 3)
    np.testing.assert_allclose(np.tril(factor) @ np.tril(factor).T, flat, atol=1e-9)
    assert not linalg.cholesky(-np.eye(2), 2) and not linalg.factorize(-np.eye(2), 2)
