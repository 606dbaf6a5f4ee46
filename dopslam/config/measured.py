"""Scenarios of measured detections: nobody traces, so that no scene, no arrays, no start and no speed need be said.

What follows from the measurements themselves takes their place: how fast the receiver can be and how far what it hears is.
The filter then starts from the scans, and holds speed and turn rate for unknown.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from dopslam.config.generated import under

POINT = {"kind": "custom", "positions_wavelengths": [[0.0, 0.0, 0.0]]}  # an antenna that tells no angle
NOWHERE = [0.0, 0.0, 0.0, 0.0]


@dataclass(frozen=True)
class Shown:
    """What measurements show of a drive.

    The defaults stand in until they have been read.

    Attributes
    ----------
    speed : m/s, about the largest
    reach : m, how far about the base station the receiver hears
    period : s, or None where steps are counted
    """

    speed: float = 10.0
    reach: float = 100.0
    period: float | None = None


def completed(tree: dict[str, Any], shown: Shown) -> tuple[dict[str, Any], bool]:
    """The tree of a scenario with what it does not say, and whether speed and turn rate are unknown: nobody gave them."""
    track = tree.get("track")
    track = track if isinstance(track, dict) else {}
    free = "speed" not in track
    made: dict[str, Any] = {
        "name": "measured",
        "scene": {},
        "base_station": {"array": POINT},
        "receiver": {"array": POINT},
        "track": {},
    }
    if shown.period is not None:
        made["track"]["period"] = shown.period
    if free:
        made["track"]["speed"] = 0.0
        made["filter"] = {"motion": "unknown", "speed_std": shown.speed}
    if "start" not in track:
        made["track"]["start"] = NOWHERE
        made["filter"] = made.get("filter", {}) | {"start": "snapshot"}
    return under(tree, made), free
