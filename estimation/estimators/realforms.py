"""Complex matrices as real ones of single precision: a real product with what lies in memory as pairs of real numbers."""

from __future__ import annotations

import numpy as np


def real_product(matrix):
    """Real form (2n, 2m) of a complex matrix (n, m): interleaved complex rows times it give real, then
    imaginary parts.
    """
    rows = np.empty((2 * matrix.shape[0], 2 * matrix.shape[1]), np.float32)
    rows[0::2] = np.concatenate([matrix.real, matrix.imag], axis=1)
    rows[1::2] = np.concatenate([-matrix.imag, matrix.real], axis=1)
    return rows


def stacked_product(matrix):
    """The same for complex rows given as all real, then all imaginary parts."""
    rows = real_product(matrix)
    return np.concatenate([rows[0::2], rows[1::2]])


def real_rows(matrix):
    """Real form (m, 2, 2n) of the columns of (n, m): times interleaved complex columns they give real and
    imaginary parts.
    """
    count = matrix.shape[1]
    both = real_product(matrix)
    return np.ascontiguousarray(np.stack([both[:, :count].T, both[:, count:].T], axis=1))


def real_pairs(vectors):
    """Weights ((2M)^2, A) that make ``|sum_m conj(a_m) x_m|^2`` of unit vectors (M, A) from all products of
    interleaved parts of x.
    """
    columns = real_product(vectors.conj())
    count = vectors.shape[1]
    real, imag = columns[:, :count], columns[:, count:]
    return (real[:, None] * real + imag[:, None] * imag).reshape(-1, count)
