"""Decorators for compiled kernels: `numba.njit` with the disk cache of :mod:`estimation.jit` where there is one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from estimation.jit import cached

_ROOT = Path(__file__).resolve().parents[1]


def compiled(function: Callable[..., Any]) -> Any:
    """Compile `function` lazily with numba, caching the machine code on disk if a folder can be written."""
    return compiled_with(function)


def inlined(function: Callable[..., Any]) -> Any:
    """The same for a function with one caller, whose code becomes part of the caller's.

    Every compiled function optimizes all the code below it once more, so that a long function cut into pieces, each
    compiled for itself, costs its compilation several times.
    """
    return compiled_with(function, inline="always")


def compiled_with(function: Callable[..., Any], **options: Any) -> Any:
    """The same with further options of ``numba.njit``."""
    return cached(function, _ROOT, error_model="numpy", no_cfunc_wrapper=True, **options)


def compiled_without_lock(function: Callable[..., Any]) -> Any:
    """:func:`compiled` for kernels that threads share: they run without the interpreter's lock."""
    return compiled_with(function, nogil=True)


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
