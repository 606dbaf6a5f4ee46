"""Small operations on weighted particles and amplitude beliefs."""

from __future__ import annotations

import numpy as np
from scipy.special import i0e

from dopslam.models.amplitude import AmplitudeModel, ConstantDetection

_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(7)
_WEIGHTS = _WEIGHTS / np.sqrt(2 * np.pi)


def normalized(log_weight: np.ndarray) -> np.ndarray:
    """Weights that sum to one, from logs along the last axis."""
    weight = np.exp(log_weight - log_weight.max(axis=-1, keepdims=True))
    return weight / weight.sum(axis=-1, keepdims=True)


def effective_size(weight: np.ndarray) -> float:
    """1/Σw² of normalized weights."""
    return float(1.0 / np.sum(weight**2))


def systematic(rng: np.random.Generator, weight: np.ndarray, size: int) -> np.ndarray:
    """Indices of systematic resampling, (size,), ascending."""
    points = (rng.random() + np.arange(size)) / size
    return np.minimum(np.searchsorted(np.cumsum(weight), points), len(weight) - 1)


def kernel_jitter(rng: np.random.Generator, coordinates: np.ndarray, width: float) -> np.ndarray:
    """Equally weighted particles shrunk towards their mean and smeared, mean and covariance kept (Liu and
    West).

    coordinates : (N, c); directions without spread stay without.
    """
    mean = coordinates.mean(axis=0)
    centered = coordinates - mean
    values, vectors = np.linalg.eigh(centered.T @ centered / len(coordinates))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    noise = rng.standard_normal(coordinates.shape) @ root.T
    return mean + np.sqrt(1 - width**2) * centered + width * noise


def amplitude_messages(
    model: AmplitudeModel | ConstantDetection, mean: np.ndarray, variance: np.ndarray, z: np.ndarray
):
    """Amplitude evidence and posterior of Gaussian amplitudes u_k ~ N(mean, variance).

    Gauss–Hermite nodes sit on the product of prior and likelihood, so a wide prior after a blockage costs
    nothing.

    Returns
    -------
    log_evidence (K, M) : ln ∫ Rice(z_m; u) N(u) du, i.e. ln ∫ p_d(u) f(z_m|u) N(u) du
    post_mean, post_variance (K, M) : given that measurement m is the feature's
    log_missed (K,), missed_mean, missed_variance (K,) : the same for a missed detection, 1 − p_d(u)
    """
    if isinstance(model, ConstantDetection):
        shape, same = (len(mean), len(z)), np.ones(len(mean))
        missed = np.log(model.missed_probability(mean))
        log_detected = np.full(shape, np.log(model.probability))
        return log_detected, np.ones(shape), np.ones(shape), missed, same, same
    mean, variance = mean[:, None], variance[:, None]
    noise = model.variance(z)[None, :]
    precision = 1 / variance + 1 / noise
    center = (mean / variance + z / noise) / precision
    u = np.maximum(np.abs(center[..., None] + _NODES / np.sqrt(precision)[..., None]), 1e-3)
    v = model.variance(u)
    zz = z[None, :, None]
    log_f = (
        np.log(zz / v) - (zz - u) ** 2 / (2 * v) + np.log(i0e(zz * u / v))
        - 0.5 * (u - mean[..., None]) ** 2 / variance[..., None] - 0.5 * np.log(variance * precision)[..., None]
        + 0.5 * (u - center[..., None]) ** 2 * precision[..., None]
    )  # fmt: skip
    top = log_f.max(axis=-1, keepdims=True)
    weight = _WEIGHTS * np.exp(log_f - top)
    total = weight.sum(axis=-1)
    post_mean = (weight * u).sum(axis=-1) / total
    post_variance = (weight * u**2).sum(axis=-1) / total - post_mean**2
    log_evidence = np.log(total) + top[..., 0]
    u = np.abs(mean + _NODES * np.sqrt(variance))
    missed = _WEIGHTS * model.missed_probability(u)
    total = missed.sum(axis=-1)
    missed_mean = (missed * u).sum(axis=-1) / total
    missed_variance = (missed * u**2).sum(axis=-1) / total - missed_mean**2
    return (
        log_evidence,
        post_mean,
        np.maximum(post_variance, 1e-4),
        np.log(total),
        missed_mean,
        missed_variance,
    )
