"""Where the snapshots of a received signal come from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from dopslam.store import file as dataset


class Snapshots(Protocol):
    """Where the snapshots of a signal come from."""

    @property
    def steps(self) -> int:
        """Number of snapshots."""
        ...

    @property
    def time(self) -> np.ndarray | None:
        """(K,) s of every snapshot, if they follow one another."""
        ...

    def snapshot(self, step: int) -> np.ndarray:
        """Received signal of one step."""
        ...


@dataclass(frozen=True)
class StoredSignal:
    """Snapshots read from a dataset file, perhaps somebody else's."""

    path: Path
    steps: int
    time: np.ndarray | None = None

    def snapshot(self, step: int) -> np.ndarray:
        """Received signal of one step."""
        return dataset.read_snapshot(self.path, step)
