"""Tracks of one's own: files (CSV with a header, TUM) and waypoints, and the drive at a constant period that they give.

World frame in meters, headings in radians, seconds. Between the given places a drive runs smoothly: through waypoints by
monotone cubics (a place given twice is a stop, and nothing overshoots), through the dense rows of a file by modified Akima
splines (monotone ones would bend a turn wherever it is parallel to an axis). Its heading is its course; where it comes to rest and
sets out against its heading, it drives backwards.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import Akima1DInterpolator, PchipInterpolator

from dopslam.config.delimited import cells_of
from dopslam.errors import ConfigError

COLUMNS = ("time", "x", "y", "z", "heading", "vx", "vy", "vz", "bias", "drive")
STANDING = 1e-3  # m/s; slower than this a receiver has no course
TUM = (".tum", ".txt")
MOST_STEPS = 100_000
LEAST_WAY = 5  # differences of places from which a course is told
FOLLOWED, ASTRAY = (
    0.03,
    0.25,
)  # mean sin² between heading and course, below and above which one follows the other or does not


@dataclass(frozen=True)
class Drive:
    """A drive at a constant period.

    Attributes
    ----------
    period : s, between the steps
    position : (K + 1, 3) m, heading : (K + 1,) rad, speed : (K + 1,) m/s, negative backwards; the first entry is the start,
        one period before the first step
    velocity : (K + 1, 3) m/s
    bias : (K + 1,) m, or None
    """

    period: float
    position: np.ndarray
    heading: np.ndarray
    speed: np.ndarray
    velocity: np.ndarray
    bias: np.ndarray | None


def read_rows(path: Path, called: str) -> dict[str, np.ndarray]:
    """Columns of a track file, numbers checked.

    Parameters
    ----------
    path : CSV with a header, columns among :data:`COLUMNS`; with an ending in :data:`TUM` rows of time, x, y, z and a
        quaternion x, y, z, w
    called : the key that names it, for messages

    Raises
    ------
    ConfigError
        If the file cannot be read, or a row is no good.
    """
    try:
        if path.suffix.lower() in TUM:
            with open(path, encoding="utf-8-sig") as file:
                lines = [line.split() for line in file if line.strip() and not line.startswith("#")]
            header = ["time", "x", "y", "z", "qx", "qy", "qz", "qw"]
        else:
            header, lines = cells_of(path)
    except (OSError, UnicodeDecodeError, ValueError, csv.Error) as error:
        raise ConfigError(f"{called} = {str(path)!r}: cannot be read as CSV with a header ({error})") from error
    names = [name.strip() for name in header]
    turned = path.suffix.lower() in TUM
    if not turned and (not {"time", "x", "y"} <= set(names) or not set(names) <= set(COLUMNS)):
        raise ConfigError(
            f"{path}: columns are {', '.join(names)}; needed are time, x, y and rows, known are {', '.join(COLUMNS)}"
        )
    if not lines:
        raise ConfigError(f"{path}: holds no rows; needed are time, x, y and rows, known are {', '.join(COLUMNS)}")
    try:
        table = np.array(lines, dtype=float)
        if table.ndim != 2 or table.shape[1] != len(names) or len(set(names)) < len(names):
            found = table.shape[1] if table.ndim == 2 else "unequal numbers"
            raise ValueError(f"{len(names)} columns named, {found} found, or a name twice")
    except ValueError as error:
        raise ConfigError(f"{path}: {error}; every row needs {len(names)} numbers") from error
    if not np.all(np.isfinite(table)):
        row = int(np.argmin(np.isfinite(table).all(axis=1)))
        raise ConfigError(f"{path}: data row {row + 1} holds a non-finite number; remove it")
    rows = dict(zip(names, table.T, strict=True))
    if turned:
        x, y, z, w = (rows.pop(name) for name in ("qx", "qy", "qz", "qw"))
        rows["heading"] = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y**2 + z**2))
    large = np.abs(np.column_stack([column for name, column in rows.items() if name != "time" or not turned])) > 1e9
    if np.any(large):
        raise ConfigError(
            f"{path}: data row {int(np.argmax(large.any(axis=1))) + 1} holds a number beyond 1e9; check its unit"
        )
    if not turned and "heading" in rows:
        _refuse_degrees(path, rows)
    return rows


def _refuse_degrees(path: Path, rows: dict[str, np.ndarray]) -> None:
    """Refuse headings in degrees: the way that was driven follows them as degrees, and as radians it does not."""
    way = np.diff(np.column_stack([rows["x"], rows["y"]]), axis=0)
    far = np.hypot(*way.T) > 1e-6
    if far.sum() < LEAST_WAY:
        return
    course, heading = np.arctan2(way[far, 1], way[far, 0]), 0.5 * (rows["heading"][1:] + rows["heading"][:-1])[far]

    def off(angle: np.ndarray) -> float:
        """How well headings explain the course, forwards or backwards: 0 if they do, about 0.5 if they are anything."""
        return float(np.mean(np.sin(course - angle) ** 2))

    if off(np.deg2rad(heading)) < FOLLOWED < ASTRAY < off(heading):
        raise ConfigError(
            f"{path}: the headings fit the way as degrees, and not as radians; give radians (multiply by pi/180)"
        )


def rising(path: Path | str, time: np.ndarray) -> None:
    """Refuse times that stand still or go back."""
    if np.any(np.diff(time) <= 0):
        at = int(np.argmax(np.diff(time) <= 0)) + 1
        raise ConfigError(
            f"{path}: time must rise within a drive, but {time[at]:g} s follows {time[at - 1]:g} s; sort or clean it"
        )


def course_held(course: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """Headings of a drive: the course where it moves, the last one where it stands (before the first move, that of it)."""
    if not moving.any():
        return np.zeros(len(course))
    last = np.maximum.accumulate(np.where(moving, np.arange(len(course)), -1))
    return course[np.where(last < 0, int(np.argmax(moving)), last)]


def from_file(path: Path, height: float, period: float | None) -> Drive:
    """The only drive of a track file; without ``period`` at the middle one of its rows."""
    rows = read_rows(path, "track.file")
    drives = rows.pop("drive", np.zeros(1))
    if np.ptp(drives) > 0:
        raise ConfigError(
            f"{path}: holds {len(np.unique(drives))} drives; track.file takes one, [dataset.tracks] takes all"
        )
    rising(path, rows["time"])
    if len(rows["time"]) < 2:
        raise ConfigError(f"{path}: holds one row; a drive needs two")
    period = period or float(np.median(np.diff(rows["time"])))
    places = np.column_stack([rows["x"], rows["y"], rows.get("z", np.full(len(rows["time"]), height))])
    return _drive(str(path), rows["time"], places, period, rows.get("heading"), rows.get("bias"), dense=True)


def from_waypoints(points, speed: float, height: float, period: float) -> Drive:
    """A drive through waypoints: rows x, y, time [m, m, s], or x, y at one speed [m/s]."""
    table = np.array([tuple(point) for point in points], dtype=float) if len({len(p) for p in points}) == 1 else None
    if table is None or len(table) < 2:
        raise ConfigError("track.waypoints: give two or more, all as [x, y] or all as [x, y, time]")
    if table.shape[1] == 3:
        time = table[:, 2]
        rising("track.waypoints, rows of x [m], y [m], time [s]", time)
    else:
        lengths = np.linalg.norm(np.diff(table, axis=0), axis=1)
        if not speed > 0 or np.any(lengths == 0):
            raise ConfigError("track.waypoints without times need track.speed above 0, and no place twice in a row")
        time = np.concatenate([[0.0], np.cumsum(lengths / speed)])
    places = np.column_stack([table[:, :2], np.full(len(table), height)])
    return _drive("track.waypoints", time, places, period)


def _drive(
    where: str, time: np.ndarray, places: np.ndarray, period: float, heading=None, bias=None, dense: bool = False
) -> Drive:
    time = time - time[0]  # epochs are too large for the interpolation's digits
    steps = int(np.floor(time[-1] / period + 1e-5))
    if not 1 <= steps <= MOST_STEPS:
        raise ConfigError(f"{where}: {time[-1]:g} s are {steps} steps of {period:g} s; give 1 to {MOST_STEPS}")
    at = np.minimum(period * np.arange(steps + 1), time[-1])
    smooth = Akima1DInterpolator(time, places, method="makima") if dense else PchipInterpolator(time, places)
    position, velocity = smooth(at), smooth.derivative()(at)
    headed = PchipInterpolator(time, np.unwrap(heading))(at) if heading is not None else _headings(velocity)
    forward = np.column_stack([np.cos(headed), np.sin(headed)])
    walked = None if bias is None else PchipInterpolator(time, bias)(at)
    wrapped = (headed + np.pi) % (2 * np.pi) - np.pi
    return Drive(period, position, wrapped, np.sum(velocity[:, :2] * forward, axis=1), velocity, walked)


def _headings(velocity: np.ndarray) -> np.ndarray:
    """The course, held while standing; against the last heading it is driven backwards."""
    course = np.arctan2(velocity[:, 1], velocity[:, 0])
    moving = np.hypot(*velocity[:, :2].T) > STANDING
    headings = course_held(course, moving)
    for step in range(1, len(headings)):
        off = (headings[step] - headings[step - 1] + np.pi) % (2 * np.pi) - np.pi
        headings[step] = (
            headings[step - 1] + off if abs(off) <= 0.5 * np.pi else headings[step - 1] + off - np.copysign(np.pi, off)
        )
    return headings
