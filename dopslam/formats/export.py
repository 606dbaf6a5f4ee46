"""A dataset in another format, whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

from dopslam.datasets.parts import parts_of
from dopslam.errors import DatasetError
from dopslam.formats.contract import writer
from dopslam.formats.geojson import Origin
from estimation.plugins import blamed


def export(
    source: str | Path, out: str | Path, kind: str, drive: int | None = None, origin: Origin | None = None
) -> list[Path]:
    """Write a dataset in another format; returns the files made.

    Parameters
    ----------
    source : dataset file or folder
    out : folder that must not exist yet
    kind : of :data:`dopslam.formats.FORMATS`, or ``module:Class``
    drive : number of the only drive that is wanted, for formats that have it
    origin : of the world frame on earth, for formats that have it

    Raises
    ------
    DatasetError
        For an existing ``out``, a source that lacks what the format needs, or a disk that cannot be written.
    """
    out = Path(out)
    if out.exists():
        raise DatasetError(f"{out}: exists already; remove it or name another folder with --out")
    chosen = writer(kind, drive=drive, origin=origin)
    parts = parts_of(source)
    place = None
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        place = Path(tempfile.mkdtemp(prefix=f".{out.name}.", suffix=".part", dir=out.parent))  # nobody else's
        place.chmod(0o755)
        with blamed(chosen, f"format {kind!r}: write", DatasetError):
            chosen.write(parts, place)
        if not any(place.iterdir()):
            raise DatasetError(f"format {kind!r} wrote no file")
        os.replace(place, out)
    except OSError as error:
        raise DatasetError(f"{out}: cannot be written ({error.strerror or error})") from error
    finally:
        if place is not None:
            shutil.rmtree(place, ignore_errors=True)
    return sorted(out.iterdir())
