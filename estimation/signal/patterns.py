"""Element patterns, and arrays known by their measured response.

A pattern is a scalar complex gain over direction, in the array's body frame, for one polarization; what a
path does to polarization is part of its complex gain.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from ..errors import ModelError
from .arrays import Complex, Manifold
from .directions import Float, angles_of, unit_vectors
from .directions import tangents as tangents_of
from .observability import Sight, sight_of


@dataclass(frozen=True, eq=False)
class CosinePattern:
    """``max(u . b, 0)^exponent`` about a boresight ``b``: the usual model of a patch (exponent 1 to 2 in
    amplitude).

    Parameters
    ----------
    boresight : (1, 3) common, or (M, 3) one per element (a cylinder's elements look outwards); normalized by
        the constructor
    exponent : of the amplitude; at least 1 keeps the gradient continuous
    """

    boresight: Float = field(default_factory=lambda: np.array([[1.0, 0.0, 0.0]]))
    exponent: float = 1.0

    def __post_init__(self) -> None:
        boresight = np.atleast_2d(np.asarray(self.boresight, float))
        object.__setattr__(self, "boresight", boresight / np.linalg.norm(boresight, axis=1, keepdims=True))

    def gain(self, directions: Float) -> Complex:
        """Gains (P, M or 1)."""
        return np.maximum(directions @ self.boresight.T, 0.0) ** self.exponent + 0j

    def gradient(self, directions: Float) -> Complex:
        """Gradients (P, M or 1, 3)."""
        cosine = directions @ self.boresight.T
        slope = np.where(cosine > 0, self.exponent * np.maximum(cosine, 1e-12) ** (self.exponent - 1), 0.0)
        return slope[:, :, None] * self.boresight + 0j


@dataclass(frozen=True)
class DipolePattern:
    """A short dipole along z: amplitude ``cos(el)``."""

    def gain(self, directions: Float) -> Complex:
        """Gains (P, 1)."""
        return np.hypot(directions[:, 0], directions[:, 1])[:, None] + 0j

    def gradient(self, directions: Float) -> Complex:
        """Gradients (P, 1, 3)."""
        radius = np.maximum(np.hypot(directions[:, 0], directions[:, 1]), 1e-12)
        flat = directions * [1.0, 1.0, 0.0]
        return (flat / radius[:, None])[:, None] + 0j


def outward(array_positions: Float, exponent: float = 1.0) -> CosinePattern:
    """A cosine pattern for each element of a cylinder (or circle) around z, looking away from the axis."""
    boresight = np.asarray(array_positions, float) * [1.0, 1.0, 0.0]
    if np.any(np.linalg.norm(boresight, axis=1) < 1e-9):
        raise ModelError("outward: an element on the axis has no outward direction")
    return CosinePattern(boresight, exponent)


@dataclass(frozen=True, eq=False)
class EadfArray:
    """An array by its effective aperture distribution function: the Fourier series of its measured responses
    over the sphere.

    ``a_m(el, az) = sum_pq G_m[p, q] exp(j p theta) exp(j q az)`` with the co-elevation ``theta = pi/2 - el``
    continued over the pole to a full
    period. Interpolation and derivatives are exact for responses of limited aperture.

    Parameters
    ----------
    coefficients : (M, 2 Lp + 1, 2 Lq + 1) Fourier coefficients, orders centered
    orientation : body-to-parent rotation, or None
    """

    coefficients: Complex
    orientation: Rotation | None = None

    @staticmethod
    def from_samples(responses: Complex, orientation: Rotation | None = None) -> EadfArray:
        """From responses (M, n, 2 n) on the grid ``theta = pi (i + 1/2) / n``, ``az = 2 pi j / (2 n)``; wide
        enough for the aperture.

        A grid of ``n`` co-elevations resolves apertures up to about ``n / (2 pi)`` wavelengths across.
        """
        responses = np.asarray(responses, complex)
        if responses.ndim != 3 or responses.shape[2] != 2 * responses.shape[1]:
            raise ModelError(
                f"EadfArray: responses must be (M, n, 2 n) over co-elevation and azimuth, got {responses.shape}"
            )
        count = responses.shape[1]
        # Beyond the pole theta runs back on the opposite azimuth.
        full = np.concatenate([responses, np.roll(responses[:, ::-1], count, axis=2)], axis=1)
        series = np.fft.fft2(full, axes=(1, 2)) / full[0].size
        order = np.fft.fftfreq(2 * count, 1 / (2 * count))
        series = series * np.exp(-1j * order * np.pi / (2 * count))[:, None]
        half = count - 1
        keep = np.arange(-half, half + 1)
        return EadfArray(series[:, keep][:, :, keep], orientation)

    @staticmethod
    def from_table(responses: Complex, orientation: Rotation | None = None) -> EadfArray:
        """From a table with both poles: responses (M, n + 1, 2 n) at ``theta = pi i / n`` and ``az = 2 pi j / (2 n)``."""
        responses = np.asarray(responses, complex)
        if responses.ndim != 3 or responses.shape[1] < 3 or responses.shape[2] != 2 * (responses.shape[1] - 1):
            raise ModelError(
                "EadfArray: a table with poles must be (M, n + 1, 2 n) over co-elevation 0 to pi and azimuth, got "
                f"{responses.shape}"
            )
        count = responses.shape[1] - 1
        full = np.concatenate([responses, np.roll(responses[:, -2:0:-1], count, axis=2)], axis=1)
        series = np.fft.fft2(full, axes=(1, 2)) / full[0].size
        keep = np.arange(1 - count, count)
        return EadfArray(series[:, keep][:, :, keep], orientation)

    @staticmethod
    def from_array(array: Manifold, count: int = 48) -> EadfArray:
        """Sampled from another array (a simulated calibration)."""
        theta = np.pi * (np.arange(count) + 0.5) / count
        az = np.pi * np.arange(2 * count) / count
        theta, az = np.meshgrid(theta, az, indexing="ij")
        directions = unit_vectors(np.stack([az, np.pi / 2 - theta], axis=-1)).reshape(-1, 3)
        return EadfArray.from_samples(array.response(directions)[0].T.reshape(-1, count, 2 * count))

    @property
    def elements(self) -> int:
        """Number of elements M."""
        return len(self.coefficients)

    @property
    def sight(self) -> Sight:
        """What the array can tell of a direction."""
        return self._sight

    @cached_property
    def _sight(self) -> Sight:
        return sight_of(self)

    @property
    def observable(self) -> tuple[bool, bool]:
        """Whether azimuth and elevation can be told."""
        return self.sight.observable

    def faces(self, directions: Float):
        """Every direction."""
        return np.ones(len(directions), bool)

    def response(self, directions: Float, tangents: Float | None = None, scale: float = 1.0) -> tuple[Complex, Complex]:
        """Responses (P, M) and derivatives (P, 2, M) along the tangents; a measurement at one frequency knows
        no other ``scale``.
        """
        rotation = None if self.orientation is None else self.orientation.as_matrix()
        body = directions if rotation is None else directions @ rotation
        az, el = angles_of(body).T
        rows, columns = ((np.arange(n) - n // 2) for n in self.coefficients.shape[1:])
        over_theta = np.exp(1j * (np.pi / 2 - el)[:, None] * rows)
        over_az = np.exp(1j * az[:, None] * columns)
        inner = np.einsum("mpq,nq->nmp", self.coefficients, over_az, optimize=True)
        value = np.einsum("nmp,np->nm", inner, over_theta)
        if tangents is None:
            return value, np.empty((len(value), 0, self.elements), complex)
        d_el = np.einsum("nmp,np->nm", inner, -1j * rows * over_theta)
        turned = np.einsum("mpq,nq->nmp", self.coefficients, 1j * columns * over_az, optimize=True)
        d_az = np.einsum("nmp,np->nm", turned, over_theta) / np.maximum(np.cos(el), 1e-9)[:, None]
        along = tangents if rotation is None else tangents @ rotation
        mixing = along @ tangents_of(body).swapaxes(-1, -2)
        return value, mixing @ np.stack([d_az, d_el], axis=1)
