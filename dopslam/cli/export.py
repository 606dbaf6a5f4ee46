"""``dopslam export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def export(
    dataset: Path,
    *,
    to: Annotated[str, Parameter(name="--to")],
    out: Path,
    drive: int | None = None,
    origin: str | None = None,
) -> None:
    """Write a dataset for other programs into a new folder.

    Parameters
    ----------
    dataset
        Dataset file, or folder made by 'dopslam dataset'.
    to
        mat: flat tables for MATLAB. deepmimo: matrices of DeepMIMO v4. tum: trajectories. sigmf: the signal. csv: true
        paths and positions, tracks and maps of the filters. geojson, gltf, ply: the map of every filter with its walls.
        mcap: its run as ROS 2 messages. rrd: as a recording for the Rerun viewer.
        drives: a dataset file for every drive, which slam, bound and evaluate take.
        module:Class or file.py:Class is one of your own.
    out
        Folder to make.
    drive
        Number of the only drive that is wanted, with --to drives.
    origin
        Where the world frame lies, with --to geojson: latitude,longitude[,height[,azimuth]], the azimuth that of the x axis in
        degrees counterclockwise from east. Without it coordinates are meters.
    """
    from rich.console import Console

    from dopslam.formats.export import export as write
    from dopslam.formats.geojson import Origin

    files = write(dataset, out, to, drive, None if origin is None else Origin.parse(origin))
    Console(highlight=False, soft_wrap=True, markup=False).print(f"{out}: {len(files)} files, {files[0].name} …")
