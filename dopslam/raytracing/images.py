"""Propagation paths by the image method, in float64: planes, mirror images, path lengths, directions,
Doppler.

Planes are pairs ``normal`` (unit, 3) and ``offset`` [m] with ``normal · x = offset``. A path that is
reflected at a sequence of planes has the length and the arrival direction of the straight line from the
*virtual anchor*, the source mirrored at the planes one after the other (paper A, Section II). Everything
broadcasts over paths. World frame right-handed, z up; SI units.

The closed forms for a single wall and for a scatter point are eqs. (4) to (12) of paper A; the Doppler is
d = vᵀq with q from the receiver to the last interaction, positive when approaching.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dopslam.models.paths import mirror
from dopslam.records import SPEED_OF_LIGHT


@dataclass(frozen=True)
class PathGeometry:
    """Geometry of N propagation paths with D interactions each.

    Attributes
    ----------
    length : (N,) m
    departure : (N, 3) unit vectors at the source, towards the first interaction (or the receiver)
    arrival : (N, 3) unit vectors q at the receiver, towards the last interaction (or the source)
    vertices : (N, D, 3) m, interaction points from the source to the receiver
    """

    length: np.ndarray
    departure: np.ndarray
    arrival: np.ndarray
    vertices: np.ndarray

    @property
    def delay(self) -> np.ndarray:
        """(N,) s, geometric."""
        return self.length / SPEED_OF_LIGHT

    def radial_velocity(self, velocity: np.ndarray) -> np.ndarray:
        """(N,) m/s, vᵀq of receivers that move with ``velocity`` (N, 3); the source and the scene stand
        still.
        """
        return np.sum(np.asarray(velocity, dtype=float) * self.arrival, axis=-1)


def mirror_images(source: np.ndarray, normals: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Mirror the source at a sequence of planes.

    Parameters
    ----------
    source : (3,) or (…, 3) m
    normals : (…, D, 3), offsets : (…, D) m; the planes in the order in which the path meets them

    Returns
    -------
    (…, D + 1, 3) m: the source, then its image after 1, 2 … D reflections; the last one is the virtual
    anchor.
    """
    normals, offsets = np.asarray(normals, dtype=float), np.asarray(offsets, dtype=float)
    depth = offsets.shape[-1]
    images = [np.broadcast_to(np.asarray(source, dtype=float), (*offsets.shape[:-1], 3))]
    for i in range(depth):
        images.append(mirror(images[-1], normals[..., i, :], offsets[..., i]))
    return np.stack(images, axis=-2)


def isometry(normals: np.ndarray, offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Composite map x → Mx + t of successive reflections at planes ``normals`` (D, 3), ``offsets`` (D,) [m].

    Two sequences with the same map are the same virtual anchor for every source and every receiver, for
    instance both orders at a right-angled corner.
    """
    matrix, translation = np.eye(3), np.zeros(3)
    for normal, offset in zip(np.asarray(normals, dtype=float), np.asarray(offsets, dtype=float), strict=True):
        matrix, translation = mirror(matrix.T, normal).T, mirror(translation, normal, offset)
    return matrix, translation


def _unit(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    length = np.linalg.norm(vectors, axis=-1)
    return vectors / length[..., None], length


def reflected_paths(
    source: np.ndarray, receivers: np.ndarray, normals: np.ndarray, offsets: np.ndarray
) -> PathGeometry:
    """Specular paths from one source to N receivers over given planes (D = 0: line of sight).

    The incidence points follow from the receiver backwards: the straight line from the current point to the
    image of order i cuts plane i. Whether the points lie on the walls and are visible is not asked here.

    Parameters
    ----------
    source : (3,) m
    receivers : (N, 3) m
    normals : (N, D, 3) or (D, 3), offsets : (N, D) or (D,) m, in the order in which the path meets the planes

    Returns
    -------
    PathGeometry; incidence points are non-finite if a segment runs parallel to its plane.
    """
    source, receivers = np.asarray(source, dtype=float), np.asarray(receivers, dtype=float)
    count = len(receivers)
    offsets = np.asarray(offsets, dtype=float)
    depth = offsets.shape[-1]
    offsets = np.broadcast_to(offsets, (count, depth))
    normals = np.broadcast_to(np.asarray(normals, dtype=float), (count, depth, 3))
    images = mirror_images(source, normals, offsets)
    arrival, length = _unit(images[:, -1] - receivers)
    vertices = np.empty((count, depth, 3))
    point = receivers
    for i in reversed(range(depth)):
        line = images[:, i + 1] - point
        with np.errstate(divide="ignore", invalid="ignore"):
            fraction = (offsets[:, i] - np.sum(normals[:, i] * point, axis=-1)) / np.sum(normals[:, i] * line, axis=-1)
            point = point + fraction[:, None] * line
        vertices[:, i] = point
    # The departure direction is the arrival line unfolded the other way, by the reflections in reverse order;
    # this keeps full precision where the source stands close to a wall.
    departure = -arrival
    for i in reversed(range(depth)):
        departure = mirror(departure, normals[:, i])
    return PathGeometry(length, departure, arrival, vertices)


def scattered_paths(source: np.ndarray, receivers: np.ndarray, points: np.ndarray) -> PathGeometry:
    """Paths from one source (3,) over scatter points (N, 3) or (3,) to receivers (N, 3) [m] (paper A, eqs. 5,
    8, 11).
    """
    receivers = np.asarray(receivers, dtype=float)
    points = np.broadcast_to(np.asarray(points, dtype=float), receivers.shape)
    departure, first = _unit(points - np.asarray(source, dtype=float))
    arrival, second = _unit(points - receivers)
    return PathGeometry(first + second, departure, arrival, points[:, None, :].copy())


def zenith_azimuth(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Zenith θ and azimuth φ [rad] of directions (…, 3), Sionna's names.

    θ comes from atan2, exact near the poles; φ is 0 at the poles.
    """
    directions = np.asarray(directions, dtype=float)
    horizontal = np.hypot(directions[..., 0], directions[..., 1])
    return np.arctan2(horizontal, directions[..., 2]), np.arctan2(directions[..., 1], directions[..., 0])


def triangle_planes(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit normals (T, 3), offsets (T,) [m] and areas (T,) [m²] of triangles (T, 3, 3) [m].

    Degenerate triangles have area 0 and the normal (0, 0, 0).
    """
    triangles = np.asarray(triangles, dtype=float)
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    twice = np.linalg.norm(cross, axis=1)
    normals = np.divide(cross, twice[:, None], out=np.zeros_like(cross), where=twice[:, None] > 0)
    return normals, np.sum(normals * triangles.mean(axis=1), axis=1), 0.5 * twice


def distance_to_triangles(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Distance (N, T) [m] from points (N, 3) to triangles (T, 3, 3)."""
    points, triangles = np.asarray(points, dtype=float), np.asarray(triangles, dtype=float)
    normals, offsets, areas = triangle_planes(triangles)
    corners = triangles[None]  # (1, T, 3, 3)
    edges = np.roll(triangles, -1, axis=1) - triangles  # (T, 3, 3)
    relative = points[:, None, None, :] - corners  # (N, T, 3, 3)
    squared = np.maximum(np.sum(edges**2, axis=-1), np.finfo(float).tiny)
    along = np.clip(np.sum(relative * edges[None], axis=-1) / squared, 0.0, 1.0)
    to_edges = np.linalg.norm(relative - along[..., None] * edges[None], axis=-1).min(axis=-1)
    # The foot of the perpendicular lies inside if it is on the inner side of all three edges.
    inward = np.cross(normals[:, None, :], edges)  # (T, 3, 3)
    inside = np.all(np.sum(relative * inward[None], axis=-1) >= 0.0, axis=-1) & (areas > 0)[None]
    to_plane = np.abs(points @ normals.T - offsets[None])
    return np.where(inside, to_plane, to_edges)


def winding_number(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Winding number (N,) of a triangle mesh (T, 3, 3) around points (N, 3): ±1 inside a closed mesh, 0
    outside.

    Sum of signed solid angles over 4π (Van Oosterom and Strackee, 1983). Unlike ray parity it has no special
    cases at edges, and a mesh with one flat face missing still gives more than ½ exactly on the inner side of
    that face.
    """
    a, b, c = np.moveaxis(np.asarray(triangles, dtype=float)[None] - np.asarray(points)[:, None, None, :], 2, 0)
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    numerator = np.sum(a * np.cross(b, c), axis=-1)
    denominator = la * lb * lc + np.sum(a * b, axis=-1) * lc + np.sum(b * c, axis=-1) * la + np.sum(c * a, axis=-1) * lb
    return np.sum(2.0 * np.arctan2(numerator, denominator), axis=1) / (4.0 * np.pi)
