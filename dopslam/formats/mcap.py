"""Runs as MCAP logs of ROS 2 messages, for Foxglove, PlotJuggler and rosbag tools; no ROS is needed to write them.

``/slam/odometry`` (nav_msgs/Odometry), ``/slam/pose`` (geometry_msgs/PoseWithCovarianceStamped), ``/truth/odometry`` where the
truth is there, and ``/detections`` (radar_msgs/RadarScan) of the arrivals. Frames by REP-103: ``map`` is the world frame (z up),
``base_link`` has x forward along the heading, y left, z up.

A detection becomes a return in ``base_link``: azimuth counterclockwise from the heading and elevation positive upwards, both as
they are here. *Range* is c·τ, the whole length of the path with the clock bias in it, not the distance of what reflects.
*Doppler velocity* is the rate at which that length grows, so that its sign is turned: positive is going away. *Amplitude* is
ρ in dB.

Needs the packages ``mcap`` and ``mcap-ros2-support``: ``pip install 'dopslam[robotics]'``.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from dopslam.datasets.parts import Part
from dopslam.errors import DatasetError
from dopslam.formats.mapped import Mapped, runs_of
from dopslam.records import SPEED_OF_LIGHT, DetectionSeries, Track

_LINE = "=" * 80
_TIME = "int32 sec\nuint32 nanosec\n"
_HEADER = "builtin_interfaces/Time stamp\nstring frame_id\n"
_POSE = "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"
_VECTOR = "float64 x\nfloat64 y\nfloat64 z\n"
_TYPES = {
    "builtin_interfaces/Time": _TIME,
    "std_msgs/Header": _HEADER,
    "geometry_msgs/Point": _VECTOR,
    "geometry_msgs/Vector3": _VECTOR,
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "geometry_msgs/Pose": _POSE,
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance\n",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance\n",
    "radar_msgs/RadarReturn": "float32 range\nfloat32 azimuth\nfloat32 elevation\nfloat32 doppler_velocity\nfloat32 amplitude\n",
}
_COMMON = ("std_msgs/Header", "builtin_interfaces/Time")
_POSES = ("geometry_msgs/PoseWithCovariance", "geometry_msgs/Pose", "geometry_msgs/Point", "geometry_msgs/Quaternion")
_MESSAGES = {
    "nav_msgs/msg/Odometry": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
        "geometry_msgs/TwistWithCovariance twist\n",
        (*_COMMON, *_POSES, "geometry_msgs/TwistWithCovariance", "geometry_msgs/Twist", "geometry_msgs/Vector3"),
    ),
    "geometry_msgs/msg/PoseWithCovarianceStamped": (
        "std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose\n",
        (*_COMMON, *_POSES),
    ),
    "radar_msgs/msg/RadarScan": (
        "std_msgs/Header header\nradar_msgs/RadarReturn[] returns\n",
        (*_COMMON, "radar_msgs/RadarReturn"),
    ),
}


def definition(name: str) -> str:
    """Definition of a message with those it is made of, as MCAP wants them."""
    own, parts = _MESSAGES[name]
    return own + "".join(f"{_LINE}\nMSG: {part}\n{_TYPES[part]}" for part in parts)


def write(parts: list[Part], out: Path) -> None:
    """``slam_….mcap`` for every filter history."""
    try:
        from mcap_ros2.writer import Writer
    except ImportError as error:
        raise DatasetError(
            "MCAP needs the packages 'mcap' and 'mcap-ros2-support': pip install 'dopslam[robotics]'"
        ) from error
    part = parts[0]
    detections = part.read("detections", DetectionSeries) if part.has("detections") else None
    truth = part.track if part.has("track") else None
    for run in runs_of(parts):
        with open(out / f"{run.name}.mcap", "wb") as file:
            writer = Writer(file)
            schemas = {name: writer.register_msgdef(name, definition(name)) for name in _MESSAGES}
            for step, stamp in enumerate(np.round(run.time * 1e9).astype(int).tolist()):
                for topic, kind, message in _messages(run, truth, detections, step, stamp):
                    writer.write_message(topic, schemas[kind], message, stamp, stamp, step)
            writer.finish()


def _messages(
    run: Mapped, truth: Track | None, detections: DetectionSeries | None, step: int, stamp: int
) -> Iterator[tuple]:
    """(topic, type, message) of one step."""
    estimate = odometry(stamp, *_estimated(run, step))
    yield "/slam/odometry", "nav_msgs/msg/Odometry", estimate
    stamped = {"header": estimate["header"], "pose": estimate["pose"]}
    yield "/slam/pose", "geometry_msgs/msg/PoseWithCovarianceStamped", stamped
    if truth is not None:
        yield "/truth/odometry", "nav_msgs/msg/Odometry", odometry(stamp, *_true(truth, step))
    if detections is not None:
        yield "/detections", "radar_msgs/msg/RadarScan", radar_scan(stamp, detections, step)


def header(stamp: int, frame: str) -> dict:
    """Header of a time [ns] and a frame."""
    return {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": frame}


def odometry(stamp: int, position, heading: float, covariance: np.ndarray, speed: float, rate: float) -> dict:
    """Message of a pose; ``covariance`` (3, 3) is of x, y and heading, what is not estimated has the variance 0."""
    full = np.zeros((6, 6))  # x, y, z, roll, pitch, yaw
    full[np.ix_([0, 1, 5], [0, 1, 5])] = covariance
    point = dict(zip("xyz", map(float, position), strict=True))
    turn = {"x": 0.0, "y": 0.0, "z": float(np.sin(heading / 2)), "w": float(np.cos(heading / 2))}
    return {
        "header": header(stamp, "map"), "child_frame_id": "base_link",
        "pose": {"pose": {"position": point, "orientation": turn}, "covariance": full.ravel().tolist()},
        "twist": {
            "twist": {"linear": {"x": speed, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": rate}},
            "covariance": [0.0] * 36,
        },
    }  # fmt: skip


def _estimated(run: Mapped, step: int):
    """Position, heading, covariance; the speed between the neighboring steps where the state has none."""
    mean = run.history.mean[step]
    covariance = run.history.covariance[step][:3, :3]
    if len(mean) == 6:
        return run.position[step], mean[2], covariance, float(mean[4]), float(mean[5])
    low, high = max(step - 1, 0), min(step + 1, len(run.time) - 1)
    if low == high:
        return run.position[step], mean[2], covariance, 0.0, 0.0
    way, span = run.history.mean[high] - run.history.mean[low], run.time[high] - run.time[low]
    along = way[:2] @ [np.cos(mean[2]), np.sin(mean[2])]
    turn = (way[2] + np.pi) % (2 * np.pi) - np.pi
    return run.position[step], mean[2], covariance, float(along / span), float(turn / span)


def _true(track: Track, step: int):
    heading = float(track.heading[step])
    speed = float(track.velocity[step, :2] @ [np.cos(heading), np.sin(heading)])
    return track.position[step], heading, np.zeros((3, 3)), speed, 0.0


def radar_scan(stamp: int, detections: DetectionSeries, step: int) -> dict:
    """The detections of a snapshot as returns in the receiver's frame."""
    rows = range(*detections.rows(step).indices(len(detections.delay)))
    return {
        "header": header(stamp, "base_link"),
        "returns": [
            {
                "range": float(SPEED_OF_LIGHT * detections.delay[row]),
                "azimuth": float(detections.aoa[row, 0]),
                "elevation": float(detections.aoa[row, 1]),
                "doppler_velocity": -float(detections.radial_velocity[row]),
                "amplitude": float(10 * np.log10(detections.snr[row])),
            }
            for row in rows
        ],
    }


class Mcap:
    """The run of every filter as ROS 2 messages."""

    writes, reads = True, False

    def write(self, parts: list[Part], out: Path) -> None:
        """A file per filter history."""
        write(parts, out)
