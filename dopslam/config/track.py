"""``[track]``: where the receiver starts, how it moves, and what is known of it."""

from __future__ import annotations

from pydantic import field_validator

from dopslam.config.types import Coordinate, Count, Deviation, Frozen, Positive, Rate, Seconds, Speed, Vector4

Deviations = tuple[Deviation, Deviation, Deviation, Deviation]


class TrackConfig(Frozen):
    """Coordinated turn of paper A, eq. (1); a turn rate of zero is a straight line."""

    speed: Speed  # m/s
    turn_rate: Rate = 0.0  # rad/s
    period: Seconds = 0.5  # s
    steps: Count = 40
    start: Vector4  # x m, y m, heading rad, clock bias m: mean of the receiver's initial knowledge
    start_std: Deviations = (0.3, 0.3, 0.0052, 0.3)
    process_std: Deviations = (0.2, 0.2, 0.001, 0.2)  # per step
    random: bool = True  # draw start and process noise; False: exactly the nominal track
    file: str | None = None  # a drive of one's own beside scenario.toml, CSV or TUM; it says the keys above
    waypoints: tuple[tuple[Coordinate, ...], ...] = ()  # likewise: x m, y m, time s, or x, y at one speed
    max_acceleration: Positive | None = None  # m/s², of a drive of one's own
    max_turn_rate: Positive | None = None  # rad/s

    @field_validator("start", mode="before")
    @classmethod
    def _a_world_starts_somewhere(cls, value):
        if value == "snapshot":
            raise ValueError(
                'tracing and simulation start here too; to keep it from the filter set filter.start="snapshot"'
            )
        return value
