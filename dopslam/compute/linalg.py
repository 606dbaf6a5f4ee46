"""Small dense matrices in compiled code, each function with the NumPy expression that it is.

Loops instead of ``@``: compiling one matrix product of numba takes ten seconds, and a product of 6 × 6 in it is slower than
the loop. Results go into arrays that the caller owns.
"""

from __future__ import annotations

import math

from dopslam.compute.compiled import compiled


@compiled
def cholesky_columns(matrix, size):
    """The columns of the lower Cholesky factor, in place of those of the leading (size, size) block, as far as it is positive
    definite; returns how many."""
    for j in range(size):
        pivot = matrix[j, j]
        for k in range(j):
            pivot -= matrix[j, k] * matrix[j, k]
        if not pivot > 0.0:
            return j
        pivot = math.sqrt(pivot)
        matrix[j, j] = pivot
        for i in range(j + 1, size):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = value / pivot
    return size


@compiled
def cholesky(matrix, size):
    """``matrix[:] = np.linalg.cholesky(matrix)``, the lower triangle of the leading (size, size) block in place; False if
    it is not positive definite."""
    return cholesky_columns(matrix, size) == size


@compiled
def factorize(matrix, size):
    """:func:`cholesky` of a covariance, both triangles given, that rounding may have made indefinite: as little as it takes is
    added to its diagonal, up to a hundredth. False if that is not enough, or if it is not finite."""
    done = cholesky_columns(matrix, size)
    if done == size:  # nearly always: no copy is made for it
        return True
    for j in range(done):
        matrix[j, j] *= matrix[j, j]
        for k in range(j):
            matrix[j, j] += matrix[j, k] * matrix[j, k]
    for i in range(size):
        for j in range(i):
            matrix[i, j] = matrix[j, i]
    kept = matrix[:size, :size].copy()
    share = 1e-12
    while share < 0.02:
        for i in range(size):
            for j in range(size):
                matrix[i, j] = kept[i, j]
            matrix[i, i] += share * abs(kept[i, i])
        if cholesky(matrix, size):
            return True
        share *= 10.0
    return False


@compiled
def solve_lower(factor, size, rows):
    """``rows[:] = np.linalg.solve(np.tril(factor), rows)``, of the leading (size, size) block."""
    columns = rows.shape[1]
    for i in range(size):
        for k in range(i):
            scale = factor[i, k]
            if scale != 0.0:
                for j in range(columns):
                    rows[i, j] -= scale * rows[k, j]
        scale = 1.0 / factor[i, i]
        for j in range(columns):
            rows[i, j] *= scale


@compiled
def solve_lower_vector(factor, size, vector):
    """``vector[:] = np.linalg.solve(np.tril(factor), vector)``; returns ``vector @ vector``."""
    total = 0.0
    for i in range(size):
        value = vector[i]
        for k in range(i):
            value -= factor[i, k] * vector[k]
        value /= factor[i, i]
        vector[i] = value
        total += value * value
    return total
