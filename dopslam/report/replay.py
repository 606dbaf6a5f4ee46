"""What the three-dimensional replay of a run shows, as one JSON-able tree.

Lengths in meters, world frame, z up; rounded to a millimeter, which is less than a pixel. A map row is
``[x, y, z, kind, existence, ix, iy, iz, l11, l21, l22, l31, l32, l33]``: landmark, interaction point of its path, and the
Cholesky factor of its covariance. A wall is ``[corners, shift, name]``: four points, the vector along its normal to the edge
of the band that holds 95 % of its distance, and the name of the true wall that it is: empty where it is none, its number where no true walls are known.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping

import numpy as np

from dopslam.evaluate.walls import Walls, plane_of, wall_names, walls
from dopslam.models.paths import incidence
from dopslam.records import FloorPlan, Kind, Landmarks, Paths, Track
from dopslam.slam.history import History

LIT_TOLERANCE = 0.02  # m, of a façade's plane from the plane of its virtual anchor
LARGEST_MESH = 200_000  # triangles; a larger scene is shown by its outlines


def replay(
    track: Track | None,
    landmarks: Landmarks,
    paths: Paths | None,
    plan: FloorPlan | None,
    histories: Mapping[str, History],
    triangles: np.ndarray | None = None,
    height: float = 0.0,
    threshold: float = 0.5,
    radius: float = 3.0,
    time: np.ndarray | None = None,
) -> dict:
    """The tree that ``replay.js`` draws.

    Parameters
    ----------
    track, landmarks, paths, plan : the truth; all but the landmarks, which hold the base station, may be None
    histories : filter name → history
    triangles : (T, 3, 3) m, the scene; None where it is not at hand
    height : m, of the receiver
    threshold : least existence of a landmark that is shown
    radius : m, within which a wall that was found has the name of the true one
    time : (K,) s, where there is no true track to tell it
    """
    base_station = landmarks.position[landmarks.kind == Kind.BS][0]
    moments = time if track is None else track.time
    note = ""
    if triangles is not None and len(triangles) > LARGEST_MESH:
        note = f"The scene has {len(triangles):,} triangles, too many for a page: its outlines are shown."
        triangles = None
    return {
        "note": note,
        "bs": _round(base_station),
        "time": [] if moments is None else _round(moments),
        "truth": None if track is None else {"position": _round(track.position), "heading": _round(track.heading, 4)},
        "landmarks": [
            {"name": str(name), "kind": int(kind), "order": int(o), "position": _round(position)}
            for name, kind, o, position in zip(
                landmarks.name, landmarks.kind, landmarks.order, landmarks.position, strict=True
            )
        ],
        "rays": []
        if paths is None or track is None
        else [_rays(base_station, track, paths, k) for k in range(paths.steps)],
        "mesh": None if triangles is None else _packed(triangles),
        "lit": {} if triangles is None else _lit(triangles, landmarks, base_station),
        "outlines": [] if plan is None else _outlines(plan),
        "filters": {
            name: _filter(history, landmarks, height, threshold, radius) for name, history in histories.items()
        },
    }


def _round(values: np.ndarray, digits: int = 3) -> list:
    return np.round(np.asarray(values, float), digits).tolist()


def _rays(base_station: np.ndarray, track: Track, paths: Paths, step: int) -> list:
    rows = paths.rows(step)
    return [
        [
            int(paths.landmark[n]),
            _round(
                np.vstack([
                    base_station,
                    paths.vertices[paths.vertex_offsets[n] : paths.vertex_offsets[n + 1]],
                    track.position[step],
                ])
            ),
        ]
        for n in range(rows.start, rows.stop)
    ]  # fmt: skip


def _packed(triangles: np.ndarray) -> str:
    """Corners as base64 of little-endian float32, nine numbers a triangle."""
    return base64.b64encode(np.ascontiguousarray(triangles, dtype="<f4").tobytes()).decode("ascii")


def _lit(triangles: np.ndarray, landmarks: Landmarks, base_station: np.ndarray) -> dict[str, list[int]]:
    """Landmark → triangles on the plane that mirrors the base station to it (first reflections only)."""
    lit = {}
    for index in np.flatnonzero((landmarks.kind == Kind.VA) & (landmarks.order == 1)):
        normal, offset = plane_of(base_station, landmarks.position[index])
        near = np.all(np.abs(triangles @ normal - offset) < LIT_TOLERANCE, axis=1)
        if np.any(near):
            lit[str(index)] = np.flatnonzero(near).tolist()
    return lit


def _outlines(plan: FloorPlan) -> list:
    return [_round(plan.points[plan.offsets[w] : plan.offsets[w + 1]]) for w in range(len(plan.name))]


def _filter(history: History, landmarks: Landmarks, height: float, threshold: float, radius: float) -> dict:
    base_station = landmarks.position[landmarks.kind == Kind.BS][0]
    receiver = np.column_stack([history.mean[:, :2], np.full(history.steps, height)])
    return {
        "position": _round(receiver),
        "heading": _round(history.mean[:, 2], 4),
        "factor": _round(np.array([_factor(c[:2, :2])[np.tril_indices(2)] for c in history.covariance]), 4),
        "map": [_map(history, k, receiver[k], base_station, threshold) for k in range(history.steps)],
        "walls": [
            _walls(walls(history, base_station, height, k, threshold), landmarks, radius) for k in range(history.steps)
        ],
    }


def _walls(found: Walls, landmarks: Landmarks, radius: float) -> list:
    shift = 1.96 * found.deviation[:, None] * found.normal
    known = np.any((landmarks.kind == Kind.VA) & (landmarks.order == 1))
    names = wall_names(found, landmarks, radius) if known else [f"wall {track}" for track in found.track]
    return [[_round(c), _round(s, 4), name or ""] for c, s, name in zip(found.corners, shift, names, strict=True)]


def _factor(covariance: np.ndarray) -> np.ndarray:
    """Lower Cholesky factor; of what is positive in a covariance that is not quite."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(np.linalg.qr(root.T, mode="r")).T


def _map(history: History, step: int, receiver: np.ndarray, base_station: np.ndarray, threshold: float) -> list:
    rows = history.rows(step)
    lines = []
    for row in range(rows.start, rows.stop):
        if history.existence[row] <= threshold:
            continue
        position, kind = history.position[row], int(history.kind[row])
        point = position if kind == Kind.SP else incidence(receiver, position, base_station)[0]
        factor = _factor(history.position_covariance[row])[np.tril_indices(3)]
        lines.append([
            *_round(position), kind, round(float(history.existence[row]), 3), *_round(point), *_round(factor, 4),
        ])  # fmt: skip
    return lines
