"""Prediction and update of one step as compiled calls: what the filter does between its inputs and its next belief.

What is done is said by the functions called here, each tested by itself; the same lines in NumPy stand in the tests
(tests/slam/test_conditional_step.py), and both agree to rounding. In NumPy they took three times as long as the kernels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dopslam.compute.compiled import compiled
from dopslam.compute.linalg import factorize, solve_lower
from dopslam.slam.association.loopy import associate
from dopslam.slam.belief.conditional.amplitude import AmplitudeTable, amplitude_messages, log_loss, missed_at
from dopslam.slam.belief.conditional.belief import Map
from dopslam.slam.belief.conditional.course import advance, place
from dopslam.slam.belief.conditional.update import linearized_rows, pair_densities, sequential_update

ESTABLISHED = 2.5  # detections from which a feature may be hidden


class Choices(NamedTuple):
    """The filter's parameters as compiled code reads them; names as in :class:`~dopslam.slam.belief.records.Parameters`
    and :class:`~dopslam.slam.belief.conditional.filter.Conditional`.

    Attributes
    ----------
    anchor : (3,) m; table : of the amplitudes; axes : 2 or 3, coordinates of a feature that are unknown
    types : number of them
    """

    anchor: NDArray[np.float64]
    table: AmplitudeTable
    axes: int
    types: int
    survival: float
    returns: float
    type_switch: float
    position_walk: float
    amplitude_walk: float
    rescale: bool
    iterations: int
    pair_gate: float
    gate: float
    hide: float
    unhide: float
    double: float
    keep: float


@compiled
def predict(course, choices, mean, covariance, active, chart):
    """The belief one step later: survival, type chain, walks, and the features given the agent as it is then.

    With J = P Fᵀ P'⁻¹ (the smoother's gain) x | s' has G' = G J and C' = C + G V Gᵀ, where V = (I − J F) P (I − J F)ᵀ + J Q Jᵀ
    is what is left of s given s'. It is positive semidefinite in this form whatever J, also where P' is singular.

    Returns
    -------
    mean (c,), covariance (d, d), noise (d, d) : Q of the coordinates that are uncertain
    chart : the map
    pose (8,), by_coordinate (8, d) : at the mean
    """
    size, whole, wide = active.shape[0], mean.shape[0], chart.gain.shape[0]
    moved, full, full_noise = np.empty(whole), np.empty((whole, whole)), np.empty((whole, whole))
    advance(course, mean, moved, full, full_noise)
    noise, step = np.empty((size, size)), np.empty((size, size))
    for i in range(size):
        for j in range(size):
            step[i, j], noise[i, j] = full[active[i], active[j]], full_noise[active[i], active[j]]
    smooth = np.empty((size, size))  # F P, in the end P'⁻¹ F P = Jᵀ
    ahead, factor, unit = np.empty((size, size)), np.empty((size, size)), np.empty(size)
    for i in range(size):
        for j in range(size):
            value = 0.0
            for k in range(size):
                value += step[i, k] * covariance[k, j]
            smooth[i, j] = value
    for i in range(size):
        for j in range(size):
            value = noise[i, j]
            for k in range(size):
                value += smooth[i, k] * step[j, k]
            ahead[i, j] = value
    for i in range(size):
        unit[i] = 1.0 / math.sqrt(max(ahead[i, i], 1e-300))
    for i in range(size):
        for j in range(size):
            factor[i, j] = ahead[i, j] * unit[i] * unit[j]
            smooth[i, j] *= unit[i]
    if not factorize(factor, size):
        raise ValueError("the agent's predicted covariance is not positive definite")
    solve_lower(factor, size, smooth)
    for i in range(size - 1, -1, -1):
        for j in range(size):
            value = smooth[i, j]
            for k in range(i + 1, size):
                value -= factor[k, i] * smooth[k, j]
            smooth[i, j] = value / factor[i, i]
    for i in range(size):
        for j in range(size):
            smooth[i, j] *= unit[i]
    rest, left = np.empty((size, size)), np.empty((size, size))
    for i in range(size):  # I − J F
        for j in range(size):
            value = 1.0 if i == j else 0.0
            for k in range(size):
                value -= smooth[k, i] * step[k, j]
            rest[i, j] = value
    for i in range(size):
        for j in range(size):
            value = 0.0
            for k in range(size):
                for m in range(size):
                    value += rest[i, k] * covariance[k, m] * rest[j, m] + smooth[k, i] * noise[k, m] * smooth[m, j]
            left[i, j] = value
    gain, spread = np.empty((wide, size)), np.empty((wide, wide))
    row = np.empty(size)
    for i in range(wide):
        for j in range(size):
            value, row[j] = 0.0, 0.0
            for k in range(size):
                value += chart.gain[i, k] * smooth[j, k]
                row[j] += chart.gain[i, k] * left[k, j]
            gain[i, j] = value
        for j in range(i + 1):
            value = chart.spread[i, j]
            for k in range(size):
                value += row[k] * chart.gain[j, k]
            spread[i, j] = value
            spread[j, i] = value
        if i > 2 and i % 3 < choices.axes:
            spread[i, i] += choices.position_walk**2
    weight = np.empty(chart.weight.shape[0])
    for k in range(chart.first.shape[0] - 1):
        low, high = chart.first[k], chart.first[k + 1]
        exists = 0.0
        for r in range(low, high):
            weight[r] = choices.survival * chart.weight[r]
            exists += weight[r]
        if choices.types > 1 and high - low > 1:  # the chain over the types that are still considered
            share = choices.type_switch / (high - low - 1)
            for r in range(low, high):
                weight[r] += share * (exists - (high - low) * weight[r])
    weight[0] += choices.returns * (1.0 - chart.weight[0])
    pose, by_coordinate = np.empty(8), np.empty((8, size))
    place(course, moved, active, pose, by_coordinate)
    after = Map(
        chart.label,
        chart.first,
        chart.form,
        weight,
        chart.hidden,
        chart.seen,
        chart.reference,
        chart.center,
        gain,
        spread,
    )
    return moved, ahead, noise, after, pose, by_coordinate


@compiled
def _evidence(chart, log_density, log_amplitude, log_false, log_birth):
    """ln β and ln ξ of the loopy association, everything relative to the false alarms: missed (K,), detected (K, M), new (M,);
    and (M,) ln of what is born, without the false alarm."""
    features, count = chart.first.shape[0] - 1, log_false.shape[0]
    missed, detected, new, born = np.empty(features), np.empty((features, count)), np.empty(count), np.empty(count)
    for k in range(features):
        exists, lost = 0.0, 0.0
        for r in range(chart.first[k], chart.first[k + 1]):
            exists += chart.weight[r]
            lost += chart.weight[r] * math.exp(log_amplitude[r, 0])
        missed[k] = math.log(lost + max(1.0 - exists, 1e-12))
        for m in range(count):
            detected[k, m] = -np.inf
            for r in range(chart.first[k], chart.first[k + 1]):
                value = math.log(max(chart.weight[r], 1e-300)) + log_density[r, m] + log_amplitude[r, 1 + m]
                detected[k, m] = log_sum(detected[k, m], value - log_false[m])
    for m in range(count):
        born[m] = -np.inf
        for t in range(log_birth.shape[1]):
            born[m] = log_sum(born[m], log_birth[m, t] - log_false[m])
        new[m] = log_sum(0.0, born[m])
    return missed, detected, new, born


@compiled
def log_sum(a, b):
    """``np.logaddexp(a, b)``."""
    high, low = max(a, b), min(a, b)
    return high if low == -np.inf else high + math.log1p(math.exp(low - high))


@compiled
def _by_existence(chart):
    """(K,) features, the line of sight first, then those that are likelier to exist."""
    features = chart.first.shape[0] - 1
    order, exists = np.empty(features, dtype=np.int64), np.empty(features)
    for k in range(features):
        exists[k] = 0.0
        for r in range(chart.first[k], chart.first[k + 1]):
            exists[k] += chart.weight[r]
        i = k
        while i > 1 and exists[order[i - 1]] < exists[k]:
            order[i] = order[i - 1]
            i -= 1
        order[i] = k
    return order


@compiled
def update(
    course, choices, whole, covariance, active, chart, pose, by_coordinate, rows, amplitude, log_false, log_birth
):
    """Association and update of agent and map by one scan.

    Parameters
    ----------
    whole (c,), covariance (d, d), active (d,), chart, pose, by_coordinate : the prediction
    rows : the scan; amplitude (M,); log_false (M,) ln intensity of false alarms; log_birth (M, T) ln of new features

    Returns
    -------
    whole, covariance, chart : updated
    marginal (K, M + 1), new (M,), born (M,) : association probabilities; of a source that is no known feature; ln of what
        is born over false alarms
    exact : what weights of particles are made of: (start, point) of the last linearization, what each feature was when its
        turn came (4), slopes by features, scale, log_pair, log_missed
    """
    total, count, size = chart.form.shape[0], amplitude.shape[0], active.shape[0]
    mean = np.empty(size)
    for j in range(size):
        mean[j] = whole[active[j]]
    by_agent, by_feature = linearized_rows(chart.form, chart.center, pose, by_coordinate, choices.anchor, rows)
    u, variance, hidden, seen_missed = np.empty(total), np.empty(total), np.empty(total), np.empty(total)
    losses = np.empty(total)
    center = chart.center
    for r in range(total):
        loss = log_loss(chart.form[r], pose, center[r, 0], center[r, 1], center[r, 2], choices.anchor)
        losses[r] = loss
        u[r] = chart.reference[r, 0] * math.exp(-0.5 * loss)
        variance[r] = chart.reference[r, 1] * math.exp(-loss) + (choices.amplitude_walk * u[r]) ** 2
        # The line of sight has a chain of its own; what was hardly ever seen is no feature that something hides.
        hide = choices.hide if chart.seen[r] >= ESTABLISHED else 0.0
        hidden[r] = chart.hidden[r] * (1.0 - choices.unhide) + (1.0 - chart.hidden[r]) * hide
    hidden[0] = 0.0
    log_amplitude, amplitudes = amplitude_messages(choices.table, u, variance, amplitude)
    scale, snr = np.ones((total, count)), np.empty(count)
    for m in range(count):
        snr[m] = amplitude[m] ** 2
    for r in range(total):
        seen_missed[r] = math.log(hidden[r] + (1.0 - hidden[r]) * math.exp(log_amplitude[r, 0]))
        log_amplitude[r, 0] = seen_missed[r]
        for m in range(count):
            log_amplitude[r, 1 + m] += math.log1p(-hidden[r])
            if choices.rescale:
                scale[r, m] = (amplitude[m] / amplitudes[r, 1 + m, 0]) ** 2
    log_density, cell = pair_densities(
        chart.form, mean, covariance, chart.center, chart.gain, chart.spread, pose, by_agent, by_feature, choices.anchor, rows,
        scale, choices.pair_gate, snr,
    )  # fmt: skip
    # Nothing hides a feature and not what is seen within its resolution cell: of two of one path one is left. What is too
    # weak to be seen from here is not hidden.
    for r in range(1, total):
        near = False
        for m in range(count):
            near = near or cell[r, m]
        if near:
            expected = 1.0 - missed_at(choices.table, chart.reference[r, 2] * math.exp(-0.5 * losses[r]))
            log_amplitude[r, 0] += math.log(1.0 - (1.0 - choices.double) * expected)
    missed, detected, xi, born = _evidence(chart, log_density, log_amplitude, log_false, log_birth)
    log_nu, _, marginal, new, _, _ = associate(missed, detected, xi, 1e-6, 1000)
    log_pair, log_missed = np.full((total, count), -np.inf), np.empty(total)
    for k in range(chart.first.shape[0] - 1):
        for r in range(chart.first[k], chart.first[k + 1]):
            log_missed[r] = log_amplitude[r, 0]
            for m in range(count):
                if marginal[k, 1 + m] >= choices.gate and log_density[r, m] > -np.inf:
                    log_pair[r, m] = log_nu[k, m] + log_amplitude[r, 1 + m] - log_false[m]
    order = _by_existence(chart)
    start, point, after = mean, center, whole.copy()
    pose, by_coordinate = pose.copy(), by_coordinate.copy()
    iteration = 0
    while True:
        if iteration > 0:
            by_agent, by_feature = linearized_rows(chart.form, point, pose, by_coordinate, choices.anchor, rows)
        updated = sequential_update(
            chart.form, chart.first, order, chart.weight, mean, covariance, center, chart.gain, chart.spread, start, point,
            pose, by_agent, by_feature, choices.anchor, rows, scale, log_pair, log_missed, choices.keep,
        )  # fmt: skip
        linearized_start, linearized_point = start, point
        start, point = updated[0], updated[2]
        settled = iteration > 0
        for j in range(size):
            after[active[j]] = start[j]
            settled = settled and (start[j] - linearized_start[j]) ** 2 < 1e-2 * updated[1][j, j]
        iteration += 1
        if iteration >= choices.iterations or settled:
            break
        place(course, after, active, pose, by_coordinate)
    _, narrow, center, gain, spread, share, before_mean, before_center, before_gain, before_spread, _ = updated
    place(course, after, active, pose, by_coordinate)
    weight, seen, reference = np.zeros(total), np.empty(total), np.empty((total, 3))
    for r in range(total):
        for c in range(count + 1):
            weight[r] += share[r, c]
        gone = share[r, 0] / max(weight[r], 1e-300)
        hidden[r] *= math.exp(-seen_missed[r]) * gone if weight[r] > 0.0 else 0.0
        seen[r] = chart.seen[r] + 1.0 - gone
        loss = log_loss(chart.form[r], pose, center[r, 0], center[r, 1], center[r, 2], choices.anchor)
        first, second = 0.0, 0.0
        if weight[r] > 1e-280:
            for c in range(count + 1):
                first += share[r, c] / weight[r] * amplitudes[r, c, 0]
            for c in range(count + 1):
                second += share[r, c] / weight[r] * (amplitudes[r, c, 1] + (amplitudes[r, c, 0] - first) ** 2)
        else:
            first, second = amplitudes[r, 0, 0], amplitudes[r, 0, 1]
        reference[r, 0], reference[r, 1] = first * math.exp(0.5 * loss), second * math.exp(loss)
        reference[r, 2] = gone * chart.reference[r, 2]
        for c in range(1, count + 1):
            reference[r, 2] += share[r, c] / max(weight[r], 1e-300) * amplitudes[r, c, 0] * math.exp(0.5 * loss)
    posterior = Map(chart.label, chart.first, chart.form, weight, hidden, seen, reference, center, gain, spread)
    exact = (
        linearized_start, linearized_point, before_mean, before_center, before_gain, before_spread, by_feature, scale, log_pair,
        log_missed,
    )  # fmt: skip
    return after, narrow, posterior, marginal, new, born, exact


@compiled
def pruned(chart, feature_threshold, type_share):
    """The map without features and types that hardly exist; the line of sight stays."""
    total = chart.form.shape[0]
    rows, ends, kept = np.empty(total, dtype=np.int64), np.empty(chart.first.shape[0], dtype=np.int64), 0
    features = 0
    label = np.empty(chart.label.shape[0], dtype=np.int64)
    ends[0] = 0
    for k in range(chart.first.shape[0] - 1):
        exists, before = 0.0, kept
        for r in range(chart.first[k], chart.first[k + 1]):
            exists += chart.weight[r]
        for r in range(chart.first[k], chart.first[k + 1]):
            if r == 0 or (exists > feature_threshold and chart.weight[r] > type_share * exists):
                rows[kept] = r
                kept += 1
        if kept > before:
            label[features] = chart.label[k]
            features += 1
            ends[features] = kept
    form, weight, hidden, seen = np.empty(kept, dtype=np.int64), np.empty(kept), np.empty(kept), np.empty(kept)
    reference, center = np.empty((kept, 3)), np.empty((kept, 3))
    size = chart.gain.shape[1]
    gain, spread = np.empty((3 * kept, size)), np.empty((3 * kept, 3 * kept))
    for i in range(kept):
        r = rows[i]
        form[i], weight[i], hidden[i], seen[i] = chart.form[r], chart.weight[r], chart.hidden[r], chart.seen[r]
        for a in range(3):
            reference[i, a] = chart.reference[r, a]
            center[i, a] = chart.center[r, a]
            for j in range(size):
                gain[3 * i + a, j] = chart.gain[3 * r + a, j]
            for q in range(kept):
                for b in range(3):
                    spread[3 * i + a, 3 * q + b] = chart.spread[3 * r + a, 3 * rows[q] + b]
    return Map(
        label[:features].copy(),
        ends[: features + 1].copy(),
        form,
        weight,
        hidden,
        seen,
        reference,
        center,
        gain,
        spread,
    )
