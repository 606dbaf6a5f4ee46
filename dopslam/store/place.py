"""Places that results go to: tried before the work, not after it."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from dopslam.errors import DatasetError


def refuse_unwritable(*targets: str | Path | None) -> None:
    """Make sure that files or folders can be made where results will go; ``None`` is no target.

    Nothing is left behind: a file of one byte is made beside each target, or in the nearest folder above it that exists,
    and removed.

    Raises
    ------
    DatasetError
        Naming the target, what stands in its way, and the remedy.
    """
    for target in targets:
        if target is None:
            continue
        path = Path(target)
        above = path if path.is_dir() else path.parent
        try:
            while not above.exists() and above != above.parent:
                above = above.parent
            with tempfile.TemporaryFile(prefix=".dopslam.", dir=above) as file:
                file.write(b"0")
                file.flush()
                os.fsync(file.fileno())
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or str(error)
            raise DatasetError(
                f"{path}: cannot be written ({above}: {why}); name another place or make room"
            ) from error


def refuse_no_file(*targets: str | Path | None) -> None:
    """As :func:`refuse_unwritable`, of targets that will be files and so must not be folders."""
    for target in targets:
        if target is not None and Path(target).is_dir():
            raise DatasetError(f"{target}: is a folder; name a file")
    refuse_unwritable(*targets)
