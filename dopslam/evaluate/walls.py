"""The walls behind a map's virtual anchors: what a person calls the map.

A virtual anchor is the base station mirrored at a plane. The plane halves the segment between the two: its unit normal
n points from the base station b to the virtual anchor x, and n · p = n · b + ‖x − b‖/2 on it. Where on the plane a wall
was seen follows from the incidence points of the estimated track. World frame, meters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from dopslam.models.paths import incidence
from dopslam.records import Kind, Landmarks, Track
from dopslam.slam.history import History

SMALLEST_EXTENT = 1.0  # m, a wall seen in one point only is drawn this wide
LARGEST_TURN = np.deg2rad(10.0)  # of a wall from the true one that it is taken for
LEAST_REACH = 5.0  # m, that an angle counts over when walls are paired: a wall seen in one point says less by its place
LEAST_WAY = 1e-3  # m; a virtual anchor in the base station has no plane


@dataclass(frozen=True)
class Walls:
    """Planes of the virtual anchors in a map.

    Attributes
    ----------
    track : (W,) int, the map's track numbers
    normal : (W, 3) unit vectors from the base station outwards; offset : (W,) m, normal · p = offset
    covariance : (W, 4, 4) of [normal, offset]
    corners : (W, 4, 3) m, rectangle in the plane around the incidence points, its extent
    existence : (W,)
    """

    track: np.ndarray
    normal: np.ndarray
    offset: np.ndarray
    covariance: np.ndarray
    corners: np.ndarray
    existence: np.ndarray

    def __len__(self) -> int:
        return len(self.track)

    @property
    def center(self) -> np.ndarray:
        """(W, 3) m, middle of the rectangle that was seen."""
        return self.corners.mean(axis=1)

    @property
    def deviation(self) -> np.ndarray:
        """(W,) m, standard deviation of the distance between the plane and the middle of what was seen."""
        row = np.column_stack([self.center, -np.ones(len(self))])
        return np.sqrt(np.maximum(np.einsum("wi,wij,wj->w", row, self.covariance, row), 0.0))


def plane_of(base_station: np.ndarray, anchor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normals (..., 3) and offsets (...,) [m] of the planes that mirror the base station (3,) to anchors (..., 3)."""
    way = anchor - base_station
    length = np.linalg.norm(way, axis=-1)
    normal = way / length[..., None]
    return normal, normal @ base_station + 0.5 * length


def plane_jacobian(base_station: np.ndarray, anchor: np.ndarray) -> np.ndarray:
    """(..., 4, 3) derivative of [normal, offset] of :func:`plane_of` with respect to the anchor."""
    way = anchor - base_station
    length = np.linalg.norm(way, axis=-1)[..., None, None]
    normal = way / length[..., 0]
    turned = (np.eye(3) - normal[..., :, None] * normal[..., None, :]) / length
    shifted = np.einsum("i,...ij->...j", base_station, turned) + 0.5 * normal
    return np.concatenate([turned, shifted[..., None, :]], axis=-2)


def walls(history: History, base_station: np.ndarray, height: float, step: int = -1, threshold: float = 0.5) -> Walls:
    """Walls of the map after one step, drawn over where they were seen until then.

    Parameters
    ----------
    history : of a filter
    base_station : (3,) m
    height : m, of the receiver
    step : whose map is taken; negative counts from the end
    threshold : least existence of a wall
    """
    base_station = np.asarray(base_station, float)
    step %= history.steps
    rows = history.rows(step)
    chosen = (history.kind[rows] == Kind.VA) & (history.existence[rows] > threshold)
    chosen &= np.linalg.norm(history.position[rows] - base_station, axis=-1) > LEAST_WAY
    anchor, spread = history.position[rows][chosen], history.position_covariance[rows][chosen]
    track = history.track[rows][chosen]
    normal, offset = plane_of(base_station, anchor)
    jacobian = plane_jacobian(base_station, anchor)
    receiver = np.column_stack([history.mean[: step + 1, :2], np.full(step + 1, height)])
    seen = [receiver[_mapped(history, number, step, threshold)] for number in track]
    corners = [
        _rectangle(n, d, _incidences(p, x, base_station))
        for n, d, p, x in zip(normal, offset, seen, anchor, strict=True)
    ]
    return Walls(
        track=track,
        normal=normal,
        offset=offset,
        covariance=jacobian @ spread @ jacobian.swapaxes(-1, -2),
        corners=np.array(corners).reshape(-1, 4, 3),
        existence=history.existence[rows][chosen],
    )


def true_walls(track: Track, landmarks: Landmarks) -> Walls:
    """The walls that the true first reflections stand for, over where the true track would see them; nothing uncertain."""
    bs = landmarks.position[landmarks.kind == Kind.BS][0]
    index = np.flatnonzero((landmarks.kind == Kind.VA) & (landmarks.order == 1))
    anchor = landmarks.position[index]
    normal, offset = plane_of(bs, anchor)
    corners = [
        _rectangle(n, d, _incidences(track.position, x, bs)) for n, d, x in zip(normal, offset, anchor, strict=True)
    ]
    count = len(index)
    return Walls(
        index, normal, offset, np.zeros((count, 4, 4)), np.array(corners).reshape(-1, 4, 3), np.ones(count)
    )  # fmt: skip


def _mapped(history: History, track: int, last: int, threshold: float) -> np.ndarray:
    """(last + 1,) bool, steps whose map held a track."""
    step = np.repeat(np.arange(history.steps), np.diff(history.map_offsets))
    held = step[(history.track == track) & (history.existence > threshold)]
    return np.isin(np.arange(last + 1), held)


def _incidences(receiver: np.ndarray, anchor: np.ndarray, base_station: np.ndarray) -> np.ndarray:
    point, fraction = incidence(receiver, np.broadcast_to(anchor, receiver.shape), base_station)
    return point[(fraction > 0) & (fraction < 1)]


def _rectangle(normal: np.ndarray, offset: float, points: np.ndarray) -> np.ndarray:
    """(4, 3) corners in the plane around points on it; upright walls get horizontal and vertical edges."""
    flat = np.hypot(normal[0], normal[1])
    along = np.array([-normal[1], normal[0], 0.0]) / flat if flat > 1e-3 else np.array([1.0, 0.0, 0.0])
    up = np.cross(normal, along)
    foot = normal * offset
    plane = (points - foot) @ np.column_stack([along, up]) if len(points) else np.zeros((1, 2))
    low, high = plane.min(axis=0), plane.max(axis=0)
    grow = np.maximum(0.5 * (SMALLEST_EXTENT - (high - low)), 0.0)
    low, high = low - grow, high + grow
    ring = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    return foot + ring[:, :1] * along + ring[:, 1:] * up


def wall_errors(
    found: Walls, landmarks: Landmarks, base_station: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How far walls lie from true ones: one to one, nearest by distance and angle over what was seen.

    Returns
    -------
    landmark : (W,) int, index of the true virtual anchor (one reflection), −1 without a partner
    distance : (W,) m, of the true plane from the middle of the wall that was seen; inf without a partner
    angle : (W,) rad, between the planes; inf without a partner
    """
    true = np.flatnonzero((landmarks.kind == Kind.VA) & (landmarks.order == 1))
    partner = np.full(len(found), -1)
    distance, angle = np.full(len(found), np.inf), np.full(len(found), np.inf)
    if not len(true) or not len(found):
        return partner, distance, angle
    normal, offset = plane_of(np.asarray(base_station, float), landmarks.position[true])
    gap = np.abs(found.center @ normal.T - offset)
    turn = np.arccos(np.clip(found.normal @ normal.T, -1.0, 1.0))
    reach = 0.5 * np.linalg.norm(found.corners[:, 2] - found.corners[:, 0], axis=-1)[:, None]
    for i, j in zip(*linear_sum_assignment(gap + np.maximum(reach, LEAST_REACH) * turn), strict=True):
        partner[i], distance[i], angle[i] = true[j], gap[i, j], turn[i, j]
    return partner, distance, angle


def _recognized(found: Walls, landmarks: Landmarks, radius: float):
    """Partners, distances and angles of :func:`wall_errors`, and which walls lie within ``radius`` [m] and 10° of theirs."""
    partner, distance, angle = wall_errors(found, landmarks, landmarks.position[landmarks.kind == Kind.BS][0])
    return partner, distance, angle, (distance <= radius) & (angle <= LARGEST_TURN)


def wall_names(found: Walls, landmarks: Landmarks, radius: float) -> list[str | None]:
    """Names of the true walls that the found ones are, within ``radius`` [m] and 10° of them; None for those of no wall."""
    partner, _, _, near = _recognized(found, landmarks, radius)
    return [str(landmarks.name[p]).removeprefix("VA ") if n else None for p, n in zip(partner, near, strict=True)]


def wall_list(found: Walls, landmarks: Landmarks, radius: float) -> list[dict]:
    """Wall by wall, the widest seen first, what was found: its ``name`` (:func:`wall_names`), the ``width_m`` that was seen of
    it, how far off it lies (``distance_m``, ``angle_deg``) and what the filter thinks of that (``std_m``).
    """
    names = wall_names(found, landmarks, radius)
    _, distance, angle, _ = _recognized(found, landmarks, radius)
    width = np.linalg.norm(found.corners[:, 1] - found.corners[:, 0], axis=-1)
    listed = []
    for i in np.argsort(-width, kind="stable").tolist():
        off = {"distance_m": float(distance[i]), "angle_deg": float(np.degrees(angle[i]))} if names[i] else {}
        listed.append({"name": names[i], "width_m": float(width[i]), "std_m": float(found.deviation[i]), **off})
    return listed


def wall_figures(found: Walls, landmarks: Landmarks, radius: float) -> dict:
    """The figures of ``summary.json``: walls within ``radius`` [m] and 10° of a true one, and how far off those are.

    ``wall_distance_m`` and ``wall_angle_deg`` are root mean squares over the walls found; None where there are none.
    """
    _, distance, angle, near = _recognized(found, landmarks, radius)

    def rms(values: np.ndarray) -> float | None:
        return float(np.sqrt(np.mean(values**2))) if len(values) else None

    return {
        "walls_found": int(near.sum()),
        "walls_total": int(np.sum((landmarks.kind == Kind.VA) & (landmarks.order == 1))),
        "walls_false": int((~near).sum()),
        "wall_distance_m": rms(distance[near]),
        "wall_angle_deg": rms(np.degrees(angle[near])),
    }
