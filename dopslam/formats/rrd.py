"""Runs as recordings of the Rerun viewer (``.rrd``): what happens at every step, on the timelines ``step`` and ``time``.

World frame, meters, z up. ``/base_station`` is static; ``/truth/track`` and ``/truth/receiver`` are there where the truth is.
``/slam/receiver`` is where the filter puts the receiver, ``/slam/heading`` an arrow along its heading, ``/slam/track`` the way
so far, ``/slam/uncertainty`` and ``/slam/scatter_points`` the ellipsoids that hold 95 %, and ``/slam/walls`` the walls of the
map over what was seen of them. ``/error/position_m`` is the distance from the truth.

Needs the package ``rerun-sdk`` (170 MB): ``pip install 'dopslam[rerun]'``.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dopslam.datasets.parts import Part
from dopslam.errors import DatasetError
from dopslam.evaluate.walls import walls
from dopslam.formats.mapped import Mapped, runs_of
from dopslam.records import Kind, Track

WALL, POINT, STATION, TRACK, TRUTH = (230, 159, 0), (0, 158, 115), (213, 94, 0), (0, 114, 178), (17, 17, 17)
IN_SPACE, IN_PLANE = 2.7955, 2.4477  # half axes over standard deviations that hold 95 % in three and in two dimensions
ARROW = 0.05  # of the extent of the track


def write(parts: list[Part], out: Path) -> None:
    """``slam_….rrd`` for every filter history."""
    try:
        rerun: Any = import_module("rerun")
    except ImportError as error:
        raise DatasetError("recordings need the package 'rerun-sdk': pip install 'dopslam[rerun]'") from error
    part = parts[0]
    truth = part.track if part.has("track") else None
    for run in runs_of(parts):
        recording = rerun.RecordingStream("dopslam", recording_id=run.name)
        recording.save(out / f"{run.name}.rrd")
        _record(rerun, recording, run, truth)
        recording.flush()


def _record(rr: Any, recording: Any, run: Mapped, truth: Track | None) -> None:
    """Everything of one run; ``rr`` is the package, which not everybody has."""
    recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    size = max(float(np.ptp(run.position, axis=0).max()), 1.0)
    station = rr.Points3D([run.base_station], colors=[STATION], radii=size / 80, labels=["base station"])
    recording.log("/base_station", station, static=True)
    if truth is not None:
        recording.log("/truth/track", rr.LineStrips3D([truth.position], colors=[TRUTH]), static=True)
    for step, moment in enumerate(run.time.tolist()):
        recording.set_time("step", sequence=step + 1)
        recording.set_time("time", duration=moment)
        place, heading = run.position[step], run.history.mean[step, 2]
        ahead = size * ARROW * np.array([np.cos(heading), np.sin(heading), 0.0])
        recording.log("/slam/receiver", rr.Points3D([place], colors=[TRACK], radii=size / 150))
        recording.log("/slam/heading", rr.Arrows3D(origins=[place], vectors=[ahead], colors=[TRACK]))
        recording.log("/slam/track", rr.LineStrips3D([run.position[: step + 1]], colors=[TRACK]))
        flat = np.zeros((1, 3, 3))
        flat[0, :2, :2] = run.history.covariance[step][:2, :2]
        recording.log("/slam/uncertainty", _ellipsoids(rr, place[None], flat, IN_PLANE, TRACK))
        _record_map(rr, recording, run, step)
        if truth is not None:
            recording.log("/truth/receiver", rr.Points3D([truth.position[step]], colors=[TRUTH], radii=size / 150))
            away = float(np.linalg.norm(place[:2] - truth.position[step, :2]))
            recording.log("/error/position_m", rr.Scalars(away))


def _record_map(rr: Any, recording: Any, run: Mapped, step: int) -> None:
    history, height = run.history, float(run.position[step, 2])
    rows = np.arange(len(history.existence))[history.rows(step)]
    points = rows[(history.existence[rows] > run.threshold) & (history.kind[rows] == Kind.SP)]
    recording.log(
        "/slam/scatter_points",
        _ellipsoids(rr, history.position[points], history.position_covariance[points], IN_SPACE, POINT),
    )
    found = walls(history, run.base_station, height, step, run.threshold)
    corner = 4 * np.arange(len(found))[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    recording.log(
        "/slam/walls",
        rr.Mesh3D(
            vertex_positions=found.corners.reshape(-1, 3), triangle_indices=corner.reshape(-1, 3),
            vertex_colors=[WALL] * (4 * len(found)),
        ),
    )  # fmt: skip


def _ellipsoids(rr: Any, centers: np.ndarray, covariances: np.ndarray, scale: float, color: tuple) -> Any:
    """Ellipsoids of covariances (N, 3, 3): half axes along the eigenvectors, which are made right-handed."""
    values, axes = np.linalg.eigh(covariances)
    axes[np.linalg.det(axes) < 0, :, 0] *= -1
    half = scale * np.sqrt(np.maximum(values, 0.0))
    turn = Rotation.from_matrix(axes).as_quat() if len(centers) else np.zeros((0, 4))
    return rr.Ellipsoids3D(centers=centers, half_sizes=half, quaternions=turn, colors=[color] * len(centers))


class Rrd:
    """The run of every filter as a recording for the Rerun viewer."""

    writes, reads = True, False

    def write(self, parts: list[Part], out: Path) -> None:
        """A file per filter history."""
        write(parts, out)
