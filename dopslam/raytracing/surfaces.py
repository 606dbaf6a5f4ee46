"""The reflecting surfaces of a scene as plain arrays: triangles, the planes they lie on, readable names,
outlines.

A virtual anchor belongs to a *plane*, not to a triangle or an object: two triangles of a wall, or two flush
façades, make the same one. Faces are therefore clustered: normals closer than 2e-4 rad and offsets closer
than 5 mm (seen from the center of the scene) are one plane, so virtual anchors less than about 1 cm apart are
one. A curved mesh has a plane per triangle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, KDTree, QhullError

from dopslam.errors import SceneError
from dopslam.raytracing.images import distance_to_triangles, triangle_planes, winding_number

NORMAL_TOLERANCE = 2e-4  # rad
OFFSET_TOLERANCE = 5e-3  # m
SHARED_NAME = 0.2  # of the largest face in a plane: smaller ones do not appear in its name
CLEARANCE = 0.01  # m; closer to a surface than this, single precision rays lose paths
_COMPASS = ("east", "north_east", "north", "north_west", "west", "south_west", "south", "south_east")
_GENERIC = np.array([0.8146, 0.5312, 0.2331])  # no wall is perpendicular to it: tells n from −n


@dataclass(frozen=True)
class Surfaces:
    """Triangles of a scene and the planes they lie on.

    Attributes
    ----------
    objects : (M,) names
    triangles : (T, 3, 3) m
    triangle_object : (T,) index into ``objects``; first_triangle : (M,), a triangle's index within its object
        starts there
    triangle_plane : (T,) index into the planes, −1 for degenerate triangles
    plane_normal : (P, 3), plane_offset : (P,) m, normal · x = offset
    plane_name : (P,) e.g. ``"wall_east"``, or ``"building_1.south"`` for a face of an object with several
    """

    objects: tuple[str, ...]
    triangles: np.ndarray
    triangle_object: np.ndarray
    first_triangle: np.ndarray
    triangle_plane: np.ndarray
    plane_normal: np.ndarray
    plane_offset: np.ndarray
    plane_name: tuple[str, ...]

    @property
    def lower(self) -> np.ndarray:
        """(3,) m, lower corner of the bounding box (the origin for an empty scene)."""
        return self.triangles.min(axis=(0, 1)) if len(self.triangles) else np.zeros(3)


def build_surfaces(meshes: dict[str, np.ndarray]) -> Surfaces:
    """Surfaces of named triangle meshes, each (T, 3, 3) m."""
    objects = tuple(meshes)
    counts = np.array([len(mesh) for mesh in meshes.values()], dtype=np.intp)
    triangles = np.concatenate([np.zeros((0, 3, 3)), *(np.asarray(mesh, dtype=float) for mesh in meshes.values())])
    owner = np.repeat(np.arange(len(objects)), counts)
    normals, offsets, areas = triangle_planes(triangles)
    plane, plane_normal, plane_offset = _cluster(normals, offsets, areas, triangles)
    names = _plane_names(objects, owner, triangles, areas, plane, plane_normal)
    first = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.intp)
    return Surfaces(objects, triangles, owner, first, plane, plane_normal, plane_offset, names)


def _cluster(normals, offsets, areas, triangles):
    """Label coplanar triangles; planes are area-weighted means, numbered by their first triangle."""
    solid = np.flatnonzero(areas > 0)
    label = np.full(len(areas), -1, dtype=np.intp)
    if not len(solid):
        return label, np.zeros((0, 3)), np.zeros(0)
    center = triangles[solid].mean(axis=(0, 1))
    sign = np.where(normals[solid] @ _GENERIC < 0, -1.0, 1.0)
    normal = sign[:, None] * normals[solid]
    offset = sign * offsets[solid] - normal @ center
    feature = np.column_stack([normal / NORMAL_TOLERANCE, offset / OFFSET_TOLERANCE])
    # Equal cells first: a finely meshed wall would otherwise make a quadratic number of pairs.
    cells, cell = np.unique(np.round(feature, 1), axis=0, return_inverse=True)
    pairs = KDTree(cells).query_pairs(1.0, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(cells), len(cells)))
    component = connected_components(graph, directed=False)[1][cell.ravel()]
    _, first = np.unique(component, return_index=True)
    order = np.argsort(np.argsort(first))
    label[solid] = order[component]
    count = len(first)
    weight = np.bincount(label[solid], areas[solid], count)
    mean = np.stack([np.bincount(label[solid], areas[solid] * normal[:, i], count) for i in range(3)], axis=1)
    mean /= np.linalg.norm(mean, axis=1)[:, None]
    distance = np.sum(mean[label[solid]] * triangles[solid].mean(axis=1), axis=1)
    return label, mean, np.bincount(label[solid], areas[solid] * distance, count) / weight


def _face_name(normal: np.ndarray, outward: float) -> str:
    direction = normal if outward >= 0 else -normal
    if abs(direction[2]) > 0.9:
        return "top" if direction[2] > 0 else "bottom"
    return _COMPASS[round(np.arctan2(direction[1], direction[0]) / (np.pi / 4)) % 8]


def _plane_names(objects, owner, triangles, areas, plane, plane_normal) -> tuple[str, ...]:
    """Readable unique names: the object, or object.face, and up to two of them if objects share the plane."""
    labels: list[list[tuple[float, str]]] = [[] for _ in plane_normal]
    solid = np.flatnonzero(plane >= 0)
    pairs, face = np.unique(np.column_stack([owner[solid], plane[solid]]), axis=0, return_inverse=True)
    face = face.ravel()
    area = np.bincount(face, areas[solid], len(pairs))
    centroid = triangles[solid].mean(axis=1) * areas[solid, None]
    center = np.stack([np.bincount(face, centroid[:, i], len(pairs)) for i in range(3)], axis=1) / area[:, None]
    lower, upper = _bounds(len(objects), owner, triangles)
    outward = np.sum((center - 0.5 * (lower + upper)[pairs[:, 0]]) * plane_normal[pairs[:, 1]], axis=1)
    faces_of = np.bincount(pairs[:, 0], minlength=len(objects))
    size = np.round(area, 6)
    seen: dict[str, int] = {}
    for i in np.lexsort((pairs[:, 1], -size, pairs[:, 0])):
        index, p = pairs[i]
        label = objects[index]
        if faces_of[index] > 1:
            label = f"{label}.{_face_name(plane_normal[p], float(outward[i]))}"
            seen[label] = seen.get(label, 0) + 1
            label += f"_{seen[label]}" if seen[label] > 1 else ""
        labels[p].append((-float(size[i]), label))
    names = []
    for sharing in labels:
        # A house's bottom in the plane of the ground is not worth naming.
        large = [label for area, label in sorted(sharing) if -area >= SHARED_NAME * -min(sharing)[0]]
        names.append("+".join(large[:2]) + (f"+{len(large) - 2}" if len(large) > 2 else ""))
    return tuple(names)


def _bounds(count: int, owner: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners (M, 3) of the bounding boxes of all objects; an object without triangles has an empty one."""
    lower, upper = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(lower, owner, triangles.min(axis=1))
    np.maximum.at(upper, owner, triangles.max(axis=1))
    return lower, upper


def check_positions(surfaces: Surfaces, points: dict[str, np.ndarray], clearance: float = CLEARANCE) -> None:
    """Refuse positions inside an object or closer to a surface than ``clearance`` [m].

    Raises
    ------
    SceneError
        With everything that :func:`position_faults` finds.
    """
    faults = position_faults(surfaces, points, clearance)
    if faults:
        raise SceneError("; ".join(faults))


def position_faults(surfaces: Surfaces, points: dict[str, np.ndarray], clearance: float = CLEARANCE) -> list[str]:
    """What is wrong with positions in a scene: inside an object, outside of the one that holds most of them, too close.

    A closed object that contains every given position (a room around the whole scene) is no obstacle.

    Parameters
    ----------
    points : name → (3,) or (N, 3) m; the name is used in the sentences, with the row's number for several
        points

    Returns
    -------
    list of str
        A sentence for every object and kind of fault, by the first position concerned: which, where, the object, the
        remedy.
    """
    names = list(points)
    blocks = [np.atleast_2d(np.asarray(value, dtype=float)) for value in points.values()]
    stacked = np.concatenate(blocks)
    label = [f"{n} {i}" if len(b) > 1 else n for n, b in zip(names, blocks, strict=True) for i in range(len(b))]
    for name, point in zip(label, stacked, strict=True):
        if not np.all(np.isfinite(point)):
            return [f"{name} has the position {point.tolist()}; give finite numbers in meters"]
    lower, upper = _bounds(len(surfaces.objects), surfaces.triangle_object, surfaces.triangles)
    wrong: list[tuple[int, str]] = []

    def add(mask: np.ndarray, what: str) -> None:
        row, others = int(np.argmax(mask)), int(mask.sum()) - 1
        and_others = f" (and {others} other position{'s' if others > 1 else ''})" if others else ""
        wrong.append((row, f"{label[row]} at {_text(stacked[row])} m{and_others} {what}"))

    for index, owner in enumerate(surfaces.objects):
        near = np.all((stacked >= lower[index] - clearance) & (stacked <= upper[index] + clearance), axis=1)
        rows = np.flatnonzero(near)
        if not len(rows):
            continue
        mesh = surfaces.triangles[surfaces.triangle_object == index]
        close, inside = np.zeros((2, len(stacked)), dtype=bool)
        for chunk in np.array_split(rows, max(1, len(rows) * len(mesh) // 200_000)):
            close[chunk] = distance_to_triangles(stacked[chunk], mesh).min(axis=1, initial=np.inf) < clearance
            inside[chunk] = np.abs(winding_number(stacked[chunk], mesh)) > 0.5
        if np.any(close):
            add(close, f"is closer than {100 * clearance:g} cm to a surface of object {owner!r}; move it away")
        inside &= ~close
        outside = ~inside & ~close
        if np.any(inside) and np.any(outside):
            if inside.sum() > outside.sum():
                add(
                    outside,
                    f"lies outside of object {owner!r}, the others inside object {owner!r}; keep all on one side",
                )
            else:
                add(inside, f"lies inside object {owner!r}; move it out")
    return [what for _, what in sorted(wrong)]


def solids(surfaces: Surfaces) -> Callable[[np.ndarray], np.ndarray]:
    """Tells which of points (N, 3) m lie inside of a closed object; one that reaches around the whole scene is none."""
    lower, upper = _bounds(len(surfaces.objects), surfaces.triangle_object, surfaces.triangles)
    if len(surfaces.objects):
        widest = upper[:, :2].max(axis=0) - lower[:, :2].min(axis=0)
        around = np.all(upper[:, :2] - lower[:, :2] > 0.9 * widest, axis=1)
        lower[around] = np.inf
    edges = np.searchsorted(surfaces.triangle_object, np.arange(len(surfaces.objects) + 1))

    def inside(points: np.ndarray) -> np.ndarray:
        points = np.asarray(points, dtype=float)
        found = np.zeros(len(points), dtype=bool)
        low, high = points.min(axis=0), points.max(axis=0)
        for index in np.flatnonzero(np.all((lower <= high) & (upper >= low), axis=1)):
            rows = np.flatnonzero(np.all((points >= lower[index]) & (points <= upper[index]), axis=1))
            if len(rows):
                mesh = surfaces.triangles[edges[index] : edges[index + 1]]
                found[rows] |= np.abs(winding_number(points[rows], mesh)) > 0.5
        return found

    return inside


def _text(point: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.3f}" for value in point) + ")"


def floor_plan(surfaces: Surfaces, height: float) -> list[tuple[str, np.ndarray]]:
    """Outlines of the objects for a plan view.

    An object that crosses the height [m] gives its horizontal section there (one polyline per connected
    piece), any other its convex footprint; flat horizontal ones (floors) give nothing.

    Returns
    -------
    list of (object name, (n, 2) polyline in m; closed if the last point equals the first)
    """
    outlines = []
    for index, name in enumerate(surfaces.objects):
        mesh = surfaces.triangles[surfaces.triangle_object == index]
        if not len(mesh) or np.ptp(mesh[..., 2]) < 1e-3:
            continue
        section = _section(mesh, height)
        if section:
            outlines += [(name, line) for line in section]
            continue
        corners = mesh[..., :2].reshape(-1, 2)
        try:
            hull = corners[ConvexHull(corners).vertices]
            outlines.append((name, np.concatenate([hull, hull[:1]])))
        except QhullError:  # an upright plane seen from above is a line
            spread = np.linalg.svd(corners - corners.mean(0), full_matrices=False)[2][0]
            along = (corners - corners.mean(0)) @ spread
            outlines.append((name, corners[[np.argmin(along), np.argmax(along)]]))
    return outlines


def _section(mesh: np.ndarray, height: float) -> list[np.ndarray]:
    """Polylines (n, 2) of the horizontal section of a mesh (T, 3, 3), collinear points left out."""
    above = mesh[..., 2] > height
    cut = mesh[np.any(above, axis=1) & ~np.all(above, axis=1)]
    neighbors: dict[tuple[float, float], set[tuple[float, float]]] = {}
    for triangle in cut:
        ends = []
        for p, q in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
            if (p[2] > height) != (q[2] > height):
                x = p[:2] + (height - p[2]) / (q[2] - p[2]) * (q[:2] - p[:2])
                ends.append((round(float(x[0]), 4), round(float(x[1]), 4)))
        if ends[0] != ends[1]:
            neighbors.setdefault(ends[0], set()).add(ends[1])
            neighbors.setdefault(ends[1], set()).add(ends[0])
    lines = []
    while neighbors:
        start = min(neighbors, key=lambda point: (len(neighbors[point]) == 2, point))  # begin at a loose end if any
        line = [start]
        while neighbors.get(line[-1]):
            here = line[-1]
            step = min(neighbors[here])
            neighbors[here].discard(step)
            neighbors[step].discard(here)
            line.append(step)
        for point in line:
            if point in neighbors and not neighbors[point]:
                del neighbors[point]
        lines.append(_simplify(np.array(line)))
    return [line for line in lines if len(line) > 1]


def _simplify(line: np.ndarray) -> np.ndarray:
    """Drop the inner points that lie on the straight line between their neighbors (to 1 mm)."""
    if len(line) < 3:
        return line
    before, after = line[1:-1] - line[:-2], line[2:] - line[1:-1]
    bend = np.abs(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0])
    keep = bend > 1e-3 * np.maximum(np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1))
    return line[np.concatenate([[True], keep, [True]])]
