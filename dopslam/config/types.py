"""Ranges of numbers and the frozen base of all configuration models."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

# Nothing that a radio on earth can have lies outside of these; what does is a slip of the pen or of the unit.
Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]  # m (a clock bias too); also radians and rad/s
Vector3 = tuple[Coordinate, Coordinate, Coordinate]
Vector4 = tuple[Coordinate, Coordinate, Coordinate, Coordinate]
Positive = Annotated[float, Field(gt=0, le=1e12)]
NonNegative = Annotated[float, Field(ge=0, le=1e9)]
Probability = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1, le=1_000_000)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
LARGEST_SNAPSHOT = 50_000_000  # samples, 0.4 GB


class Frozen(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
