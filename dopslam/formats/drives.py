"""Single drives as dataset files of this program, which slam, bound and evaluate take."""

from __future__ import annotations

from pathlib import Path

from dopslam.datasets.drives import write_drive, write_drives
from dopslam.datasets.parts import Part


class Drives:
    """A dataset file for every drive, or for one of a number."""

    writes, reads = True, False

    def __init__(self, drive: int | None = None) -> None:
        self.drive = drive

    def write(self, parts: list[Part], out: Path) -> None:
        """One file a drive."""
        if self.drive is None:
            write_drives(parts, out)
        else:
            write_drive(parts, self.drive, out / f"drive-{self.drive:05d}.h5")
