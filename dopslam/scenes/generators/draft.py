"""What a generated scene is made of: boxes and sheets with materials, and the scenario keys that go with them.

World frame right-handed, z up, meters. A box stands upright and is turned about z only; a sheet is a rectangle with an
arbitrary normal, reflecting on both sides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Box:
    """A closed block standing on z = ``bottom``.

    Attributes
    ----------
    name, material : str; the material an ITU type
    center : (2,) m; half : (2,) m, half its length and width; yaw : rad
    bottom, height : m
    """

    name: str
    material: str
    center: tuple[float, float]
    half: tuple[float, float]
    yaw: float
    height: float
    bottom: float = 0.0

    @property
    def matrix(self) -> np.ndarray:
        """(4, 4) from the cube [−1, 1]³ to the world."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        (a, b), (x, y), h = self.half, self.center, 0.5 * self.height
        return np.array([[a * c, -b * s, 0, x], [a * s, b * c, 0, y], [0, 0, h, self.bottom + h], [0, 0, 0, 1.0]])

    def clearance(self, points: np.ndarray) -> np.ndarray:
        """Horizontal distance (N,) [m] of points (N, 2) to the footprint, negative inside."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        away = (np.asarray(points, float) - self.center) @ np.array([[c, -s], [s, c]])
        over = np.abs(away) - self.half
        return np.hypot(*np.maximum(over, 0).T) + np.minimum(over.max(axis=1), 0)


@dataclass(frozen=True)
class Sheet:
    """A rectangle, its middle at ``center`` (3,) m, spanned by the half edges ``u`` and ``v`` (3,) m."""

    name: str
    material: str
    center: tuple[float, float, float]
    u: tuple[float, float, float]
    v: tuple[float, float, float]

    @property
    def matrix(self) -> np.ndarray:
        """(4, 4) from the square [−1, 1]² in the x–y plane to the world."""
        u, v = np.array(self.u), np.array(self.v)
        normal = np.cross(u, v)
        matrix = np.eye(4)
        matrix[:3] = np.column_stack([u, v, normal / np.linalg.norm(normal), self.center])
        return matrix


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of any form: ``vertices`` (V, 3) m, ``faces`` (F, 3) rows of them."""

    name: str
    material: str
    vertices: np.ndarray
    faces: np.ndarray


@dataclass(frozen=True)
class Generated:
    """A scene and how it is used.

    Attributes
    ----------
    shapes : boxes, sheets and meshes
    keys : scenario keys as nested dictionaries (``base_station``, ``receiver``, ``radio``, ``track``, ``trace`` …)
    """

    shapes: tuple[Box | Sheet | Mesh, ...]
    keys: dict


def free(points: np.ndarray, boxes, clearance: float) -> bool:
    """Whether all points (N, 2) keep this horizontal distance [m] from every box."""
    points = np.atleast_2d(points)
    return all(box.clearance(points).min() >= clearance for box in boxes)


def walls(x: tuple[float, float], y: tuple[float, float], height: float, materials: dict[str, str]) -> list[Sheet]:
    """Walls, floor and ceiling of a rectangular room; ``materials`` of wall, floor, ceiling."""
    (x0, x1), (y0, y1), h = x, y, 0.5 * height
    middle, half = (0.5 * (x0 + x1), 0.5 * (y0 + y1)), (0.5 * (x1 - x0), 0.5 * (y1 - y0))
    wall = materials["wall"]
    return [
        Sheet("wall_east", wall, (x1, middle[1], h), (0, half[1], 0), (0, 0, h)),
        Sheet("wall_north", wall, (middle[0], y1, h), (half[0], 0, 0), (0, 0, h)),
        Sheet("wall_west", wall, (x0, middle[1], h), (0, half[1], 0), (0, 0, h)),
        Sheet("wall_south", wall, (middle[0], y0, h), (half[0], 0, 0), (0, 0, h)),
        Sheet("floor", materials["floor"], (*middle, 0.0), (half[0], 0, 0), (0, half[1], 0)),
        Sheet("ceiling", materials["ceiling"], (*middle, height), (half[0], 0, 0), (0, half[1], 0)),
    ]
