"""GeoJSON: floor plans in meters, maps in degrees.

Lines are walls, areas are blocks (or, where one encloses all the others, the outline of a room); ``height`` [m], or ``building:levels``,
``material`` (ITU type) and ``name`` of a feature's properties are used. Coordinates that span less than 0.2 are taken for
degrees of longitude and latitude: no plan is 20 cm wide, and no map 20 km.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from dopslam.errors import ConfigError
from dopslam.scenes.plans.raise_ import HEIGHTS, Feature

DEGREES = 0.2
EARTH = 6_378_137.0  # m, equatorial radius of WGS 84


def read_geojson(path: Path) -> tuple[list[Feature], bool]:
    """The lines and areas of a file in meters, and whether it is a map: it was in degrees.

    Raises
    ------
    ConfigError
        If it is no GeoJSON, or holds neither.
    """
    try:
        tree = json.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: cannot be read as GeoJSON ({error})") from error
    if not isinstance(tree, dict):
        raise ConfigError(f"{path}: a GeoJSON object is expected, with a type and features")
    entries = tree.get("features", [tree])
    features: list[Feature] = []
    for number, entry in enumerate(entries if isinstance(entries, list) else [], start=1):
        try:
            features += _features(entry, number)
        except (TypeError, ValueError, KeyError, IndexError, AttributeError) as error:
            raise ConfigError(f"{path}: feature {number} is malformed ({error})") from error
    if not features:
        raise ConfigError(f"{path}: holds no LineString and no Polygon; draw walls as lines or blocks as polygons")
    return in_meters(features), in_degrees(features)


def _features(entry: dict, number: int) -> list[Feature]:
    geometry: dict[str, Any] = entry.get("geometry", entry) or {}
    properties: dict[str, Any] = entry.get("properties") or {}
    kind = str(geometry.get("type"))
    coordinates: Any = geometry.get("coordinates")
    if kind == "GeometryCollection":
        return [
            f
            for part in geometry["geometries"]
            for f in _features({"geometry": part, "properties": properties}, number)
        ]
    parts = {
        "LineString": lambda: [(coordinates, False)],
        "MultiLineString": lambda: [(line, False) for line in coordinates],
        "Polygon": lambda: [(coordinates, True)],
        "MultiPolygon": lambda: [(area, True) for area in coordinates],
    }.get(kind, list)()
    name = str(properties.get("name") or f"{'block' if 'Polygon' in kind else 'wall'}_{number}")
    common = {
        "height": _height(properties),
        "material": properties.get("material"),
    }
    found = []
    for points, area in parts:
        rings = [np.array([p[:2] for p in ring], dtype=float) for ring in (points if area else [points])]
        if not all(np.isfinite(ring).all() and ring.ndim == 2 for ring in rings):
            raise ValueError("a coordinate is no number")
        found.append(Feature(name, rings[0], area, tuple(rings[1:]), **common))
    return found


def _height(properties: dict) -> float | None:
    """Height in meters, as a number or as maps write it (``"15 m"``), or from the levels; None where nothing says it."""
    for key, unit in HEIGHTS:
        stated = properties.get(key)
        text = str(stated if stated is not None else "").strip().removesuffix("m").strip()
        if not text:
            continue
        try:
            value = float(text) * unit
        except ValueError:
            value = 0.0
        if not 0 < value < 1000:
            raise ValueError(f"{key} {stated!r}; give a number above 0, heights in meters")
        return value
    return None


def in_degrees(features: list[Feature]) -> bool:
    """Whether the coordinates are longitudes and latitudes."""
    return bool(np.ptp(np.concatenate([f.points for f in features]), axis=0).max() < DEGREES)


def in_meters(features: list[Feature]) -> list[Feature]:
    """Degrees turned into meters east and north of the middle; what is in meters is left alone."""
    if not in_degrees(features):
        return features
    corners = np.concatenate([f.points for f in features])
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    scale = np.deg2rad(EARTH) * np.array([np.cos(np.deg2rad(middle[1])), 1.0])

    def turned(points: np.ndarray) -> np.ndarray:
        return (points - middle) * scale

    return [
        Feature(f.name, turned(f.points), f.area, tuple(map(turned, f.holes)), f.height, f.material) for f in features
    ]
