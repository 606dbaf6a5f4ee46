"""The files of a dataset, whether it is one file or a folder of shards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from dopslam.config.scenario import Scenario, parse
from dopslam.datasets.manifest import read_manifest
from dopslam.datasets.tracks import Steps
from dopslam.errors import DatasetError
from dopslam.records import Landmarks, Paths, Track
from dopslam.store import file as dataset


@dataclass(frozen=True)
class Part:
    """One dataset file and the number of its first position."""

    path: Path
    first: int

    @cached_property
    def groups(self) -> list[str]:
        """Names of the records the file holds."""
        return dataset.groups(self.path)

    def has(self, group: str) -> bool:
        """Whether the file holds a record."""
        return group in self.groups

    def read(self, group: str, kind):
        """One record."""
        return dataset.read_record(self.path, group, kind)

    @property
    def track(self) -> Track:
        """The true track."""
        return self.read("track", Track)

    @property
    def steps(self) -> Steps:
        """Drive and step of each position; a single file is one drive."""
        if self.has("steps"):
            return self.read("steps", Steps)
        track = self.track
        number = np.arange(track.steps)
        return Steps(number, np.zeros_like(number), number, np.tile(track.start, (track.steps, 1)))

    @property
    def landmarks(self) -> Landmarks:
        """The landmarks that its paths refer to."""
        return self.read("landmarks", Landmarks)

    @property
    def paths(self) -> Paths:
        """The traced paths."""
        return self.read("paths", Paths)


def parts_of(source: str | Path) -> list[Part]:
    """The files of a dataset in order.

    Raises
    ------
    DatasetError
        For a folder without a complete manifest.
    """
    source = Path(source)
    if not source.is_dir():
        return [Part(source, 0)]
    manifest = read_manifest(source)
    if not manifest.complete:
        raise DatasetError(f"{source}: is not complete; finish it with 'dopslam dataset … --resume'")
    return [Part(source / entry.file, entry.first) for entry in manifest.shards]


def scenario_of(parts: Sequence[Part]) -> Scenario:
    """The scenario a dataset was made with."""
    text, _ = dataset.read_root(parts[0].path)
    return parse(text, source=str(parts[0].path))
