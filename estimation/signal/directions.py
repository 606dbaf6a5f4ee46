"""Directions: angles, unit vectors and the tangent coordinates in which directions are refined.

Azimuth ``az = atan2(y, x)``, elevation ``el = asin(z)`` [rad] of a unit vector. Small displacements are
expressed along the orthonormal tangents ``e_az`` and ``e_el``, so that ``d u = e_az d1 + e_el d2`` with ``d1
= cos(el) d az`` and ``d2 = d el``: unlike azimuth itself they stay regular at the poles.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[Any]  # float64; what numpy infers is wider


def unit_vectors(angles: ArrayLike) -> Float:
    """Unit vectors (..., 3) of (azimuth, elevation) pairs (..., 2) [rad]."""
    az, el = np.moveaxis(np.asarray(angles, float), -1, 0)
    return np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)], axis=-1)


def angles_of(vectors: ArrayLike) -> Float:
    """(azimuth, elevation) (..., 2) [rad] of vectors (..., 3) of any length; azimuth 0 at the poles."""
    x, y, z = np.moveaxis(np.asarray(vectors, float), -1, 0)
    return np.stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))], axis=-1)


def tangents(vectors: Float) -> Float:
    """Orthonormal tangents (..., 2, 3), along increasing azimuth and elevation, at unit vectors (..., 3)."""
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    radius = np.hypot(x, y)
    # At a pole azimuth counts from x.
    pole = radius < 1e-300
    safe = radius + pole
    cosine, sine = x / safe + pole, y / safe
    out = np.zeros((*vectors.shape[:-1], 2, 3))
    out[..., 0, 0], out[..., 0, 1] = -sine, cosine
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = -z * cosine, -z * sine, radius
    return out


def displaced(vectors: Float, step: Float) -> Float:
    """Unit vectors (..., 3) reached from ``vectors`` by tangent displacements ``step`` (..., 2) [rad]."""
    moved = vectors + (step[..., None, :] @ tangents(vectors))[..., 0, :]
    return moved / np.sqrt(np.sum(moved * moved, axis=-1, keepdims=True))


def sphere(count: int) -> Float:
    """``count`` nearly uniform directions (count, 3) on the sphere (Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    az = np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - z**2)
    return np.stack([r * np.cos(az), r * np.sin(az), z], axis=-1)
