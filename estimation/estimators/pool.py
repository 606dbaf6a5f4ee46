"""Large arrays that serve again from burst to burst.

The system clears memory before it hands it out, which for a burst's worth of spectra takes as long as filling them.
"""

from __future__ import annotations

import threading
import weakref

import numpy as np


class Pool(threading.local):
    """Arrays lent to owners, and taken back when these are gone; a pool of its own in every thread and process."""

    def __init__(self) -> None:
        self._free: dict[tuple[int, ...], list[np.ndarray]] = {}

    def __reduce__(self):
        return Pool, ()

    def lend(self, owner, shape: tuple[int, ...]) -> np.typing.NDArray[np.float32]:
        """A single-precision array with undefined values that nobody else has as long as ``owner`` lives."""
        free = self._free.setdefault(shape, [])
        array = free.pop() if free else np.empty(shape, np.float32)
        weakref.finalize(owner, free.append, array).atexit = False
        return array
