"""Path lengths and directions of the likelihood forms, with gradients; broadcasts over particles and
features.

p receiver, q feature, p_a anchor (all (..., 3), m), e = (q − p)/‖q − p‖ arrival, n = (q − p_a)/‖q − p_a‖:

* LOS     length ‖p_a − p‖, departure −e (q = p_a);
* VA      length ‖q − p‖;
* VA_AOD  the same, departure t = −e + 2(eᵀn)n, the arrival mirrored at the wall with normal n;
* PS      length ‖q − p‖ + ‖q − p_a‖, departure n.

Directions are compared by chords: for a measured z and a predicted e the residual is T(e)z·√(2/(1 + zᵀe)),
whose norm is the chord ‖z − e‖, with T the orthonormal azimuth (and elevation) tangents at e; no wrapping, no
poles.
"""

from __future__ import annotations

import numpy as np

from dopslam.slam.belief.records import Form

_TINY = 1e-12


def _unit(vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    norm = np.maximum(np.linalg.norm(vector, axis=-1, keepdims=True), _TINY)
    return vector / norm, norm


def predict(form: Form, p: np.ndarray, q: np.ndarray, anchor: np.ndarray):
    """Length (...,) [m], arrival (..., 3) and departure (..., 3), unit vectors in the world frame."""
    e, r = _unit(q - p)
    if form == Form.LOS:
        return r[..., 0], e, -e
    n, reach = _unit(q - anchor)
    if form == Form.PS:
        return (r + reach)[..., 0], e, n + 0 * e
    return r[..., 0], e, -e + 2 * np.sum(e * n, axis=-1, keepdims=True) * n


def gradients(form: Form, p: np.ndarray, q: np.ndarray, anchor: np.ndarray):
    """∂(length, arrival, departure)/∂q and /∂p.

    Returns
    -------
    by_q, by_p : (..., 7, 3) rows length, arrival x y z, departure x y z; for LOS the feature is fixed and
        by_q is 0
    """
    e, r = _unit(q - p)
    n, reach = _unit(q - anchor)
    eye = np.eye(3)
    de = (eye - e[..., :, None] * e[..., None, :]) / r[..., None]
    dn = (eye - n[..., :, None] * n[..., None, :]) / reach[..., None]
    zero = np.zeros(np.broadcast_shapes(de.shape, dn.shape))
    length_q, departure_q, departure_p = e, zero, zero
    if form == Form.LOS:
        departure_p = de
    elif form == Form.PS:
        length_q, departure_q = e + n, zero + dn
    else:
        en = np.sum(e * n, axis=-1)[..., None, None]
        mirror = -eye + 2 * n[..., :, None] * n[..., None, :]  # ∂t/∂e
        turn = 2 * (n[..., :, None] * e[..., None, :] + en * eye)  # ∂t/∂n
        departure_q = mirror @ de + turn @ dn
        departure_p = -mirror @ de
    by_q = np.concatenate([(zero[..., 0, :] + length_q)[..., None, :], zero + de, departure_q], axis=-2)
    by_p = np.concatenate([(zero[..., 0, :] - e)[..., None, :], zero - de, departure_p], axis=-2)
    return (np.zeros_like(by_q) if form == Form.LOS else by_q), by_p


def tangents(direction: np.ndarray, count: int) -> np.ndarray:
    """(..., count, 3) orthonormal tangents at unit vectors: towards rising azimuth, then rising elevation."""
    flat = np.hypot(direction[..., 0], direction[..., 1])
    pole = flat < 1e-9  # any basis serves there
    scale = np.where(pole, 1.0, flat)
    azimuth = np.stack(
        [
            -direction[..., 1] / scale,
            np.where(pole, 1.0, direction[..., 0] / scale),
            np.zeros(direction.shape[:-1]),
        ],
        axis=-1,
    )
    if count == 1:
        return azimuth[..., None, :]
    return np.stack([azimuth, np.cross(direction, azimuth)], axis=-2)


def chord(measured: np.ndarray, predicted: np.ndarray, count: int) -> np.ndarray:
    """(..., count) residual of a measured direction in the tangents of the predicted one; its norm is the chord."""
    basis = tangents(predicted, count)
    cosine = np.sum(measured * predicted, axis=-1)
    stretch = np.sqrt(2 / np.maximum(1 + cosine, _TINY))
    return np.einsum("...ji,...i->...j", basis, np.broadcast_to(measured, predicted.shape)) * stretch[..., None]


def turned(vector: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Vectors rotated about z by the angle [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    x, y = vector[..., 0], vector[..., 1]
    return np.stack([c * x - s * y, s * x + c * y, vector[..., 2] + 0 * c], axis=-1)


def unit_vector(azimuth: np.ndarray, elevation: np.ndarray | float = 0.0) -> np.ndarray:
    """(..., 3) unit vector of azimuth and elevation [rad]."""
    azimuth, elevation = np.broadcast_arrays(azimuth, elevation)
    return np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
    )
