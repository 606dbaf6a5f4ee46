"""The measurement update of agent and map together, compiled.

The belief is p(s) ∏ p(x | s): a Gaussian of the agent's coordinates s ~ N(s̄, P), and the features given the agent, a
linear function of it with one covariance, x | s ~ N(x̄ + G (s − s̄), C). What a measurement of feature r says about the
agent goes through H = A + B G_r, what it says about every other feature through C. Features are taken one after another;
each is a mixture over its types and associations, matched in its moments: of the agent, of G (a regression on the agent)
and of C. A type's own rows use the weights given that the feature exists and has that type, everything else the weights
over all; their cross terms in C come in Gram form, so that C stays positive semidefinite.
"""

from __future__ import annotations

import math

import numpy as np

from dopslam.compute.compiled import compiled, copy_matrix, copy_vector
from dopslam.compute.linalg import cholesky, solve_lower, solve_lower_vector
from dopslam.slam.belief.conditional.linear import POSE, observe
from dopslam.slam.belief.conditional.moments import match
from dopslam.slam.belief.kernels import VA

_LOG_2PI = math.log(2.0 * math.pi)
_MOST = 8  # rows of a measurement, at most
CELL = 1.65  # (½ c/B)² over ρ σ² of a delay with a flat band, σ = c √12/(√(8π²) B √ρ); likewise of the other rows
NEGLIGIBLE = 1e-6  # components of a mixture below this weight in every group are left out


@compiled
def linearized_rows(form, point, pose, by_coordinate, anchor, scan):
    """∂h/∂s (R, n, d) and ∂h/∂x (R, n, 3) of every row at one pose and the rows' positions ``point`` (R, 3)."""
    rows, size = form.shape[0], by_coordinate.shape[1]
    n = scan.covariance.shape[1]
    by_agent, by_feature = np.zeros((rows, n, size)), np.zeros((rows, n, 3))
    residual, by_pose, own = np.empty(_MOST), np.empty((_MOST, POSE)), np.empty((_MOST, 3))
    if scan.distance.shape[0] == 0:
        return by_agent, by_feature
    for r in range(rows):
        used = observe(
            form[r], pose, point[r, 0], point[r, 1], point[r, 2], anchor, scan, 0, residual, True, by_pose, own
        )
        for i in range(used):
            for a in range(3):
                by_feature[r, i, a] = own[i, a]
            for j in range(size):
                value = 0.0
                for a in range(POSE):
                    value += by_pose[i, a] * by_coordinate[a, j]
                by_agent[r, i, j] = value
    return by_agent, by_feature


@compiled
def innovation(r, used, by_agent, by_feature, covariance, gain, spread, own, total, slope):
    """H = A + B G into slope (n, d), B C Bᵀ into own and H P Hᵀ + B C Bᵀ into total, both (n, n), without noise."""
    size = covariance.shape[0]
    for i in range(used):
        for j in range(size):
            value = by_agent[r, i, j]
            for a in range(3):
                value += by_feature[r, i, a] * gain[3 * r + a, j]
            slope[i, j] = value
    for i in range(used):
        for j in range(i + 1):
            value = 0.0
            for a in range(3):
                for b in range(3):
                    value += by_feature[r, i, a] * spread[3 * r + a, 3 * r + b] * by_feature[r, j, b]
            own[i, j] = value
            for a in range(size):
                for b in range(size):
                    value += slope[i, a] * covariance[a, b] * slope[j, b]
            total[i, j] = value


@compiled
def residual_at(r, used, mean, start, center, point, by_agent, by_feature, residual):
    """Move a residual from the point of linearization (``start``, ``point``) to the current means."""
    for i in range(used):
        for j in range(mean.shape[0]):
            residual[i] -= by_agent[r, i, j] * (mean[j] - start[j])
        for a in range(3):
            residual[i] -= by_feature[r, i, a] * (center[r, a] - point[r, a])


@compiled
def _density(base, noise, scale, used, residual, factor):
    """ln N(residual; 0, base + scale · noise); leaves the Cholesky factor in ``factor`` and L⁻¹residual in ``residual``."""
    for i in range(used):
        for j in range(i + 1):
            factor[i, j] = base[i, j] + scale * noise[i, j]
    if not cholesky(factor, used):
        return -np.inf
    value = 0.0
    for i in range(used):
        for k in range(i):
            residual[i] -= factor[i, k] * residual[k]
        residual[i] /= factor[i, i]
        value -= 0.5 * residual[i] * residual[i] + math.log(factor[i, i])
    return value - 0.5 * used * _LOG_2PI


@compiled
def pair_densities(
    form, mean, covariance, center, gain, spread, pose, by_agent, by_feature, anchor, scan, scale, gate, snr
):
    """ln N(z_m; ẑ_r, S_rm) of every row and measurement, (R, M), at the point of linearization; −inf beyond the gate.

    And whether the measurement, of post-integration SNR (M,), lies within a resolution cell of the row, (R, M).
    """
    rows, count = form.shape[0], scan.distance.shape[0]
    n = scan.covariance.shape[1]
    out, cell = np.full((rows, count), -np.inf), np.zeros((rows, count), dtype=np.bool_)
    own, total, factor = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    slope, residual = np.empty((n, mean.shape[0])), np.empty(_MOST)
    none, none3 = np.empty((1, POSE)), np.empty((1, 3))
    direction = math.log(2.0 * math.pi if scan.count == 1 else 4.0 * math.pi)
    for r in range(rows):
        used = n - scan.count if form[r] == VA else n
        innovation(r, used, by_agent, by_feature, covariance, gain, spread, own, total, slope)
        for m in range(count):
            observe(
                form[r], pose, center[r, 0], center[r, 1], center[r, 2], anchor, scan, m, residual, False, none, none3
            )
            near, wide = True, True
            for i in range(used):
                noise = scale[r, m] * scan.covariance[m, i, i]
                wide = wide and residual[i] * residual[i] < 9.0 * total[i, i] + CELL * snr[m] * noise
            cell[r, m] = wide
            for i in range(used):  # each row alone bounds the distance from below
                near = near and residual[i] * residual[i] < gate * (
                    total[i, i] + scale[r, m] * scan.covariance[m, i, i]
                )
            if not near:
                continue
            value = _density(total, scan.covariance[m], scale[r, m], used, residual, factor)
            square = 0.0
            for i in range(used):
                square += residual[i] * residual[i]
            if square < gate:
                out[r, m] = value - direction if form[r] == VA else value
    return out, cell


@compiled
def sequential_update(
    form, first, order, weight, mean, covariance, center, gain, spread, start, point, pose, by_agent, by_feature,
    anchor, scan, scale, log_pair, log_missed, keep,
):  # fmt: skip
    """All features' messages to agent and map, one feature after another.

    Parameters
    ----------
    form (R,), first (K + 1,) : rows of feature k are first[k]:first[k + 1]; feature 0 is the line of sight
    order (K,) : in which features are taken
    weight (R,) : P(exists, type)
    mean (d,), covariance (d, d) : the agent; center (R, 3), gain (3R, d), spread (3R, 3R) : the map given the agent
    start (d,), point (R, 3), pose, by_agent, by_feature : the linearization
    scale (R, M) : of the scan's covariances, where a feature's own amplitude tells them better than the measured one
    log_pair (R, M) : everything about a pair but its Gaussian, −inf where ruled out; log_missed (R,)
    keep : rows below this weight get no update of their own

    Returns
    -------
    mean, covariance, center, gain, spread : updated
    share (R, M + 1) : P(exists, type, association), column 0 missed
    before_mean (K, d), before_center (R, 3), before_gain (R, 3, d), before_spread (R, 3, 3) : what each feature was, given
        the agent, when its turn came
    log_evidence : of the scan given the associations' messages, Σ ln of the mixtures' masses
    """
    rows, count, size = form.shape[0], scan.distance.shape[0], mean.shape[0]
    n, wide = scan.covariance.shape[1], 3 * form.shape[0]
    features = first.shape[0] - 1
    mean, covariance, center, gain, spread = mean.copy(), covariance.copy(), center.copy(), gain.copy(), spread.copy()
    share = np.zeros((rows, count + 1))
    before_mean, before_center = np.empty((features, size)), center.copy()
    before_gain, before_spread = np.empty((rows, 3, size)), np.empty((rows, 3, 3))
    own, total, factor = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    residual, white = np.empty(_MOST), np.empty(_MOST)
    none, none3 = np.empty((1, POSE)), np.empty((1, 3))
    direction = math.log(2.0 * math.pi if scan.count == 1 else 4.0 * math.pi)
    log_evidence = 0.0
    for k in order:
        low, high = first[k], first[k + 1]
        copy_vector(mean, before_mean[k])
        pairs = 0
        for r in range(low, high):
            for a in range(3):
                before_center[r, a] = center[r, a]
                for j in range(size):
                    before_gain[r, a, j] = gain[3 * r + a, j]
                for b in range(3):
                    before_spread[r, a, b] = spread[3 * r + a, 3 * r + b]
            for m in range(count):
                pairs += 1 if log_pair[r, m] > -np.inf else 0
        who, which = np.empty(pairs + 1, dtype=np.int64), np.empty(pairs + 1, dtype=np.int64)
        log_mass = np.empty(pairs + 1)
        slope = np.empty((pairs + 1, n, size))
        error = np.empty((pairs + 1, n))
        own_all = np.empty((pairs + 1, n, n))
        total_all = np.empty((pairs + 1, n, n))
        exists, c, top = 0.0, 0, -np.inf
        missed = 0.0
        for r in range(low, high):
            exists += weight[r]
            missed += weight[r] * math.exp(log_missed[r])
            used = n - scan.count if form[r] == VA else n
            done = False
            for m in range(count):
                if log_pair[r, m] == -np.inf:
                    continue
                if not done:
                    innovation(r, used, by_agent, by_feature, covariance, gain, spread, own, total, slope[c])
                    done = True
                    base = c
                else:
                    copy_matrix(slope[base], slope[c])
                observe(
                    form[r], pose, point[r, 0], point[r, 1], point[r, 2], anchor, scan, m, residual, False, none, none3
                )
                residual_at(r, used, mean, start, center, point, by_agent, by_feature, residual)
                for i in range(used):
                    error[c, i] = residual[i]
                    for j in range(i + 1):
                        own_all[c, i, j] = own[i, j] + scale[r, m] * scan.covariance[m, i, j]
                        total_all[c, i, j] = total[i, j] + scale[r, m] * scan.covariance[m, i, j]
                value = _density(total, scan.covariance[m], scale[r, m], used, residual, factor)
                if value == -np.inf:
                    continue
                if form[r] == VA:
                    value -= direction
                who[c], which[c] = r, m
                log_mass[c] = math.log(max(weight[r], 1e-300)) + log_pair[r, m] + value
                top = max(top, log_mass[c])
                c += 1
        components = c
        rest = missed + max(1.0 - exists, 0.0)
        log_rest = math.log(max(rest, 1e-300))
        top = max(top, log_rest)
        norm = math.exp(log_rest - top)
        for c in range(components):
            norm += math.exp(log_mass[c] - top)
        log_evidence += top + math.log(norm)
        beta = np.empty(components + 1)  # the last: nothing of this feature was seen
        beta[components] = math.exp(log_rest - top) / norm
        for r in range(low, high):
            share[r, 0] = weight[r] * math.exp(log_missed[r] - top) / norm
        for c in range(components):
            beta[c] = math.exp(log_mass[c] - top) / norm
            share[who[c], 1 + which[c]] += beta[c]
        # weights of the components in every group: 0 the agent and all other features, 1 + r − low the rows of a type
        groups = 1 + high - low
        part = np.zeros((groups, components + 1))
        for c in range(components + 1):
            part[0, c] = beta[c]
        for r in range(low, high):
            mass = 0.0
            for m in range(count + 1):
                mass += share[r, m]
            g = 1 + r - low
            if mass < keep or form[r] == 0:
                part[g, components] = 1.0
                continue
            part[g, components] = share[r, 0] / mass
            for c in range(components):
                if who[c] == r:
                    part[g, c] = beta[c] / mass
        used_components = np.empty(components + 1, dtype=np.int64)
        active = 0
        for c in range(components + 1):
            largest = 0.0
            for g in range(groups):
                largest = max(largest, part[g, c])
            if largest > NEGLIGIBLE:
                used_components[active] = c
                active += 1
        if active == 1 and used_components[0] == components:
            continue
        for g in range(groups):
            mass = 0.0
            for q in range(active):
                mass += part[g, used_components[q]]
            for q in range(active):
                part[g, used_components[q]] /= mass
        # one Kalman update per component, kept in the conditional form
        means, covariances = np.empty((active, size)), np.empty((active, size, size))
        centers, gains = np.empty((active, wide)), np.empty((active, wide, size))
        pull = np.zeros((active, wide, n))
        for q in range(active):
            c = used_components[q]
            copy_vector(mean, means[q])
            copy_matrix(covariance, covariances[q])
            copy_matrix(gain, gains[q])
            for i in range(wide):
                centers[q, i] = center[i // 3, i % 3]
            if c == components:
                continue
            r = who[c]
            used = n - scan.count if form[r] == VA else n
            if not cholesky(total_all[c], used) or not cholesky(own_all[c], used):
                raise ValueError("the innovation covariance of a feature is not positive definite")
            moved = np.empty((used, size))  # L⁻¹ H P
            for i in range(used):
                white[i] = error[c, i]
                for j in range(size):
                    value = 0.0
                    for a in range(size):
                        value += slope[c, i, a] * covariance[a, j]
                    moved[i, j] = value
            solve_lower(total_all[c], used, moved)
            solve_lower_vector(total_all[c], used, white[:used])
            for j in range(size):
                for i in range(used):
                    means[q, j] += moved[i, j] * white[i]
                for a in range(size):
                    for i in range(used):
                        covariances[q, j, a] -= moved[i, j] * moved[i, a]
            # given the agent: U = C Bᵀ L_c⁻ᵀ, K = U L_c⁻¹, x̄ += K(e − H δs), G −= K H
            left = np.empty((used, size + 1))
            for i in range(used):
                left[i, size] = error[c, i]
                for j in range(size):
                    left[i, j] = slope[c, i, j]
                    left[i, size] -= slope[c, i, j] * (means[q, j] - mean[j])
            solve_lower(own_all[c], used, left)
            for i in range(wide):
                for k2 in range(used):
                    value = 0.0
                    for a in range(3):
                        value += spread[i, 3 * r + a] * by_feature[r, k2, a]
                    for b in range(k2):
                        value -= own_all[c, k2, b] * pull[q, i, b]
                    pull[q, i, k2] = value / own_all[c, k2, k2]
                for j in range(size):
                    centers[q, i] += gain[i, j] * (means[q, j] - mean[j])
                for b in range(used):
                    centers[q, i] += pull[q, i, b] * left[b, size]
                    for j in range(size):
                        gains[q, i, j] -= pull[q, i, b] * left[b, j]
        match(part, used_components[:active].copy(), low, high, means, covariances, centers, gains, pull, mean, covariance, center,
               gain, spread)  # fmt: skip
    return (
        mean, covariance, center, gain, spread, share, before_mean, before_center, before_gain, before_spread, log_evidence,
    )  # fmt: skip
