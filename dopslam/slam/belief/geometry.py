"""Path lengths and directions of the likelihood forms, with gradients; broadcasts over particles and
features.

p receiver, q feature, p_a anchor (all (..., 3), m). A form is the path of a kind of landmark
(:data:`dopslam.models.paths.PATHS`): LOS of the base station, VA and VA_AOD of a reflecting surface, PS of a scatter point;
they differ in what they are compared with.

Directions are compared by chords: for a measured z and a predicted e the residual is T(e)z·√(2/(1 + zᵀe)),
whose norm is the chord ‖z − e‖, with T the orthonormal azimuth (and elevation) tangents at e; no wrapping, no
poles.
"""

from __future__ import annotations

import numpy as np

from dopslam.models.measurement import directions
from dopslam.models.paths import PATHS
from dopslam.records import Kind
from dopslam.slam.belief.records import Form

_TINY = 1e-12


def _unit(vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    norm = np.maximum(np.linalg.norm(vector, axis=-1, keepdims=True), _TINY)
    return vector / norm, norm


_LAWS = {Form.LOS: Kind.BS, Form.VA: Kind.VA, Form.PS: Kind.SP, Form.VA_AOD: Kind.VA}


def predict(form: Form, p: np.ndarray, q: np.ndarray, anchor: np.ndarray):
    """Length (...,) [m], arrival (..., 3) and departure (..., 3), unit vectors in the world frame."""
    p, q, anchor = np.broadcast_arrays(p, q, anchor)
    path = PATHS[_LAWS[form]].path(p, anchor, q)
    return path.length, _unit(q - p)[0], _unit(path.departure)[0]


def gradients(form: Form, p: np.ndarray, q: np.ndarray, anchor: np.ndarray):
    """∂(length, arrival, departure)/∂q and /∂p.

    Returns
    -------
    by_q, by_p : (..., 7, 3) rows length, arrival x y z, departure x y z; for LOS the feature is fixed and
        by_q is 0
    """
    p, q, anchor = np.broadcast_arrays(p, q, anchor)
    law = PATHS[_LAWS[form]]
    slopes, arriving = law.slopes(p, anchor, q), _turn(q - p)
    leaving = _turn(law.path(p, anchor, q).departure)
    by_q = [slopes.length_by_x[..., None, :], arriving, leaving @ slopes.departure_by_x]
    by_p = [slopes.length_by_p[..., None, :], -arriving, leaving @ slopes.departure_by_p]
    rows = np.concatenate(by_q, axis=-2), np.concatenate(by_p, axis=-2)
    return (np.zeros_like(rows[0]) if law.known else rows[0]), rows[1]


def _turn(vector: np.ndarray) -> np.ndarray:
    """Derivative (..., 3, 3) of the unit vector of a vector."""
    unit, norm = _unit(vector)
    return (np.eye(3) - unit[..., :, None] * unit[..., None, :]) / norm[..., None]


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
    return directions(azimuth, elevation)
