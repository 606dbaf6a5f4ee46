"""One decorator for compiled kernels: `numba.njit` with a disk cache where there is one.

Numba refuses to define a cached function when none of its cache folders can be written (a read-only
installation with no home folder). A cache is a convenience: without it the kernels compile anew in every
process, slower, never broken.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba


def compiled(function: Callable[..., Any]) -> Any:
    """Compile `function` lazily with numba, caching the machine code on disk if a folder can be written."""
    try:
        dispatcher = numba.njit(cache=True, error_model="numpy")(function)
    except RuntimeError:  # "cannot cache function ...: no locator available for file"
        return numba.njit(error_model="numpy")(function)
    return dispatcher
