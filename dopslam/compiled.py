"""One decorator for compiled kernels: `numba.njit` with a disk cache where there is one.

Numba refuses to define a cached function when none of its cache folders can be written (a read-only
installation with no home folder). A cache is a convenience: without it the kernels compile anew in every
process, slower, never broken.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np


def compiled(function: Callable[..., Any]) -> Any:
    """Compile `function` lazily with numba, caching the machine code on disk if a folder can be written."""
    return _compiled(function)


def inlined(function: Callable[..., Any]) -> Any:
    """The same for a function with one caller, whose code becomes part of the caller's.

    Every compiled function optimizes all the code below it once more, so that a long function cut into pieces, each
    compiled for itself, costs its compilation several times.
    """
    return _compiled(function, inline="always")


def _compiled(function: Callable[..., Any], **options: Any) -> Any:
    try:
        return numba.njit(cache=True, error_model="numpy", no_cfunc_wrapper=True, **options)(function)
    except RuntimeError:  # "cannot cache function ...: no locator available for file"
        return numba.njit(error_model="numpy", no_cfunc_wrapper=True, **options)(function)


def compiled_without_lock(function: Callable[..., Any]) -> Any:
    """:func:`compiled` for kernels that threads share: they run without the interpreter's lock."""
    return _compiled(function, nogil=True)


# Assigning a whole array inside a kernel pulls numba's broadcasting and its error texts into the machine code, some ten
# seconds of compilation; these loops do not.


@compiled
def clear(matrix):
    """Set a matrix to zero."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            matrix[i, j] = 0


@compiled
def copy_vector(source, target):
    """target[: len(source)] = source."""
    for i in range(source.shape[0]):
        target[i] = source[i]


@compiled
def copy_matrix(source, target):
    """Copy into the upper left corner of `target`."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            target[i, j] = source[i, j]


@compiled
def take(source, index):
    """source[index]."""
    result = np.empty(index.shape[0], dtype=source.dtype)
    for i in range(index.shape[0]):
        result[i] = source[index[i]]
    return result
