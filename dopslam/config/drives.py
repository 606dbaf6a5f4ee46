"""The optional section ``[dataset]`` of a scenario: which tracks a large dataset is made of.

Without the section, every drive is one draw of the scenario's motion model (``[track]``). Speed, period and clock are
those of
``[track]`` unless a kind says otherwise.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from dopslam.config.types import Count, Frozen, Positive, Vector2

Length = Annotated[float, Field(ge=1e-6, le=1e6)]  # m
Moving = Annotated[float, Field(ge=1e-6, le=1e5)]  # m/s


class MotionTracks(Frozen):
    """Every drive is one realization of the scenario's motion model, eq. (1)."""

    kind: Literal["motion"] = "motion"


class LineTracks(Frozen):
    """To and fro between two points, from a random place on the line in a random direction."""

    kind: Literal["line"]
    ends: tuple[Vector2, Vector2]  # m


class CircleTracks(Frozen):
    """Around a center, from a random place in a random direction."""

    kind: Literal["circle"]
    center: Vector2 = (0.0, 0.0)  # m
    radius: Length  # m


class DriveTracks(Frozen):
    """Smooth random drives that never leave a polygon."""

    kind: Literal["drive"]
    polygon: Annotated[tuple[Vector2, ...], Field(min_length=3, max_length=10_000)]  # m, corners in order
    speed: tuple[Moving, Moving] | None = None  # m/s, least and largest; None: track.speed
    turn_rate: Annotated[float, Field(ge=1e-9, le=100)] = 0.6  # rad/s, largest
    restlessness: Annotated[float, Field(ge=0, le=100)] = 0.2  # rad/s per √s, by which the turn rate walks

    @model_validator(mode="after")
    def _least_first(self):
        if self.speed is not None and self.speed[0] > self.speed[1]:
            raise ValueError(f"speed = {list(self.speed)}: the least comes after the largest")
        return self


class FileTracks(Frozen):
    """Tracks of one's own: CSV with a header, columns time, x, y and optionally z, heading, vx, vy, vz, bias, drive."""

    kind: Literal["file"]
    file: str  # beside scenario.toml, or absolute


TracksConfig = Annotated[
    MotionTracks | LineTracks | CircleTracks | DriveTracks | FileTracks, Field(discriminator="kind")
]


class DatasetConfig(Frozen):
    """What ``dopslam dataset`` makes."""

    tracks: TracksConfig = MotionTracks()
    steps: Count | None = None  # of one drive; None: track.steps
    shard_positions: Annotated[int, Field(ge=1, le=100_000)] = 2000  # most positions of one shard
    shard_megabytes: Positive = 256.0  # most of a shard's signal, where it is stored
