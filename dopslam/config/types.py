"""Ranges of numbers and the frozen base of all configuration models."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

# Nothing that a radio on earth can have lies outside of these; what does is a slip of the pen or of the unit. They also
# keep squares and products within floating point, and work within what a machine can do.
Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]  # m (a clock bias too); also radians and rad/s
Vector2 = tuple[Coordinate, Coordinate]
Vector3 = tuple[Coordinate, Coordinate, Coordinate]
Vector4 = tuple[Coordinate, Coordinate, Coordinate, Coordinate]
Positive = Annotated[float, Field(ge=1e-15, le=1e12)]
NonNegative = Annotated[float, Field(ge=0, le=1e9)]
Probability = Annotated[float, Field(ge=0, le=1)]
Share = Annotated[float, Field(ge=0, lt=1)]
Chance = Annotated[float, Field(ge=1e-9, le=1)]  # a probability without which nothing works
Speed = Annotated[float, Field(ge=0, le=1e5)]  # m/s
Rate = Annotated[float, Field(ge=-100, le=100)]  # rad/s
Seconds = Annotated[float, Field(ge=1e-9, le=1e5)]
Hertz = Annotated[float, Field(ge=1, le=1e13)]
Decibel = Annotated[float, Field(ge=-300, le=300)]
Deviation = Annotated[float, Field(ge=0, le=1e6)]  # 0: known exactly
Count = Annotated[int, Field(ge=1, le=1_000_000)]
Few = Annotated[int, Field(ge=1, le=1000)]  # of what is repeated for every detection
Index = Annotated[int, Field(ge=0, le=1_000_000)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]


class Frozen(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
