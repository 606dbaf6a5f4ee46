"""Shared by the tracing tests: an oracle, the ring road, a tracer for it.

The oracle finds every specular path that must exist by enumeration: image method plus exact occlusion tests,
no rays.
"""

from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest

from dopslam.raytracing.images import reflected_paths

SCENES = Path(__file__).parents[2] / "scenes"


def _crossings(start, end, triangles):
    """(N, T) fraction along the segments start → end (N, 3) at which they cross triangles (T, 3, 3); NaN if
    they do not.
    """
    direction = end - start
    origin, e1, e2 = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    p = np.cross(direction[:, None], e2[None])
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / np.sum(e1[None] * p, axis=-1)
        s = start[:, None] - origin[None]
        u = np.sum(s * p, axis=-1) * inverse
        q = np.cross(s, np.broadcast_to(e1[None], s.shape))
        v = np.sum(direction[:, None] * q, axis=-1) * inverse
        t = np.sum(e2[None] * q, axis=-1) * inverse
    hit = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & np.isfinite(inverse)
    return np.where(hit, t, np.nan)


def _clear(start, end, triangles):
    length = np.linalg.norm(end - start, axis=1)[:, None]
    t = _crossings(start, end, triangles)
    margin = 1e-4 / np.maximum(length, 1e-9)
    return ~np.any((t > margin) & (t < 1 - margin), axis=1)


def _margin_in_plane(points, triangles):
    """(N,) smallest barycentric coordinate of points in the best of the coplanar triangles (negative:
    outside).
    """
    best = np.full(len(points), -np.inf)
    for a, b, c in triangles:
        normal = np.cross(b - a, c - a)
        square = normal @ normal
        w = np.stack([
            np.cross(points - b, c - b) @ -normal / square,
            np.cross(points - c, a - c) @ -normal / square,
            np.cross(points - a, b - a) @ -normal / square,
        ])  # fmt: skip
        best = np.maximum(best, w.min(axis=0))
    return best


def _expected_paths(surfaces, bs, receivers, max_depth):
    """Set of (receiver, plane sequence) that exist."""
    bs, receivers = np.asarray(bs, dtype=float), np.asarray(receivers, dtype=float)
    found = set()
    planes = range(len(surfaces.plane_offset))
    for depth in range(max_depth + 1):
        for sequence in product(planes, repeat=depth):
            if any(a == b for a, b in pairwise(sequence)):
                continue
            index = np.array(sequence, dtype=int)
            geometry = reflected_paths(bs, receivers, surfaces.plane_normal[index], surfaces.plane_offset[index])
            corners = np.concatenate([
                np.broadcast_to(bs, (len(receivers), 1, 3)), geometry.vertices, receivers[:, None]
            ], axis=1)  # fmt: skip
            valid = np.all(np.isfinite(corners), axis=(1, 2))
            corners = np.where(valid[:, None, None], corners, 0.0)
            for i, plane in enumerate(sequence):
                normal, offset = surfaces.plane_normal[plane], surfaces.plane_offset[plane]
                sides = (corners[:, [i, i + 2]] @ normal) - offset
                valid &= sides[:, 0] * sides[:, 1] > 0
                valid &= _margin_in_plane(corners[:, i + 1], surfaces.triangles[surfaces.triangle_plane == plane]) >= 0
            rows = np.flatnonzero(valid)
            for i in range(depth + 1):
                if len(rows):
                    rows = rows[_clear(corners[rows, i], corners[rows, i + 1], surfaces.triangles)]
            found |= {(int(row), sequence) for row in rows}
    return found


@pytest.fixture(scope="session")
def expected_paths():
    return _expected_paths


@pytest.fixture(scope="session")
def ring_xml():
    return SCENES / "ring_road" / "scene.xml"


@pytest.fixture(scope="session")
def ring_track():
    """Positions (40, 3) m and velocities (40, 3) m/s of paper A's nominal circle, Section V."""
    speed, rate, period = 22.22, np.pi / 10, 0.5
    angle = rate * period * np.arange(1, 41)
    radius = speed / rate
    position = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(40)])
    return position, speed * np.column_stack([-np.sin(angle), np.cos(angle), np.zeros(40)])
