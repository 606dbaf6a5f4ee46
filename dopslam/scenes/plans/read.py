"""Reads a plan, a map or a model by the ending of its name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from dopslam.errors import ConfigError
from dopslam.scenes.generators.draft import Box, Mesh, Sheet
from dopslam.scenes.plans.geojson import read_geojson
from dopslam.scenes.plans.model import read_model
from dopslam.scenes.plans.osm import read_osm
from dopslam.scenes.plans.picture import read_picture
from dopslam.scenes.plans.raise_ import Usual, shapes_of

Shapes = list[Box | Sheet | Mesh]


def _picture(path: Path, usual: Usual, scale: float | None) -> Shapes:
    if scale is None:
        raise ConfigError(f"{path}: a picture says nothing about its size; give --scale, in pixels to the meter")
    return shapes_of(read_picture(path, scale), usual, indoor=True)


def _geojson(path: Path, usual: Usual, scale: float | None) -> Shapes:
    features, is_map = read_geojson(path)
    return shapes_of(features, usual, indoor=False if is_map else None)


def _osm(path: Path, usual: Usual, scale: float | None) -> Shapes:
    return shapes_of(read_osm(path), usual, indoor=False)


def _model(path: Path, usual: Usual, scale: float | None) -> Shapes:
    return list(read_model(path, usual.wall))


READERS: dict[str, Callable[[Path, Usual, float | None], Shapes]] = {
    ".geojson": _geojson, ".json": _geojson, ".osm": _osm, ".png": _picture, ".jpg": _picture, ".jpeg": _picture,
    ".glb": _model, ".gltf": _model, ".ply": _model, ".obj": _model,
}  # fmt: skip


def read_plan(path: Path, usual: Usual | None = None, scale: float | None = None) -> Shapes:
    """Shapes of a plan, a map or a model.

    Parameters
    ----------
    path : a file with an ending in :data:`READERS`
    usual : heights and materials where the file says none
    scale : pixels to the meter, of a picture

    Raises
    ------
    ConfigError
        If there is no such file, its ending is unknown, its content malformed, or an extra is missing.
    """
    if not path.is_file():
        raise ConfigError(f"{path}: no such file")
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise ConfigError(f"{path}: {path.suffix or 'no ending'} is not known; give one of {', '.join(READERS)}")
    return reader(path, usual or Usual(), scale)
