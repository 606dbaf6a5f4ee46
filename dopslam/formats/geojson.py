"""Maps as GeoJSON (RFC 7946): walls as lines over the extent that was seen, landmarks and base station as points, the track.

Without an origin coordinates are meters of the world frame, which RFC 7946 leaves to agreement between the parties; the file
says so. With an origin (latitude, longitude, height, azimuth of the x axis) they are WGS 84 degrees and meters of height: the
world frame is taken as the plane that touches the ellipsoid there.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dopslam.datasets.parts import Part
from dopslam.errors import DatasetError
from dopslam.formats.mapped import NAMES, Mapped, runs_of
from dopslam.records import Kind

SEMI_MAJOR, FLATTENING = 6_378_137.0, 1 / 298.257223563  # WGS 84, m
ECCENTRICITY = FLATTENING * (2 - FLATTENING)  # squared


@dataclass(frozen=True)
class Origin:
    """Where the world frame lies on earth.

    Attributes
    ----------
    latitude, longitude : degrees; height : m above the ellipsoid
    azimuth : degrees from east, counterclockwise, that the x axis points to (0: x east, y north)
    """

    latitude: float
    longitude: float
    height: float = 0.0
    azimuth: float = 0.0

    @staticmethod
    def parse(text: str) -> Origin:
        """From ``latitude,longitude[,height[,azimuth]]``."""
        try:
            numbers = [float(part) for part in text.split(",")]
            found = Origin(*numbers)
        except (TypeError, ValueError) as error:
            raise DatasetError(
                f"--origin {text!r}: give latitude,longitude[,height[,azimuth]] in degrees and meters"
            ) from error
        if not (-90 <= found.latitude <= 90 and -180 <= found.longitude <= 180 and np.isfinite(numbers).all()):
            raise DatasetError(
                f"--origin {text!r}: latitude lies in ±90, longitude in ±180 degrees; latitude comes first"
            )
        return found

    def degrees(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) longitude, latitude [degrees] and height [m] of world points (N, 3) [m]."""
        turn = np.deg2rad(self.azimuth)
        east = np.cos(turn) * points[:, 0] - np.sin(turn) * points[:, 1]
        north = np.sin(turn) * points[:, 0] + np.cos(turn) * points[:, 1]
        start = earth_centered(np.array([[self.longitude, self.latitude, self.height]]))[0]
        lon, lat = np.deg2rad([self.longitude, self.latitude])
        axes = np.array([
            [-np.sin(lon), np.cos(lon), 0.0],
            [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)],
            [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)],
        ])  # fmt: skip
        return geodetic(start + np.column_stack([east, north, points[:, 2]]) @ axes)


def earth_centered(places: np.ndarray) -> np.ndarray:
    """(N, 3) m, earth-centered earth-fixed, of longitude, latitude [degrees] and height [m]."""
    lon, lat, height = np.deg2rad(places[:, 0]), np.deg2rad(places[:, 1]), places[:, 2]
    normal = SEMI_MAJOR / np.sqrt(1 - ECCENTRICITY * np.sin(lat) ** 2)
    around = (normal + height) * np.cos(lat)
    return np.column_stack([
        around * np.cos(lon), around * np.sin(lon), (normal * (1 - ECCENTRICITY) + height) * np.sin(lat),
    ])  # fmt: skip


def geodetic(points: np.ndarray) -> np.ndarray:
    """(N, 3) longitude, latitude [degrees] and height [m] of earth-centered points; the inverse of :func:`earth_centered`."""
    around = np.hypot(points[:, 0], points[:, 1])
    latitude = np.arctan2(points[:, 2], around * (1 - ECCENTRICITY))
    for _ in range(8):  # a contraction by e² ≈ 1/150 at every turn
        normal = SEMI_MAJOR / np.sqrt(1 - ECCENTRICITY * np.sin(latitude) ** 2)
        latitude = np.arctan2(points[:, 2] + ECCENTRICITY * normal * np.sin(latitude), around)
    normal = SEMI_MAJOR / np.sqrt(1 - ECCENTRICITY * np.sin(latitude) ** 2)
    flat = np.abs(latitude) < np.pi / 4
    height = np.where(
        flat,
        around / np.where(flat, np.cos(latitude), 1.0) - normal,
        points[:, 2] / np.where(flat, 1.0, np.sin(latitude)) - normal * (1 - ECCENTRICITY),
    )
    return np.column_stack([np.rad2deg(np.arctan2(points[:, 1], points[:, 0])), np.rad2deg(latitude), height])


def write(parts: list[Part], out: Path, origin: Origin | None = None) -> None:
    """``slam_….geojson`` for every filter history."""
    for run in runs_of(parts):
        text = json.dumps(tree(run, origin), indent=1, allow_nan=False)
        (out / f"{run.name}.geojson").write_text(text + "\n", encoding="utf-8")


def tree(run: Mapped, origin: Origin | None) -> dict:
    """The feature collection of one run."""

    def coordinates(points: np.ndarray) -> list:
        placed = np.asarray(points, float) if origin is None else origin.degrees(np.asarray(points, float))
        return np.round(placed, 4 if origin is None else 9).tolist()

    def feature(kind: str, shape: str, points: np.ndarray, **more) -> dict:
        where = coordinates(points)
        geometry = {
            "type": shape,
            "coordinates": where[0] if shape == "Point" else [where] if shape == "Polygon" else where,
        }
        return {"type": "Feature", "properties": {"kind": kind, **more}, "geometry": geometry}

    features = [feature("base station", "Point", run.base_station[None])]
    found = run.walls
    for corners, normal, deviation, existence in zip(
        found.corners, found.normal, found.deviation, found.existence, strict=True
    ):
        told = {
            "normal": np.round(normal, 6).tolist(), "std_m": round(float(deviation), 4), "existence": round(float(existence), 4),
            "height_m": np.round([corners[:, 2].min(), corners[:, 2].max()], 3).tolist(),
        }  # fmt: skip
        if np.hypot(*normal[:2]) < 0.5:
            features.append(feature("level", "Polygon", np.vstack([corners, corners[:1]]), **told))
        else:
            features.append(feature("wall", "LineString", corners[:2], **told))
    history = run.history
    for row in run.last.tolist():
        kind, spread = Kind(int(history.kind[row])), history.position_covariance[row]
        std = np.round(np.sqrt(np.maximum(np.diag(spread), 0.0)), 4).tolist()
        existence = round(float(history.existence[row]), 4)
        features.append(
            feature(NAMES.get(kind, kind.name), "Point", history.position[row][None], existence=existence, std_m=std)
        )
    if history.steps > 1:
        features.append(feature("track", "LineString", run.position, time_s=run.time.tolist()))
    frame = "meters, world frame (x, y, z up)" if origin is None else "WGS 84"
    return {"type": "FeatureCollection", "frame": frame, "features": features}


class GeoJson:
    """The map of every filter, in meters, or in degrees where an origin is given."""

    writes, reads = True, False

    def __init__(self, origin: Origin | None = None) -> None:
        self.origin = origin

    def write(self, parts: list[Part], out: Path) -> None:
        """A file per filter history."""
        write(parts, out, self.origin)
