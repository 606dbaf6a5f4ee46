"""Nonlinear least squares over a window of UE states and landmarks, in information form.

Variables are ordered s_tail … s_now, x_1 … x_H. Costs are squared Mahalanobis lengths of the motion (1), of
the measurements (3) and of a Gaussian prior over (s_tail, x_1 … x_H).
"""

from __future__ import annotations

import numpy as np

from dopslam.compute.compiled import compiled, copy_matrix, inlined
from dopslam.compute.linalg import cholesky, solve_lower
from dopslam.models.kernels import SR, linearize, move_state, subtract

CONVERGED = 1e-3  # squared Mahalanobis length of a Gauss-Newton step
HALVINGS = 5  # of a step that does not lower the cost


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
def add_motion(information, gradient, at, state, following, weight, pace, model, only_cost):
    """Add ‖s' - f(s)‖² to the normal equations, s at row `at` and s' = `following` `pace` periods after it; returns its
    cost.
    """
    n = state.shape[0]
    jacobian, tied = np.empty((n, n)), np.zeros((n, n))
    predicted = move_state(state, model.site, model.interval * pace, model.turn_rate, jacobian)
    cost = 0.0
    for a in range(n):
        pull = 0.0
        for b in range(n):
            pull += weight[a, b] / pace * (following[b] - predicted[b])
            for k in range(n):
                tied[a, b] += weight[a, k] / pace * jacobian[k, b]
        cost += pull * (following[a] - predicted[a])
        if not only_cost:
            gradient[at + n + a] -= pull
            for b in range(n):
                gradient[at + b] += jacobian[a, b] * pull
    if only_cost:
        return cost
    for a in range(n):
        for b in range(n):
            both = 0.0
            for k in range(n):
                both += jacobian[k, a] * tied[k, b]
            information[at + a, at + b] += both
            information[at + n + a, at + n + b] += weight[a, b] / pace
            information[at + n + a, at + b] -= tied[a, b]
            information[at + b, at + n + a] -= tied[a, b]
    return cost


@compiled
def add_measurement(information, gradient, at, start, state, landmark, kind, z, whitener, model, only_cost):
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
    if model.robust < np.inf and cost > m:  # Student-t beyond what is expected, as in the filter's update
        root = np.sqrt((model.robust + m) / (model.robust + cost))
        cost = m - 2.0 * (model.robust + m) * np.log(root)
        for i in range(m):
            for j in range(d + 1):
                white[i, j] *= root
    if only_cost:
        return cost
    for a in range(d):
        row = at + a if a < n else start + a - n
        for i in range(m):
            gradient[row] += white[i, a] * white[i, d]
        for b in range(d):
            column = at + b if b < n else start + b - n
            for i in range(m):
                information[row, column] += white[i, a] * white[i, b]
    return cost


@compiled
def build(prior_information, prior_vector, states, landmarks, kinds, when, which, rows, z, whiteners, weight, pace,
          model, only_cost):  # fmt: skip
    """Normal equations Λ δ = g of the window for a change δ of (states, landmarks), and the cost there.

    `pace` (window - 1,) holds the times between the states in periods. Measurement `rows[f]` of `z` belongs to state
    `when[f]` and landmark `which[f]` (-1: BS); its whitener L⁻¹ is
    whiteners[0, rows[f]], for a second reflection whiteners[1, rows[f]].
    """
    window, n = states.shape
    count = landmarks.shape[0]
    base = window * n
    size = base + 3 * count
    information, gradient = np.zeros((size, size)), np.zeros(size)
    inner = n + 3 * count
    value = np.empty(inner)
    for i in range(inner):
        value[i] = states[0, i] if i < n else landmarks[(i - n) // 3, (i - n) % 3]
    cost = 0.0
    for i in range(inner):
        row = i if i < n else base + i - n
        product = 0.0
        for j in range(inner):
            product += prior_information[i, j] * value[j]
        cost += value[i] * (product - 2.0 * prior_vector[i])
        gradient[row] += prior_vector[i] - product
        if not only_cost:
            for j in range(n):
                information[row, j] += prior_information[i, j]
            for j in range(n, inner):
                information[row, base + j - n] += prior_information[i, j]
    for j in range(window - 1):
        cost += add_motion(information, gradient, j * n, states[j], states[j + 1], weight, pace[j], model, only_cost)
    nowhere = np.zeros(3)
    for f in range(rows.shape[0]):
        h = which[f]
        cost += add_measurement(
            information,
            gradient,
            when[f] * n,
            base + 3 * h if h >= 0 else -1,
            states[when[f]],
            landmarks[h] if h >= 0 else nowhere,
            kinds[h] if h >= 0 else 0,
            z[rows[f]],
            whiteners[1 if h >= 0 and kinds[h] == SR else 0, rows[f]],
            model,
            only_cost,
        )
    return information, gradient, cost


@compiled
def solve_scaled(information, gradient, factor, scale):
    """δ = Λ⁻¹ g by the Cholesky factor of Λ scaled to a unit diagonal, left in `factor` and `scale`; and whether Λ is
    definite.
    """
    size = gradient.shape[0]
    step = np.zeros(size)
    for i in range(size):
        scale[i] = 1.0 / np.sqrt(max(information[i, i], 1e-300))
    for i in range(size):
        step[i] = gradient[i] * scale[i]
        for j in range(size):
            factor[i, j] = information[i, j] * scale[i] * scale[j]
    if not cholesky_upper(factor, size):
        return step, False
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
    return step, True


@inlined
def solve_window(prior_information, prior_vector, states, landmarks, kinds, when, which, rows, z, whiteners, weight,
                 pace, model, iterations, back):  # fmt: skip
    """Gauss-Newton with halved steps.

    Returns
    -------
    states, landmarks : solution
    covariance : of (s_{now - back}, …, s_now, x_1 … x_H)
    valid : bool; False if the information matrix was singular
    """
    window, n = states.shape
    count = landmarks.shape[0]
    base = window * n
    size = base + 3 * count
    factor, scale = np.empty((size, size)), np.empty(size)
    for _ in range(iterations):
        information, gradient, cost = build(
            prior_information, prior_vector, states, landmarks, kinds, when, which, rows, z, whiteners, weight, pace,
            model, False,
        )  # fmt: skip
        step, valid = solve_scaled(information, gradient, factor, scale)
        if not valid:
            return states, landmarks, factor, False
        length = 0.0
        for i in range(size):
            length += gradient[i] * step[i]
        share = 1.0
        new_states, new_landmarks = states.copy(), landmarks.copy()
        for halving in range(HALVINGS + 1):
            for i in range(base):
                new_states[i // n, i % n] = states[i // n, i % n] + share * step[i]
            for i in range(3 * count):
                new_landmarks[i // 3, i % 3] = landmarks[i // 3, i % 3] + share * step[base + i]
            if length < 1.0 or halving == HALVINGS:  # close enough for the quadratic model, or as short as it gets
                break
            _, _, new_cost = build(
                prior_information, prior_vector, new_states, new_landmarks, kinds, when, which, rows, z, whiteners,
                weight, pace, model, True,
            )  # fmt: skip
            if new_cost <= cost:
                break
            share *= 0.5
        states, landmarks = new_states, new_landmarks
        if length < CONVERGED:
            break
    # The trailing block of (UᵀU)⁻¹ is (U₂ᵀU₂)⁻¹ with U₂ the trailing block of U: all that is asked for.
    head = base - (back + 1) * n
    tail = size - head
    inverse, lower, covariance = np.zeros((tail, tail)), np.zeros((tail, tail)), np.zeros((tail, tail))
    for i in range(tail):
        inverse[i, i] = 1.0
        for j in range(i + 1):
            lower[i, j] = factor[head + j, head + i]
    solve_lower(lower, tail, inverse)
    for k in range(tail):
        for i in range(k + 1):
            w = inverse[k, i] * scale[head + i]
            for j in range(k + 1):
                covariance[i, j] += w * inverse[k, j] * scale[head + j]
    return states, landmarks, covariance, True


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


@compiled
def enlarge(matrix, rows, columns):
    """The matrix in the upper left corner of a larger one of zeros."""
    result = np.zeros((rows, columns))
    copy_matrix(matrix, result)
    return result
