"""Nonlinear least squares over a window of UE states and landmarks, in information form.

Variables are ordered s_tail … s_now, x_1 … x_H. Costs are squared Mahalanobis lengths of the motion (1), of
the measurements (3) and of a Gaussian prior over (s_tail, x_1 … x_H).
"""

from __future__ import annotations

import numpy as np

from dopslam.compiled import compiled
from dopslam.models.kernels import cholesky, linearize, propagate_state, solve_lower, subtract

CONVERGED = 1e-3  # squared Mahalanobis length of a Gauss-Newton step


@compiled
def cholesky_upper(matrix, size):
    """Upper factor U, UᵀU = matrix, in the upper triangle, by whole rows; False if not definite."""
    for j in range(size):
        pivot = matrix[j, j]
        if not pivot > 0.0:
            return False
        scale = 1.0 / np.sqrt(pivot)
        for k in range(j, size):
            matrix[j, k] *= scale
        for i in range(j + 1, size):
            w = matrix[j, i]
            if w != 0.0:
                for k in range(i, size):
                    matrix[i, k] -= w * matrix[j, k]
    return True


@compiled
def add_motion(information, vector, at, states, j, weight, model, vectors_only_cost):
    """Add ‖s_{j+1} - f(s_j)‖² to the normal equations, s_j at row `at`; returns its cost."""
    n = states.shape[1]
    jacobian = np.empty((n, n))
    predicted = propagate_state(states[j], model.interval, model.site[4], model.turn_rate, jacobian)
    error = states[j + 1] - predicted
    cost = 0.0
    for a in range(n):
        for b in range(n):
            cost += error[a] * weight[a, b] * error[b]
    if vectors_only_cost:
        return cost
    # residual s' - f(s) ≈ (s' - F s) - c with c = f(s0) - F s0
    constant = predicted - jacobian @ states[j]
    tied = weight @ jacobian
    both = jacobian.T @ tied
    pull = weight @ constant
    back = jacobian.T @ pull
    for a in range(n):
        vector[at + a] -= back[a]
        vector[at + n + a] += pull[a]
        for b in range(n):
            information[at + a, at + b] += both[a, b]
            information[at + n + a, at + n + b] += weight[a, b]
            information[at + n + a, at + b] -= tied[a, b]
            information[at + a, at + n + b] -= tied[b, a]
    return cost


@compiled
def add_measurement(information, vector, at, start, state, landmark, kind, z, whitener, model, only_cost):
    """Add ‖L⁻¹(z - h(s, x))‖² to the normal equations, s at row `at`, x at row `start` (-1: BS); returns its
    cost.
    """
    m, n = z.shape[0], state.shape[0]
    predicted, nu = np.empty(m), np.empty(m)
    by_state, by_landmark = np.empty((m, n)), np.empty((m, 3))
    linearize(state, landmark, kind, model.site, predicted, by_state, by_landmark)
    subtract(z, predicted, by_landmark, by_state, nu)
    d = n + 3 if start >= 0 else n
    white = np.zeros((m, d + 1))
    for i in range(m):
        for k in range(i + 1):
            w = whitener[i, k]
            if w != 0.0:
                for j in range(n):
                    white[i, j] += w * by_state[k, j]
                for j in range(n, d):
                    white[i, j] += w * by_landmark[k, j - n]
                white[i, d] += w * nu[k]
    cost = 0.0
    for i in range(m):
        cost += white[i, d] * white[i, d]
    if only_cost:
        return cost
    for i in range(m):  # J x0 + ν: the measurement as seen from the origin
        for j in range(n):
            white[i, d] += white[i, j] * state[j]
        for j in range(n, d):
            white[i, d] += white[i, j] * landmark[j - n]
    for a in range(d):
        row = at + a if a < n else start + a - n
        for i in range(m):
            vector[row] += white[i, a] * white[i, d]
        for b in range(d):
            column = at + b if b < n else start + b - n
            value = 0.0
            for i in range(m):
                value += white[i, a] * white[i, b]
            information[row, column] += value
    return cost


@compiled
def build(
    prior_information,
    prior_vector,
    states,
    landmarks,
    kinds,
    when,
    which,
    z,
    whiteners,
    weight,
    model,
    only_cost,
):
    """Normal equations Λ x = η of the window linearized at (states, landmarks), and the cost there.

    Variables are ordered s_tail … s_now, x_1 … x_H; the prior is over (s_tail, x_1 … x_H).
    """
    window, n = states.shape
    count = landmarks.shape[0]
    base = window * n
    size = base + 3 * count
    information, vector = np.zeros((size, size)), np.zeros(size)
    index = np.empty(n + 3 * count, dtype=np.int64)
    value = np.empty(n + 3 * count)
    for i in range(n):
        index[i], value[i] = i, states[0, i]
    for i in range(3 * count):
        index[n + i], value[n + i] = base + i, landmarks[i // 3, i % 3]
    cost = 0.0
    for i in range(index.shape[0]):
        vector[index[i]] += prior_vector[i]
        cost -= 2.0 * prior_vector[i] * value[i]
        for j in range(index.shape[0]):
            information[index[i], index[j]] += prior_information[i, j]
            cost += value[i] * prior_information[i, j] * value[j]
    for j in range(window - 1):
        cost += add_motion(information, vector, j * n, states, j, weight, model, only_cost)
    nowhere = np.zeros(3)
    for f in range(when.shape[0]):
        h = which[f]
        cost += add_measurement(
            information,
            vector,
            when[f] * n,
            base + 3 * h if h >= 0 else -1,
            states[when[f]],
            landmarks[h] if h >= 0 else nowhere,
            kinds[h] if h >= 0 else 0,
            z[f],
            whiteners[f],
            model,
            only_cost,
        )
    return information, vector, cost


@compiled
def solve_window(
    prior_information,
    prior_vector,
    states,
    landmarks,
    kinds,
    when,
    which,
    z,
    whiteners,
    weight,
    model,
    iterations,
):
    """Gauss-Newton with step halving over the window.

    Returns
    -------
    states, landmarks : the solution
    covariance : of (s_now, x_1 … x_H) at the solution
    steps : int; iterations used, -1 if the problem is singular
    """
    window, n = states.shape
    count = landmarks.shape[0]
    base = window * n
    states, landmarks = states.copy(), landmarks.copy()
    size = base + 3 * count
    used = 0
    factor = np.zeros((size, size))
    while used < iterations:
        used += 1
        information, vector, cost = build(
            prior_information,
            prior_vector,
            states,
            landmarks,
            kinds,
            when,
            which,
            z,
            whiteners,
            weight,
            model,
            False,
        )
        point = np.empty(size)
        for i in range(base):
            point[i] = states[i // n, i % n]
        for i in range(3 * count):
            point[base + i] = landmarks[i // 3, i % 3]
        step = vector - information @ point
        gradient = step.copy()
        scale = np.empty(size)
        for i in range(size):
            scale[i] = 1.0 / np.sqrt(max(information[i, i], 1e-300))
        for i in range(size):
            for j in range(size):
                factor[i, j] = information[i, j] * scale[i] * scale[j]
        if not cholesky_upper(factor, size):
            return states, landmarks, factor, -1
        for i in range(size):
            step[i] *= scale[i]
        for i in range(size):
            step[i] /= factor[i, i]
            for k in range(i + 1, size):
                step[k] -= factor[i, k] * step[i]
        for i in range(size - 1, -1, -1):
            value = step[i]
            for k in range(i + 1, size):
                value -= factor[i, k] * step[k]
            step[i] = value / factor[i, i]
        for i in range(size):
            step[i] *= scale[i]
        length = 0.0
        for i in range(size):
            length += gradient[i] * step[i]
        share = 1.0
        new_states, new_landmarks = states.copy(), landmarks.copy()
        for _ in range(6):
            for i in range(base):
                new_states[i // n, i % n] = point[i] + share * step[i]
            for i in range(3 * count):
                new_landmarks[i // 3, i % 3] = point[base + i] + share * step[base + i]
            if length < 1.0:  # close enough for the quadratic model
                break
            _, _, new_cost = build(
                prior_information,
                prior_vector,
                new_states,
                new_landmarks,
                kinds,
                when,
                which,
                z,
                whiteners,
                weight,
                model,
                True,
            )
            if new_cost <= cost:
                break
            share *= 0.5
        states, landmarks = new_states, new_landmarks
        if length < CONVERGED:
            break
    # The trailing block of (UᵀU)⁻¹ is (U₂ᵀU₂)⁻¹ with U₂ the trailing block of U: all that is asked for.
    head = base - n
    tail = size - head
    inverse = np.zeros((tail, tail))
    for j in range(tail):
        inverse[j, j] = 1.0
    solve_lower(factor[head:, head:].T.copy(), tail, inverse)
    covariance = inverse.T.copy() @ inverse
    for i in range(tail):
        for j in range(tail):
            covariance[i, j] *= scale[head + i] * scale[head + j]
    return states, landmarks, covariance, used


@compiled
def eliminate(information, vector, keep, drop):
    """Normal equations on the rows `keep` without those in `drop` (Schur complement).

    Rows of `drop` without information just go; False if the others are singular.
    """
    informed = 0
    for i in range(drop.shape[0]):
        informed += 1 if information[drop[i], drop[i]] > 0.0 else 0
    count = keep.shape[0]
    inner = np.empty((informed, informed))
    cross = np.empty((informed, count + 1))
    rows = np.empty(informed, dtype=np.int64)
    k = 0
    for i in range(drop.shape[0]):
        if information[drop[i], drop[i]] > 0.0:
            rows[k] = drop[i]
            k += 1
    for i in range(informed):
        scale = 1.0 / np.sqrt(information[rows[i], rows[i]])
        for j in range(informed):
            inner[i, j] = information[rows[i], rows[j]] * scale / np.sqrt(information[rows[j], rows[j]])
        for j in range(count):
            cross[i, j] = information[rows[i], keep[j]] * scale
        cross[i, count] = vector[rows[i]] * scale
    valid = cholesky(inner, informed)
    if valid:
        solve_lower(inner, informed, cross)
    left, right = np.empty((count, count)), np.empty(count)
    for i in range(count):
        right[i] = vector[keep[i]]
        for k in range(informed):
            right[i] -= cross[k, i] * cross[k, count]
        for j in range(count):
            left[i, j] = information[keep[i], keep[j]]
        for k in range(informed):
            w = cross[k, i]
            for j in range(count):
                left[i, j] -= w * cross[k, j]
    return left, right, valid
