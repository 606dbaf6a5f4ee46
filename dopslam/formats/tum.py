"""TUM: trajectories as the robotics tools read them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from dopslam.datasets.parts import Part
from dopslam.formats.mapped import runs_of


class Tum:
    """A text file per drive and per filter."""

    writes, reads = True, False

    def write(self, parts: list[Part], out: Path) -> None:
        """``drive-00000.tum``: time x y z qx qy qz qw of every true drive; ``slam_….tum`` of every filter history in a
        file.

        Raises
        ------
        DatasetError
            If there is neither.
        """
        handles: dict[int, Path] = {}
        for part in (part for part in parts if part.has("track")):
            track, steps = part.track, part.steps
            for drive in np.unique(steps.drive).tolist():
                rows = np.flatnonzero(steps.drive == drive)
                path = handles.setdefault(drive, out / f"drive-{drive:05d}.tum")
                with open(path, "a", encoding="ascii") as file:
                    file.writelines(_pose_lines(track.time[rows], track.position[rows], track.heading[rows]))
        if not handles or any(group.startswith("slam_") for part in parts for group in part.groups):
            for run in runs_of(parts):
                lines = _pose_lines(run.time, run.position, run.history.mean[:, 2])
                (out / f"{run.name}.tum").write_text("".join(lines), encoding="ascii")


def _pose_lines(time: np.ndarray, position: np.ndarray, heading: np.ndarray) -> Iterator[str]:
    for t, (x, y, z), angle in zip(time.tolist(), position.tolist(), heading.tolist(), strict=True):
        yield f"{t:.9f} {x:.9f} {y:.9f} {z:.9f} 0 0 {np.sin(angle / 2):.12f} {np.cos(angle / 2):.12f}\n"
