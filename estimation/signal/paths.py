"""Path parameters: the public table in angles, and the internal record in unit vectors.

Parameter order everywhere: delay, AOA azimuth, AOA elevation, AOD azimuth, AOD elevation, radial velocity.
AOA in the receiving array's frame, AOD in the transmitting array's frame; the radial velocity is positive
when approaching. The complex gain is the path's amplitude at the carrier frequency and the burst center.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from ..errors import ModelError
from .directions import Float, angles_of, displaced, unit_vectors

PARAMETERS = ("delay", "aoa_az", "aoa_el", "aod_az", "aod_el", "radial_velocity")


@dataclass(frozen=True, eq=False)
class PathTable:
    """P propagation paths.

    Parameters
    ----------
    delay : (P,) [s]
    aoa, aod : (P, 2) azimuth and elevation [rad]
    radial_velocity : (P,) [m/s], positive when approaching
    gain : (P,) complex amplitude
    """

    delay: Float
    aoa: Float
    aod: Float
    radial_velocity: Float
    gain: np.typing.NDArray[Any]  # complex128; what numpy infers is wider

    def __post_init__(self) -> None:
        delay = np.atleast_1d(np.asarray(self.delay, float))
        shapes = {
            "delay": (len(delay),),
            "aoa": (len(delay), 2),
            "aod": (len(delay), 2),
            "radial_velocity": (len(delay),),
            "gain": (len(delay),),
        }
        for name, shape in shapes.items():
            value = np.asarray(getattr(self, name), complex if name == "gain" else float)
            value = value.reshape(shape) if value.size == np.prod(shape) else value
            if value.shape != shape or not np.isfinite(value).all():
                raise ModelError(f"PathTable: {name} must be finite and of shape {shape}, got shape {value.shape}")
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.delay)

    @property
    def vector(self) -> Float:
        """(P, 6) parameters in the common order."""
        return np.column_stack([self.delay, self.aoa, self.aod, self.radial_velocity])

    def take(self, index) -> PathTable:
        """A selection of the paths (index array, mask or slice)."""
        index = np.asarray(index, int) if isinstance(index, list) else index
        return PathTable(*(getattr(self, f.name)[index] for f in fields(self)))

    @property
    def geometry(self) -> Geometry:
        """The same paths with directions as unit vectors, without gains."""
        return Geometry(self.delay, unit_vectors(self.aoa), unit_vectors(self.aod), self.radial_velocity)


@dataclass(frozen=True, eq=False)
class Geometry:
    """The non-linear parameters of P paths: delay (P,) [s], arrival and departure unit vectors (P, 3), speed
    (P,) [m/s].
    """

    delay: Float
    arrival: Float
    departure: Float
    speed: Float

    def __len__(self) -> int:
        return len(self.delay)

    @staticmethod
    def empty() -> Geometry:
        """No path."""
        return Geometry(np.empty(0), np.empty((0, 3)), np.empty((0, 3)), np.empty(0))

    def moved(self, step: Float) -> Geometry:
        """Displaced by ``step`` (P, 6): delay [s], two arrival and two departure tangents [rad], speed [m/s]."""
        return Geometry(
            self.delay + step[:, 0],
            displaced(self.arrival, step[:, 1:3]),
            displaced(self.departure, step[:, 3:5]),
            self.speed + step[:, 5],
        )

    def take(self, index) -> Geometry:
        """The paths selected by an index array, a mask or a slice."""
        return Geometry(*(getattr(self, f.name)[index] for f in fields(self)))

    def joined(self, other: Geometry) -> Geometry:
        """These paths followed by the others."""
        return Geometry(*(np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self)))

    def replaced(self, index: int, path: Geometry) -> Geometry:
        """With path number ``index`` exchanged for a single other one."""
        columns = [getattr(self, f.name).copy() for f in fields(self)]
        for column, f in zip(columns, fields(self), strict=True):
            column[index] = getattr(path, f.name)[0]
        return Geometry(*columns)

    def wrapped(self, period: float) -> Geometry:
        """Delays reduced to [0, period); gains must be solved for again, since a period may flip their sign."""
        return replace(self, delay=np.mod(self.delay, period))

    def table(self, gain) -> PathTable:
        """As a table with angles."""
        return PathTable(self.delay, angles_of(self.arrival), angles_of(self.departure), self.speed, gain)


def tangent_jacobian(geometry: Geometry) -> Float:
    """d(parameters in angles)/d(tangent step), (P, 6): it is diagonal, with 1/cos(el) for the azimuths (inf
    at a pole).
    """
    scale = np.ones((len(geometry), 6))
    for column, vectors in ((1, geometry.arrival), (3, geometry.departure)):
        with np.errstate(divide="ignore"):
            scale[:, column] = 1.0 / np.hypot(vectors[:, 0], vectors[:, 1])
    return scale
