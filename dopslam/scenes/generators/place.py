"""Where to put a base station and a drive in a scene that says nothing of either.

The scene is cut at the receiver's height; what is cut are obstacles. Of many random places the one is taken that is best
enclosed (walls are what is mapped), leaves most room for a straight drive, and has a base station near a wall that sees all
of it. Meters, world frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

RAYS = 32
FAR = 150.0  # m, farther walls do not count
TRIALS = 150
FLAT = 0.95  # cosine of a slope that still is ground
LEVEL = 0.3  # m
STEPS, PERIOD = 50, 0.2  # of the drive; s


@dataclass(frozen=True)
class Habit:
    """How people move and mount base stations there: ranges and distances [m], [m/s]."""

    speed: float
    slowest: float
    clearance: float
    station_from_wall: float
    station_height: float
    receiver_height: float
    radius: float  # of what is looked at around a place


INDOOR = Habit(1.0, 0.15, 0.6, 0.35, 2.4, 1.4, 40.0)
OUTDOOR = Habit(8.0, 2.0, 2.0, 1.2, 8.0, 1.5, 120.0)


@dataclass(frozen=True)
class Placed:
    """Base station (3,) m with its yaw [rad], and the drive: start x, y [m], heading [rad], speed [m/s]."""

    station: tuple[float, float, float]
    yaw: float
    start: tuple[float, float, float]
    speed: float
    receiver_height: float
    seen: float  # share of the drive that the base station sees


def sections(triangles: np.ndarray, height: float) -> np.ndarray:
    """Segments (S, 2, 2) m in which triangles (T, 3, 3) cut the plane z = ``height``."""
    z = triangles[..., 2] - height
    cut = triangles[np.any(z > 0, axis=1) & np.any(z < 0, axis=1)]
    ends = []
    for i in range(3):
        p, q = cut[:, i], cut[:, (i + 1) % 3]
        u, v = p[:, 2] - height, q[:, 2] - height
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(u * v < 0, u / (u - v), np.nan)
        ends.append(p[:, :2] + share[:, None] * (q[:, :2] - p[:, :2]))
    points = np.stack(ends, axis=1)  # (C, 3, 2), one of the three is no number
    order = np.argsort(np.isnan(points[..., 0]), axis=1, kind="stable")[:, :2]
    pairs = np.take_along_axis(points, order[..., None], axis=1)
    return pairs[np.isfinite(pairs).all(axis=(1, 2))]


def distance(points: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """Distance (N,) m of points (N, 2) to the nearest of segments (S, 2, 2)."""
    if not len(segments):
        return np.full(len(points), np.inf)
    a, way = segments[:, 0], segments[:, 1] - segments[:, 0]
    away = points[:, None] - a
    share = np.clip(np.sum(away * way, -1) / np.maximum(np.sum(way**2, -1), 1e-12), 0, 1)
    return np.linalg.norm(away - share[..., None] * way, axis=-1).min(axis=1)


def hits(origin: np.ndarray, directions: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """Distance (R,) along rays from one point (2,) in directions (R, 2) to the first segment, inf if there is none."""
    if not len(segments):
        return np.full(len(directions), np.inf)
    a, way = segments[:, 0] - origin, segments[:, 1] - segments[:, 0]
    across = directions[:, None, 0] * way[:, 1] - directions[:, None, 1] * way[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (a[:, 0] * way[:, 1] - a[:, 1] * way[:, 0]) / across
        share = (a[:, 0] * directions[:, None, 1] - a[:, 1] * directions[:, None, 0]) / across
    good = (along > 1e-9) & (share >= 0) & (share <= 1)
    return np.where(good, along, np.inf).min(axis=1)


def terrain(triangles: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """Triangles (S, 3, 3) m that face upward of the object that covers most of the scene: its ground, where it is hilly.

    Parameters
    ----------
    triangles : (T, 3, 3) m
    owner : (T,) object of each
    """
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    size = np.linalg.norm(normal, axis=1)
    upward = normal[:, 2] > FLAT * np.maximum(size, 1e-12)
    covered = np.bincount(owner, np.where(upward, normal[:, 2], 0.0))
    return triangles[upward & (owner == int(np.argmax(covered)))]


def level_places(ground: np.ndarray, rng: np.random.Generator) -> tuple[float, np.ndarray]:
    """Height [m] of one place of a hilly ground (S, 3, 3), drawn by area, and places (N, 2) m that are about as high."""
    (ux, uy), (vx, vy) = ((ground[:, i, :2] - ground[:, 0, :2]).T for i in (1, 2))
    middle, size = ground.mean(axis=1), np.abs(ux * vy - uy * vx)
    height = float(middle[rng.choice(len(ground), p=size / size.sum()), 2])
    near = np.flatnonzero(np.abs(middle[:, 2] - height) < LEVEL)
    return height, middle[rng.choice(near, min(TRIALS, len(near)), replace=False), :2]


def place(
    triangles: np.ndarray,
    habit: Habit,
    ground: float,
    blocked,
    rng: np.random.Generator,
    spots: np.ndarray | None = None,
) -> Placed | None:
    """The best of many random places; None if none is any good.

    Parameters
    ----------
    triangles : (T, 3, 3) m of the scene
    ground : m, height of the floor
    blocked : places (N, 3) m → (N,) bool, inside of something solid
    spots : (N, 2) m, places that are tried; None: anywhere
    """
    height = ground + habit.receiver_height
    segments = np.concatenate([sections(triangles, ground + 0.35), sections(triangles, height)])
    walls = sections(triangles, height)
    outline = (walls if len(walls) > 3 else triangles[..., :2]).reshape(-1, 2)
    low, high = outline.min(axis=0), outline.max(axis=0)
    spots = rng.uniform(low, high, (TRIALS, 2)) if spots is None else spots
    spots = spots[~blocked(np.column_stack([spots, np.full(len(spots), height)]))]
    azimuth = 2 * np.pi * np.arange(RAYS) / RAYS
    rays = np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    best: tuple[float, Placed] | None = None
    for spot in spots:
        near = distance_to_boxes(spot, segments) < habit.radius
        local = segments[near]
        if distance(spot[None], local)[0] < habit.clearance:
            continue
        reach = hits(spot, rays, local)
        enclosed = float(np.mean(reach < habit.radius))
        found = _around(spot, rays, reach, local, habit, ground, blocked, rng) if enclosed > 0 else None
        if found is None:
            continue
        score = found.seen + enclosed + 0.5 * found.speed / habit.speed
        if best is None or score > best[0]:
            best = score, found
    return best[1] if best else None


def distance_to_boxes(point: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """Distance (S,) m of a point (2,) to the boxes around segments: a quick lower bound of the true one."""
    over = np.maximum(np.maximum(segments.min(axis=1) - point, point - segments.max(axis=1)), 0)
    return np.hypot(*over.T)


def _around(spot, rays, reach, local, habit: Habit, ground, blocked, rng) -> Placed | None:
    """The longest straight drive through a place, and the wall-mounted base station that sees most of it, from aside."""
    capped = np.minimum(reach, habit.radius) - habit.clearance
    both = np.minimum(capped, np.roll(capped, RAYS // 2))
    best = int(np.argmax(both))
    half = min(float(both[best]), habit.speed * PERIOD * STEPS / 2)
    speed = round(2 * half / (PERIOD * STEPS), 2)
    if speed < habit.slowest:
        return None
    heading = rays[best]
    way = spot + np.linspace(-half, half, 25)[:, None] * heading
    at = ground + habit.receiver_height
    clear = distance(way, local).min() >= 0.9 * habit.clearance
    if not clear or blocked(np.column_stack([way, np.full(len(way), at)])).any():
        return None
    options = []
    for i in np.flatnonzero(np.isfinite(reach) & (reach > habit.station_from_wall + habit.clearance)):
        station = spot + (reach[i] - habit.station_from_wall) * rays[i]
        top = ground + habit.station_height
        bad = distance(station[None], local)[0] < 0.6 * habit.station_from_wall
        if bad or blocked(np.array([[*station, top]]))[0] or np.linalg.norm(way - station, axis=1).min() < 1.0:
            continue
        lines = way - station
        seen = float(np.mean([hits(station, line[None], local)[0] >= 1.0 for line in lines]))
        aside = abs(heading[0] * (station - spot)[1] - heading[1] * (station - spot)[0])
        options.append((seen + 0.3 * min(1.0, aside / half) + 0.05 * rng.uniform(), station, seen))
    if not options:
        return None
    _, station, seen = max(options, key=lambda option: option[0])
    look = spot - station
    (x, y), (first_x, first_y) = (tuple(round(float(v), 2) for v in place[:2]) for place in (station, way[0]))
    return Placed(
        (x, y, round(ground + habit.station_height, 2)),
        float(np.arctan2(look[1], look[0])),
        (first_x, first_y, round(float(np.arctan2(heading[1], heading[0])), 4)),
        speed,
        round(at, 2),
        seen,
    )
