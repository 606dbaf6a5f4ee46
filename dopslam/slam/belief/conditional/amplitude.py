"""Amplitude messages in compiled code, and amplitudes that know the spreading loss.

A feature carries its *reference* u·√loss, with the geometric loss d² of a reflecting surface or of the line of sight and
d₁²·d₂² of a point: what is left to walk is antennas and material. With the bare amplitude a scatter point dies when the
receiver drives away, since its amplitude changes by more per step than any walk allows.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dopslam.compute.compiled import compiled
from dopslam.models.amplitude import AmplitudeModel, ConstantDetection, _missed_table
from dopslam.models.detection import TABLE_SIZE, TABLE_START_DB, TABLE_STEP_DB, SnrDetection, detection_table
from dopslam.slam.belief.kernels import LOS, PS

_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(7)
_WEIGHTS = _WEIGHTS / np.sqrt(2 * np.pi)


class AmplitudeTable(NamedTuple):
    """Amplitude statistics as compiled code reads them.

    Attributes
    ----------
    known : whether detections carry amplitudes
    samples : N_s
    step, missed : grid step of u from 0 on, and 1 − p_d(u) on the grid
    share, end : weight and end of the uniform amplitude that lets a feature return
    """

    known: bool
    samples: float
    step: float
    missed: NDArray[np.float64]
    share: float
    end: float


def amplitude_table(
    model: AmplitudeModel | ConstantDetection, detection: SnrDetection | None, share: float, end: float
) -> AmplitudeTable:
    """Tables of an amplitude model; ``detection`` replaces its p_d(u) by that of a search over all path parameters."""
    if isinstance(model, ConstantDetection):
        return AmplitudeTable(False, 1.0, 1.0, np.full(2, 1 - model.probability), 0.0, 1.0)
    grid, missed = _missed_table(model.threshold, model.samples)
    if detection is not None:
        decibel = 20 * np.log10(np.maximum(grid, 1e-6))
        missed = 1 - np.interp(
            decibel, TABLE_START_DB + TABLE_STEP_DB * np.arange(TABLE_SIZE), detection_table(detection)
        )
    return AmplitudeTable(True, float(model.samples), float(grid[1] - grid[0]), missed, float(share), float(end))


@compiled
def log_loss(form, pose, qx, qy, qz, anchor):
    """ln of the geometric loss of a path, [m²] or, for a point, [m⁴]."""
    if form == LOS:
        qx, qy, qz = anchor[0], anchor[1], anchor[2]
    near = (qx - pose[0]) ** 2 + (qy - pose[1]) ** 2 + (qz - pose[2]) ** 2
    loss = math.log(max(near, 1e-6))
    if form == PS:
        far = (qx - anchor[0]) ** 2 + (qy - anchor[1]) ** 2 + (qz - anchor[2]) ** 2
        loss += math.log(max(far, 1e-6))
    return loss


@compiled
def log_losses(form, pose, center, anchor):
    """:func:`log_loss` of rows (R,) at center (R, 3)."""
    out = np.empty(form.shape[0])
    for r in range(form.shape[0]):
        out[r] = log_loss(form[r], pose, center[r, 0], center[r, 1], center[r, 2], anchor)
    return out


@compiled
def missed_at(table, u):
    """1 − p_d(u)."""
    place = abs(u) / table.step
    last = table.missed.shape[0] - 1
    if place >= last:
        return table.missed[last]
    low = int(place)
    share = place - low
    return (1.0 - share) * table.missed[low] + share * table.missed[low + 1]


@compiled
def _log_i0e(x):
    """ln[e^{−x} I₀(x)], relative error of I₀ below 2e-7 (Abramowitz and Stegun 9.8.1, 9.8.2)."""
    if x < 3.75:
        t = (x / 3.75) ** 2
        value = 1.0 + t * (
            3.5156229 + t * (3.0899424 + t * (1.2067492 + t * (0.2659732 + t * (0.0360768 + t * 0.0045813))))
        )
        return math.log(value) - x
    t = 3.75 / x
    value = 0.39894228 + t * (
        0.01328592
        + t
        * (
            0.00225319
            + t
            * (
                -0.00157565
                + t * (0.00916281 + t * (-0.02057706 + t * (0.02635537 + t * (-0.01647633 + t * 0.00392377))))
            )
        )
    )
    return math.log(value) - 0.5 * math.log(x)


@compiled
def detected(table, mean, variance, z, out):
    """ln ∫ Rice(z; u) N(u; mean, variance) du and, in out[0:2], mean and variance of u afterwards.

    Gauss–Hermite nodes sit on the product of prior and likelihood; a uniform amplitude of weight ``share`` is mixed in.
    """
    if not table.known:
        out[0], out[1] = 1.0, 1.0
        return math.log(1.0 - table.missed[0])
    noise = 0.5 + z * z / (4.0 * table.samples)
    precision = 1.0 / variance + 1.0 / noise
    center = (mean / variance + z / noise) / precision
    width = 1.0 / math.sqrt(precision)
    total, first, second, top = 0.0, 0.0, 0.0, -np.inf
    logs = np.empty(7)
    for i in range(7):
        u = max(abs(center + _NODES[i] * width), 1e-3)
        v = 0.5 + u * u / (4.0 * table.samples)
        value = math.log(z / v) - (z - u) ** 2 / (2.0 * v) + _log_i0e(z * u / v)
        value += 0.5 * ((u - center) ** 2 * precision - (u - mean) ** 2 / variance - math.log(variance * precision))
        logs[i] = value
        top = max(top, value)
    for i in range(7):
        u = max(abs(center + _NODES[i] * width), 1e-3)
        w = _WEIGHTS[i] * math.exp(logs[i] - top)
        total += w
        first += w * u
        second += w * u * u
    mean = first / total
    variance = max(second / total - mean * mean, 1e-4)
    evidence = math.log(total) + top
    if table.share > 0.0:
        known = math.log(1.0 - table.share) + evidence
        uniform = math.log(table.share / table.end)
        high, low = max(known, uniform), min(known, uniform)
        evidence = high + math.log(1.0 + math.exp(low - high))
        p = math.exp(known - evidence)
        mixed = p * mean + (1.0 - p) * z
        variance = p * (variance + (mean - mixed) ** 2) + (1.0 - p) * (noise + (z - mixed) ** 2)
        mean = mixed
    out[0], out[1] = mean, variance
    return evidence


@compiled
def undetected(table, mean, variance, out):
    """ln ∫ (1 − p_d(u)) N(u; mean, variance) du and, in out[0:2], mean and variance of u after a miss."""
    if not table.known:
        out[0], out[1] = 1.0, 1.0
        return math.log(table.missed[0])
    total, first, second = 0.0, 0.0, 0.0
    width = math.sqrt(variance)
    for i in range(7):
        u = abs(mean + _NODES[i] * width)
        w = _WEIGHTS[i] * missed_at(table, u)
        total += w
        first += w * u
        second += w * u * u
    out[0] = first / total
    out[1] = max(second / total - out[0] * out[0], 1e-6)
    return math.log(total)


@compiled
def amplitude_messages(table, mean, variance, z):
    """Messages of R rows and M measurements.

    Parameters
    ----------
    mean, variance : (R,) of the rows' amplitudes u; z : (M,)

    Returns
    -------
    log_evidence (R, M + 1) : column 0 missed
    posterior (R, M + 1, 2) : mean and variance of u
    """
    rows, count = mean.shape[0], z.shape[0]
    log_evidence, posterior = np.empty((rows, count + 1)), np.empty((rows, count + 1, 2))
    out = np.empty(2)
    for r in range(rows):
        log_evidence[r, 0] = undetected(table, mean[r], variance[r], out)
        posterior[r, 0, 0], posterior[r, 0, 1] = out[0], out[1]
        for m in range(count):
            log_evidence[r, 1 + m] = detected(table, mean[r], variance[r], z[m], out)
            posterior[r, 1 + m, 0], posterior[r, 1 + m, 1] = out[0], out[1]
    return log_evidence, posterior
