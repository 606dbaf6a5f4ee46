"""Compiled loops over detections: residuals and Jacobians, and how well landmarks explain them.

The measurement law is that of `models.kernels`. A `site` is (x, y, z of the base station, height of the receiver, speed).
"""

from __future__ import annotations

import math

import numpy as np

from dopslam.compute.compiled import compiled
from dopslam.compute.linalg import cholesky, solve_lower
from dopslam.models.kernels import SR, linearize, subtract

ROWS = 6


@compiled
def one_row(z, used, state, kind, position, site, error, by_state, by_point, predicted):
    """Residual and Jacobians of one detection, zero in the rows that say nothing; whether the path can exist."""
    valid = linearize(state, position, kind, site, predicted, by_state, by_point)
    subtract(z, predicted, by_point, by_state, error)
    for i in range(ROWS):
        if not used[i] or (kind == SR and (i == 3 or i == 4)):
            error[i] = 0.0
            for j in range(by_state.shape[1]):
                by_state[i, j] = 0.0
            for j in range(3):
                by_point[i, j] = 0.0
    return valid


@compiled
def linearize_rows(z, used, state, kind, position, station, height, speed):
    """Residuals (M, 6) and Jacobians (M, 6, n), (M, 6, 3) of M detections."""
    count, n = state.shape
    error = np.empty((count, ROWS))
    by_state, by_point = np.empty((count, ROWS, n)), np.empty((count, ROWS, 3))
    predicted = np.empty(ROWS)
    for m in range(count):
        site = (station[m, 0], station[m, 1], station[m, 2], height, speed)
        one_row(z[m], used[m], state[m], kind[m], position[m], site, error[m], by_state[m], by_point[m], predicted)
    return error, by_state, by_point


@compiled
def explain_rows(
    rows, group, z, covariance, used, span, step, state, spread, anchor, stations, height, speed, kind, position,
    place, scale, share,
):  # fmt: skip
    """How landmarks explain detections, the track being uncertain.

    Parameters
    ----------
    rows, group : (M,) int arrays; detection and landmark of each pair
    z, covariance, used, anchor, step : (N, ...) of all detections; span : (6,)
    state, spread : (K, n), (K, n, n) of the track at the scans
    kind, position, place : (G,), (G, 3), (G, 3, 3) of the landmarks, place their covariance
    scale, share : (C,) arrays

    Returns
    -------
    density : (M,) log p(z); −inf where the path cannot exist
    square, weight : (M,)
    information, vector : (G, 3, 3), (G, 3); normal equations of the landmarks' places
    """
    count, n = rows.shape[0], state.shape[1]
    density, square, weight = np.empty(count), np.empty(count), np.empty(count)
    information, vector = np.zeros((kind.shape[0], 3, 3)), np.zeros((kind.shape[0], 3))
    predicted, error = np.empty(ROWS), np.empty(ROWS)
    by_state, by_point = np.empty((ROWS, n)), np.empty((ROWS, 3))
    matrix, columns = np.empty((ROWS, ROWS)), np.empty((ROWS, 4))
    term = np.empty(scale.shape[0])
    for m in range(count):
        r, g = rows[m], group[m]
        s, a = step[r], anchor[r]
        site = (stations[a, 0], stations[a, 1], stations[a, 2], height, speed)
        valid = one_row(z[r], used[r], state[s], kind[g], position[g], site, error, by_state, by_point, predicted)
        lost, size = 0.0, 0
        for i in range(ROWS):
            hidden = kind[g] == SR and (i == 3 or i == 4)
            if hidden and used[r, i]:
                lost += math.log(span[i])
            if used[r, i] and not hidden:
                size += 1
                for j in range(i + 1):
                    value = 0.0
                    if used[r, j] and not (kind[g] == SR and (j == 3 or j == 4)):
                        value = covariance[r, i, j]
                        for b in range(n):
                            if by_state[i, b] != 0.0:
                                for c in range(n):
                                    value += by_state[i, b] * spread[s, b, c] * by_state[j, c]
                        for b in range(3):
                            for c in range(3):
                                value += by_point[i, b] * place[g, b, c] * by_point[j, c]
                    matrix[i, j] = value
            else:
                for j in range(i):
                    matrix[i, j] = 0.0
                matrix[i, i] = 1.0
        for i in range(ROWS):
            columns[i, 0] = error[i]
            for j in range(3):
                columns[i, 1 + j] = by_point[i, j]
        if not cholesky(matrix, ROWS):
            density[m], square[m], weight[m] = -np.inf, np.inf, 0.0
            continue
        solve_lower(matrix, ROWS, columns)
        length, logs = 0.0, 0.0
        for i in range(ROWS):
            length += columns[i, 0] * columns[i, 0]
            logs += math.log(matrix[i, i])
        top = -np.inf
        for c in range(scale.shape[0]):
            term[c] = math.log(share[c]) - 0.5 * length / scale[c] - 0.5 * size * math.log(scale[c])
            top = max(top, term[c])
        total, mean = 0.0, 0.0
        for c in range(scale.shape[0]):
            part = math.exp(term[c] - top)
            total += part
            mean += part / scale[c]
        square[m], weight[m] = length, mean / total
        density[m] = top + math.log(total) - logs - 0.5 * size * math.log(2 * math.pi) - lost
        if not valid:
            density[m] = -np.inf
        for i in range(ROWS):
            for j in range(3):
                w = columns[i, 1 + j] * weight[m]
                if w != 0.0:
                    vector[g, j] += w * columns[i, 0]
                    for c in range(3):
                        information[g, j, c] += w * columns[i, 1 + c]
    return density, square, weight, information, vector
