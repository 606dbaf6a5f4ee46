"""Linearization of one measurement around a Gaussian: Taylor (EK) or cubature points, one signature.

Both return h(s, x) ≈ ẑ + A (s - ŝ) + B (x - x̂) + e, e ~ N(0, Ω); Taylor has Ω = 0. Iterating means calling
it again around the updated Gaussian.
"""

from __future__ import annotations

import math

import numpy as np

from dopslam.compute.compiled import clear, compiled
from dopslam.compute.linalg import cholesky
from dopslam.models.kernels import linearize, predict_measurement, subtract
from dopslam.slam.pmb.density import start_of


@compiled
def linearize_block(mean, covariance, n, block, kind, model, z, by_state, by_landmark, extra):
    """ẑ, A, B, Ω of one block (0 for the BS) into `z`, `by_state`, `by_landmark`, `extra`; False if no path
    exists.
    """
    state = mean[:n]
    landmark = mean[start_of(n, block) : start_of(n, block) + 3] if block > 0 else mean[:3]
    valid = linearize(state, landmark, kind, model.site, z, by_state, by_landmark)
    clear(extra)
    if model.cubature and valid:
        cubature(mean, covariance, n, block, kind, model, z, by_state, by_landmark, extra)
    return valid


@compiled
def cubature(mean, covariance, n, block, kind, model, z, by_state, by_landmark, extra):
    """Replace the Taylor expansion by statistical linear regression on 2d cubature points."""
    rows = z.shape[0]
    d = n + 3 if block > 0 else n
    index = np.empty(d, dtype=np.int64)
    for i in range(n):
        index[i] = i
    for i in range(n, d):
        index[i] = start_of(n, block) + i - n
    factor = np.empty((d, d))
    for i in range(d):
        for j in range(d):
            factor[i, j] = covariance[index[i], index[j]]
    for i in range(d):  # speed and turn rate may be known exactly
        factor[i, i] += 1e-15 * (1.0 + factor[i, i])
    if not cholesky(factor, d):
        return
    center = z.copy()
    scale = math.sqrt(d)
    point = np.empty(d)
    landmark = np.zeros(3)
    deviation = np.empty((2 * d, rows))
    at_point = np.empty(rows)
    for c in range(2 * d):
        column = c % d
        sign = scale if c < d else -scale
        for i in range(d):
            point[i] = mean[index[i]] + (sign * factor[i, column] if i >= column else 0.0)
        for i in range(n, d):
            landmark[i - n] = point[i]
        predict_measurement(point[:n], landmark, kind, model.site, at_point)
        subtract(at_point, center, by_landmark, by_state, deviation[c])
    average = np.zeros(rows)
    for c in range(2 * d):
        for i in range(rows):
            average[i] += deviation[c, i] / (2 * d)
    slope = np.empty((d, rows))  # M with Ψ = L M, so that [A B] = Mᵀ L⁻¹
    for i in range(d):
        for j in range(rows):
            slope[i, j] = (deviation[i, j] - deviation[d + i, j]) * scale / (2 * d)
    for i in range(rows):
        for j in range(rows):
            value = 0.0
            for c in range(2 * d):
                value += (deviation[c, i] - average[i]) * (deviation[c, j] - average[j]) / (2 * d)
            for c in range(d):
                value -= slope[c, i] * slope[c, j]
            extra[i, j] = value
    for j in range(rows):
        z[j] = center[j] + average[j]
        for i in range(d - 1, -1, -1):  # back substitution Lᵀ h = m
            value = slope[i, j]
            for k in range(i + 1, d):
                value -= factor[k, i] * slope[k, j]
            slope[i, j] = value / factor[i, i]
        for i in range(n):
            by_state[j, i] = slope[i, j]
        for i in range(n, d):
            by_landmark[j, i - n] = slope[i, j]


@compiled
def project_rows(covariance, n, block, by_state, by_landmark, out):
    """out = H P (m, D) for the measurement of one block, H = [A 0 … B … 0]."""
    rows = by_state.shape[0]
    size = covariance.shape[0]
    start = start_of(n, block)
    clear(out)
    for i in range(rows):
        for k in range(n):
            a = by_state[i, k]
            if a != 0.0:
                for j in range(size):
                    out[i, j] += a * covariance[k, j]
        if block > 0:
            for k in range(3):
                b = by_landmark[i, k]
                if b != 0.0:
                    for j in range(size):
                        out[i, j] += b * covariance[start + k, j]


@compiled
def innovation_covariance(projected, n, block, by_state, by_landmark, noise, out):
    """out = H P Hᵀ + R from projected = H P."""
    rows = by_state.shape[0]
    start = start_of(n, block)
    for i in range(rows):
        for j in range(rows):
            value = noise[i, j]
            for k in range(n):
                value += projected[i, k] * by_state[j, k]
            if block > 0:
                for k in range(3):
                    value += projected[i, start + k] * by_landmark[j, k]
            out[i, j] = value
