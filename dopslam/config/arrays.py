"""Antenna arrays as a person writes them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from dopslam.config.types import Count, Frozen, Vector3

LARGEST_ARRAY = 4096  # elements
Wavelengths = Annotated[float, Field(ge=1e-3, le=1e4)]
# Of the elements: the same all round, a patch (cosine about its own outward direction), or a dipole along z.
Pattern = Literal["isotropic", "cosine", "dipole"]


class CylinderArray(Frozen):
    """Stacked rings of vertical elements; sees all azimuths without ambiguity."""

    kind: Literal["cylinder"] = "cylinder"
    columns: Count
    rings: Count
    spacing_wavelengths: Wavelengths = 0.5  # along the ring (chord) and between the rings
    pattern: Pattern = "isotropic"


class PlanarArray(Frozen):
    """Uniform rectangular array in its y–z plane, boresight +x.

    Its elements are patches before a reflector unless said otherwise: isotropic ones cannot tell front from back, and a
    path from behind would be taken for one from the front.
    """

    kind: Literal["planar"] = "planar"
    columns: Count
    rows: Count
    spacing_wavelengths: Wavelengths = 0.5
    pattern: Pattern = "cosine"


class CustomArray(Frozen):
    """Arbitrary element positions in wavelengths, in the array's frame."""

    kind: Literal["custom"] = "custom"
    positions_wavelengths: tuple[Vector3, ...] = Field(min_length=1, max_length=LARGEST_ARRAY)


ArrayConfig = Annotated[CylinderArray | PlanarArray | CustomArray, Field(discriminator="kind")]


def elements(array: CylinderArray | PlanarArray | CustomArray) -> int:
    """Number of elements of an array."""
    if isinstance(array, CylinderArray):
        return array.columns * array.rings
    return array.columns * array.rows if isinstance(array, PlanarArray) else len(array.positions_wavelengths)
