"""Scenarios with a drive of one's own: ``[track] file`` or ``waypoints`` say where it starts, how fast and for how long."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from dopslam.config.generated import timed, under
from dopslam.config.track import TrackConfig
from dopslam.errors import ConfigError

if TYPE_CHECKING:
    from dopslam.config.sections import Sections
    from dopslam.config.trackfile import Drive

PERIOD = 0.2  # s, of waypoints
KNOWN = {
    "start",
    "speed",
    "steps",
    "period",
}  # what a stored scenario says, so that its file need not be there any more
FAR = 6.0  # standard deviations of the start's knowledge


def driven(tree: dict, folder: Path | None) -> tuple[dict, Drive | None]:
    """The tree of a scenario with what follows from its own drive where it does not say it itself, and the drive.

    Raises
    ------
    ConfigError
        If the track file or the waypoints are no good, or other keys of ``[track]`` say another drive.
    """
    track = tree.get("track")
    if not isinstance(track, dict) or not (track.get("file") or track.get("waypoints")):
        return tree, None
    if track.get("file") and set(track) >= KNOWN and (folder is None or not _path(track["file"], folder).exists()):
        return tree, None
    receiver = tree.get("receiver")
    height = receiver.get("height") if isinstance(receiver, dict) else None
    try:
        drive = _drive(track, 0.0 if height is None else float(height), folder)
        made = _said(drive)
        contradictions = _contradictions(track, made)
    except (TypeError, ValueError, IndexError):  # not even numbers: the validation names them
        return tree, None
    if contradictions:
        given = ", ".join(f"{key} = {track[key]}" for key in contradictions)
        instead = ", ".join(f"{key} = {made[key]}" for key in contradictions)
        source = "file" if track.get("file") else "waypoints"
        raise ConfigError(
            f"track: {given} is another drive than that of track.{source}, which says {instead}; leave these keys out, they "
            "follow from it"
        )
    return under(tree, {"track": made, "receiver": {"height": round(float(drive.position[:, 2].mean()), 3)}}), drive


def _said(drive: Drive) -> dict:
    """Keys of ``[track]`` that a drive says."""
    first = [*drive.position[0, :2], drive.heading[0], 0.0 if drive.bias is None else drive.bias[0]]
    turned = (drive.heading[1] - drive.heading[0]) / drive.period
    return {
        "start": [round(float(value), 6) for value in first],
        "speed": round(float(abs(drive.speed[0])), 6),
        "turn_rate": round(float(turned), 6) if abs(turned) < 1.0 else 0.0,
        "period": drive.period,
        "steps": len(drive.position) - 1,
    }


def _contradictions(track: dict, made: dict) -> list[str]:
    """Keys of ``[track]`` that say another drive than its file or waypoints: left over from a template, as a rule.

    The start may be off by what is known of it, and its clock bias is nowhere else to be said.
    """
    off = []
    if "start" in track and track["start"] != "snapshot":
        known = [float(v) for v in track.get("start_std", TrackConfig.model_fields["start_std"].default)]
        away = [float(a) - b for a, b in zip(track["start"], made["start"], strict=True)]
        away[2] = math.remainder(away[2], 2 * math.pi)
        if any(abs(away[i]) > FAR * known[i] + 1e-5 for i in (0, 1, 2)):
            off.append("start")
    slack = {"speed": 0.05 * made["speed"] + 0.05 if timed(track) else math.inf, "turn_rate": 0.1, "steps": 0.0}
    return off + [key for key, most in slack.items() if key in track and abs(float(track[key]) - made[key]) > most]


def drive_of(scenario: Sections, folder: Path | None) -> Drive:
    """The drive of a scenario that has one of its own; a relative file lies in ``folder``."""
    return _drive(scenario.track.model_dump(), scenario.receiver.height, folder)


def _drive(track: dict, height: float, folder: Path | None) -> Drive:
    from dopslam.config.trackfile import from_file, from_waypoints  # needs NumPy, which --help does without

    file, points = track.get("file"), track.get("waypoints")
    if file and points:
        raise ConfigError("track: give either file or waypoints")
    if not file:
        return from_waypoints(points, float(track.get("speed") or 0.0), height, float(track.get("period") or PERIOD))
    return from_file(_path(file, folder), height, float(track["period"]) if track.get("period") else None)


def _path(file: object, folder: Path | None) -> Path:
    path = Path(str(file))
    return path if path.is_absolute() or folder is None else folder / path
