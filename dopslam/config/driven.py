"""Scenarios with a drive of one's own: ``[track] file`` or ``waypoints`` say where it starts, how fast and for how long."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from dopslam.config.generated import under
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
}  # what a stored scenario says, so that the file need not be there any more


def driven(tree: dict, folder: Path | None) -> tuple[dict, Drive | None]:
    """The tree of a scenario with what follows from its own drive where it does not say it itself, and the drive.

    Raises
    ------
    ConfigError
        If the track file or the waypoints are no good.
    """
    track = tree.get("track")
    if not isinstance(track, dict) or not (track.get("file") or track.get("waypoints")) or set(track) >= KNOWN:
        return tree, None
    receiver = tree.get("receiver")
    height = receiver.get("height") if isinstance(receiver, dict) else None
    try:
        drive = _drive(track, 0.0 if height is None else float(height), folder)
    except (TypeError, ValueError):  # not even numbers: the validation names them
        return tree, None
    first = [*drive.position[0, :2], drive.heading[0], 0.0 if drive.bias is None else drive.bias[0]]
    turned = (drive.heading[1] - drive.heading[0]) / drive.period
    made = {
        "track": {
            "start": [round(float(value), 6) for value in first],
            "speed": round(float(abs(drive.speed[0])), 6),
            "turn_rate": round(float(turned), 6) if abs(turned) < 1.0 else 0.0,
            "period": drive.period,
            "steps": len(drive.position) - 1,
        },
        "receiver": {"height": round(float(drive.position[:, 2].mean()), 3)},
    }
    return under(tree, made), drive


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
    path = Path(str(file))
    path = path if path.is_absolute() or folder is None else folder / path
    return from_file(path, height, float(track["period"]) if track.get("period") else None)
