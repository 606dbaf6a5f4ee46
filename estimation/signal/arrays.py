"""Antenna arrays: any element positions, element patterns and an orientation.

The response of element ``m`` to a wave from (or towards) the direction ``u`` is ``a_m(u) = g_m(u) exp(+j 2 pi
p_m . u)`` with its position ``p_m`` in carrier wavelengths and its complex pattern ``g_m``. Eq. (2) of paper
A uses ``a_R`` at the receiver and ``a_T^H`` at the transmitter. One polarization: patterns are scalar, and
the polarimetric transfer of a path is part of its complex gain.

Directions are given in the array's *parent* frame: the frame in which an estimator reports azimuth and
elevation. ``orientation`` rotates the array's body (positions and pattern) into it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
from scipy.spatial.transform import Rotation

from ..errors import ModelError
from .directions import Float
from .observability import Sight, sight_of

Complex = np.typing.NDArray[Any]  # complex128; what numpy infers is wider


@runtime_checkable
class Pattern(Protocol):
    """Complex element gains over direction, in the body frame."""

    def gain(self, directions: Float) -> Complex:
        """Gains (P, M) or (P, 1) towards unit vectors (P, 3)."""
        ...

    def gradient(self, directions: Float) -> Complex:
        """Gradients (P, M or 1, 3) of the gain; only the part tangent to the sphere is used."""
        ...


@runtime_checkable
class Manifold(Protocol):
    """What a signal model needs of an antenna array (:class:`Array`, or a measured one:
    :class:`~estimation.EadfArray`).
    """

    @property
    def elements(self) -> int:
        """Number of elements M."""
        ...

    @property
    def sight(self) -> Sight:
        """What the array can tell of a direction (:func:`~.observability.sight_of`)."""
        ...

    @property
    def observable(self) -> tuple[bool, bool]:
        """Whether azimuth and elevation can be told at all."""
        ...

    def response(self, directions: Float, tangents: Float | None = None, scale: float = 1.0) -> tuple[Complex, Complex]:
        """Steering vectors (P, M) and their derivatives (P, 2, M) along the tangents, at ``scale`` times the
        carrier.
        """
        ...

    def faces(self, directions: Float) -> np.typing.NDArray[np.bool_]:
        """Which directions (P, 3) are in the array's unambiguous view; a planar array sees one half-space."""
        ...


@dataclass(frozen=True, eq=False)
class Array:
    """Elements at known positions, with a pattern and an orientation.

    Parameters
    ----------
    positions : (M, 3) [carrier wavelengths], body frame
    pattern : element pattern, or None for isotropic elements of unit gain
    orientation : body-to-parent rotation, or None for none
    """

    positions: Float
    pattern: Pattern | None = None
    orientation: Rotation | None = None
    _normal: Float | None = field(init=False, repr=False)

    def __post_init__(self) -> None:
        positions = np.atleast_2d(np.asarray(self.positions, float))
        if positions.ndim != 2 or positions.shape[1] != 3 or not positions.size or not np.isfinite(positions).all():
            raise ModelError(
                f"Array: positions must be finite and of shape (M, 3) in wavelengths, got shape {positions.shape}"
            )
        object.__setattr__(self, "positions", positions)
        spread, axes = np.linalg.svd(positions - positions.mean(axis=0), full_matrices=True)[1:]
        rank = int(np.sum(spread > 1e-6))
        # A planar array cannot tell its two sides apart: it faces the side of +x (then +y, +z) of its body.
        normal = None
        if rank == 2:
            normal = axes[2] * (np.sign(axes[2][np.flatnonzero(np.abs(axes[2]) > 1e-9)[0]]))
        object.__setattr__(self, "_normal", normal)

    @property
    def elements(self) -> int:
        """Number of elements M."""
        return len(self.positions)

    @property
    def normal(self) -> Float | None:
        """Where a planar array faces (3,), in the parent frame; None for any other."""
        return None if self._normal is None else self._to_parent(self._normal)

    @property
    def sight(self) -> Sight:
        """What the array can tell of a direction."""
        return self._sight

    @cached_property
    def _sight(self) -> Sight:
        return sight_of(self)

    @property
    def observable(self) -> tuple[bool, bool]:
        """Whether azimuth and elevation can be told: a linear array along z gives elevation only, any other
        line azimuth only.
        """
        return self.sight.observable

    def faces(self, directions: Float) -> np.typing.NDArray[np.bool_]:
        """Which directions (P, 3) the array can see without ambiguity (a planar array: its own half-space)."""
        if self._normal is None:
            return np.ones(len(directions), bool)
        return self._to_body(directions) @ self._normal > 1e-9

    def steering(self, directions: Float, scale: float = 1.0) -> Complex:
        """Responses (P, M) towards unit vectors (P, 3), at ``scale`` times the carrier frequency."""
        return self.response(directions, None, scale)[0]

    def response(self, directions: Float, tangents: Float | None = None, scale: float = 1.0) -> tuple[Complex, Complex]:
        """Steering vectors (P, M), and their derivatives (P, 2, M) along the tangents (P, 2, 3) if these are
        given.
        """
        body = self._to_body(directions)
        phase = np.exp(2j * np.pi * scale * (body @ self.positions.T))
        gain = np.ones((1, 1)) if self.pattern is None else self.pattern.gain(body)
        steering = gain * phase
        if tangents is None:
            return steering, np.empty((len(steering), 0, self.elements), complex)
        along = self._to_body(tangents.reshape(-1, 3)).reshape(tangents.shape)
        derivative = (2j * np.pi * scale) * (along @ self.positions.T) * steering[:, None]
        if self.pattern is not None:
            slope = np.einsum("pmi,pti->ptm", self.pattern.gradient(body), along)
            derivative = derivative + slope * phase[:, None]
        return steering, derivative

    def _to_body(self, vectors: Float) -> Float:
        return vectors if self.orientation is None else vectors @ self.orientation.as_matrix()

    def _to_parent(self, vectors: Float) -> Float:
        return vectors if self.orientation is None else vectors @ self.orientation.as_matrix().T


@dataclass(frozen=True, eq=False)
class Through:
    """An array seen through a matrix (M', M) that is applied to its elements: a network behind it, or what makes its noise
    white.
    """

    array: Manifold
    matrix: Complex

    @property
    def elements(self) -> int:
        """Number of outputs M'."""
        return len(self.matrix)

    @property
    def normal(self) -> Float | None:
        """As the array's own."""
        return getattr(self.array, "normal", None)

    @property
    def sight(self) -> Sight:
        """What the array can tell of a direction."""
        return self.array.sight

    @property
    def observable(self) -> tuple[bool, bool]:
        """Whether azimuth and elevation can be told."""
        return self.array.observable

    def faces(self, directions: Float) -> np.typing.NDArray[np.bool_]:
        """Which directions (P, 3) the array can see without ambiguity."""
        return self.array.faces(directions)

    def response(self, directions: Float, tangents: Float | None = None, scale: float = 1.0) -> tuple[Complex, Complex]:
        """Responses (P, M') and derivatives (P, 2, M') along the tangents."""
        steering, derivative = self.array.response(directions, tangents, scale)
        return steering @ self.matrix.T, derivative @ self.matrix.T


def mirror_of(array: Manifold) -> Float | None:
    """(3,) normal of the plane at which reflected directions may look the same: where a planar array or a line of
    elements faces; None for any other.
    """
    return array.sight.side if array.sight.axis is not None else getattr(array, "normal", None)


def ula(count: int, spacing: float = 0.5, **options) -> Array:
    """Uniform linear array along y, ``spacing`` in wavelengths; it tells azimuth only (elevation is taken as
    0).
    """
    y = spacing * (np.arange(count) - (count - 1) / 2)
    return Array(np.stack([0 * y, y, 0 * y], axis=1), **options)


def ura(rows: int, columns: int, spacing: float = 0.5, **options) -> Array:
    """Uniform rectangular array in the y-z plane facing +x: ``rows`` along z, ``columns`` along y; element =
    row * columns + column.
    """
    z, y = np.meshgrid(np.arange(rows) - (rows - 1) / 2, np.arange(columns) - (columns - 1) / 2, indexing="ij")
    return Array(spacing * np.stack([0 * y, y, z], axis=-1).reshape(-1, 3), **options)


def cylinder(columns: int, rings: int, radius: float | None = None, spacing: float = 0.5, **options) -> Array:
    """Cylindrical array around z: ``columns`` round each of ``rings`` circles; element = ring * columns +
    column.

    ``spacing`` [wavelengths] is the chord between neighboring columns (unless ``radius`` is given) and the
    height between rings.
    Sixteen columns give a radius of 1.281, eight one of 0.653 wavelengths.
    """
    if radius is None:
        radius = spacing / (2 * np.sin(np.pi / columns)) if columns > 1 else 0.0
    az = 2 * np.pi * np.arange(columns) / columns
    heights = spacing * (np.arange(rings) - (rings - 1) / 2)
    height, az = (a.ravel() for a in np.meshgrid(heights, az, indexing="ij"))
    return Array(np.stack([radius * np.cos(az), radius * np.sin(az), height], axis=-1), **options)
