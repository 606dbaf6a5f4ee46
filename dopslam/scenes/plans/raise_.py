"""What is drawn from above becomes walls and blocks: lines are raised to sheets, areas to closed blocks.

Meters, z up. An area that encloses everything else is the outline of a room: it is raised to walls that are seen from
inside, with a floor and a ceiling.
"""

from __future__ import annotations

import importlib
import itertools
from dataclasses import dataclass, replace

import numpy as np

from dopslam.errors import ConfigError
from dopslam.scenes.generators.draft import Box, Mesh, Sheet

LOWEST, SHORTEST = 0.01, 0.02  # m; edges shorter than this are slips of the drawing
GROUND_BEYOND = 60.0  # m, of the ground around what is drawn
HEIGHTS = (
    ("height", 1.0),
    ("building:height", 1.0),
    ("building:levels", 3.0),
)  # tags of maps, and their unit in meters
STOREY = 5.0  # m; areas that are higher are buildings, not what stands in a room
INDOOR = 90.0  # m, the largest extent of a plan that is taken for one of rooms where none of its areas encloses it


@dataclass(frozen=True)
class Feature:
    """One thing of a plan.

    Attributes
    ----------
    name : str
    points : (n, 2) m, corners in order; of an area without the first repeated
    area : whether it is closed
    holes : (n, 2) m each
    height : m, or None for the plan's; material : ITU type, or None
    """

    name: str
    points: np.ndarray
    area: bool
    holes: tuple[np.ndarray, ...] = ()
    height: float | None = None
    material: str | None = None


@dataclass(frozen=True)
class Usual:
    """What is taken where a plan does not say it: heights [m] and ITU types."""

    height: float = 2.8
    wall: str = "concrete"
    floor: str = "concrete"
    ceiling: str = "plasterboard"
    building_height: float = 9.0


def shapes_of(features: list[Feature], usual: Usual, indoor: bool | None = None) -> list[Box | Sheet | Mesh]:
    """Sheets, blocks, and the floor, ceiling or ground they stand on.

    Parameters
    ----------
    features : of one plan, in meters
    indoor : whether it is a plan of rooms; None: by its size and by how high its areas are said to be
    """
    features = [f for f in map(_cleaned, features) if len(f.points) >= (3 if f.area else 2)]
    if not features:
        raise ConfigError("the plan holds no line and no area of any size; draw walls as lines or blocks as areas")
    corners = np.concatenate([f.points for f in features])
    low, high = corners.min(axis=0), corners.max(axis=0)
    outline = _outline(features, low, high) if indoor is not False else None
    if indoor is None:
        buildings = outline is None and any(f.area and (f.height or 0.0) > STOREY for f in features)
        indoor = bool((high - low).max() < INDOOR) and not buildings
        outline = outline if indoor else None
    default = usual.height if indoor else usual.building_height
    # A ceiling lies on the walls: on those of the outline if it says how high they are, else on the highest.
    around = next((f.height for f in features if f.name == outline), None)
    top = around or max([default, *(f.height for f in features if f.height)])
    shapes: list[Box | Sheet | Mesh] = []
    for feature in _named(features):
        height = feature.height or (top if feature.name == outline else default)
        material = feature.material or usual.wall
        if feature.area and (outline is None or feature.name != outline):
            shapes.append(block(feature, height, material))
        else:
            ring = np.concatenate([feature.points, feature.points[:1]]) if feature.area else feature.points
            shapes += _sheets(feature.name, material, ring, height)
    middle, half = 0.5 * (low + high), 0.5 * (high - low) + (0.05 if indoor else GROUND_BEYOND)
    floor = Sheet("floor" if indoor else "ground", usual.floor, (*middle, 0.0), (half[0], 0, 0), (0, half[1], 0))
    shapes.append(floor)
    if indoor:
        shapes.append(replace(floor, name="ceiling", material=usual.ceiling, center=(*middle, top)))
    return shapes


def _cleaned(feature: Feature) -> Feature:
    """Without corners that repeat the one before."""

    def distinct(points: np.ndarray) -> np.ndarray:
        away = np.linalg.norm(np.diff(points, axis=0), axis=1) > SHORTEST
        points = points[np.concatenate([[True], away])]
        closes = feature.area and len(points) > 1 and np.linalg.norm(points[0] - points[-1]) <= SHORTEST
        return points[:-1] if closes else points

    return replace(feature, points=distinct(feature.points), holes=tuple(map(distinct, feature.holes)))


def _named(features: list[Feature]) -> list[Feature]:
    seen: dict[str, int] = {}
    named = []
    for feature in features:
        count = seen[feature.name] = seen.get(feature.name, 0) + 1
        named.append(feature if count == 1 else replace(feature, name=f"{feature.name}_{count}"))
    return named


def _outline(features: list[Feature], low: np.ndarray, high: np.ndarray) -> str | None:
    """Name of the area that reaches around everything else."""
    for feature in features:
        reaches = np.all(feature.points.min(axis=0) <= low + 0.3) and np.all(feature.points.max(axis=0) >= high - 0.3)
        if feature.area and reaches and not feature.holes:
            return feature.name
    return None


def _sheets(name: str, material: str, line: np.ndarray, height: float) -> list[Sheet]:
    half = 0.5 * height
    sheets = []
    for number, (a, b) in enumerate(itertools.pairwise(line), start=1):
        middle, along = 0.5 * (a + b), 0.5 * (b - a)
        label = name if len(line) == 2 else f"{name}_{number}"
        sheets.append(
            Sheet(
                label,
                material,
                (float(middle[0]), float(middle[1]), half),
                (float(along[0]), float(along[1]), 0.0),
                (0, 0, half),
            )
        )
    return sheets


def block(feature: Feature, height: float, material: str) -> Mesh:
    """The closed block over an area, its holes left open."""
    shapely = extra("shapely", "plans")
    area = shapely.Polygon(feature.points, feature.holes)
    if not area.is_valid:
        area = shapely.make_valid(area)
    vertices: list[tuple] = []
    faces: list[tuple[int, int, int]] = []

    def corner(point, z: float) -> int:
        vertices.append((float(point[0]), float(point[1]), z))
        return len(vertices) - 1

    parts = [p for p in getattr(area, "geoms", [area]) if p.geom_type == "Polygon"]
    for part in map(shapely.geometry.polygon.orient, parts):
        for triangle in shapely.constrained_delaunay_triangles(part).geoms:
            a, b, c = shapely.geometry.polygon.orient(triangle).exterior.coords[:3]
            faces.append((corner(a, height), corner(b, height), corner(c, height)))
            faces.append((corner(c, 0.0), corner(b, 0.0), corner(a, 0.0)))
        for ring in (part.exterior, *part.interiors):
            for p, q in zip(ring.coords[:-1], ring.coords[1:], strict=True):
                i, j, k, m = corner(p, 0.0), corner(q, 0.0), corner(q, height), corner(p, height)
                faces += [(i, j, k), (i, k, m)]
    if not faces:
        raise ConfigError(f"{feature.name!r} has no area; draw it as a line, or with corners that are apart")
    return Mesh(feature.name, material, np.array(vertices), np.array(faces))


def extra(module: str, name: str):
    """A module of an extra of the package.

    Raises
    ------
    ConfigError
        If it is not installed; says what to install.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ConfigError(f"this needs {module}: pip install 'dopslam[{name}]'") from error
