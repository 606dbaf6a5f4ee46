"""From a mixture of linear-Gaussian beliefs to one: moment matching in the conditional form.

Component c holds agent N(s_c, P_c) and features x | s ~ N(x_c + G_c (s − s_c), C − U_c U_cᵀ). Over a group of weights w_c the
agent's moments are s̄, P; the features' regression on it is G = Σ w_c [G_c P_c + (x_c − x̄)(s_c − s̄)ᵀ] P⁻¹; and what is left
given the agent is Σ w_c [C − U_c U_cᵀ + (G_c − G) P_c (G_c − G)ᵀ + r_c r_cᵀ] with r_c = x_c − x̄ − G (s_c − s̄).
"""

from __future__ import annotations

import math

import numpy as np

from dopslam.compute.compiled import clear, compiled, copy_matrix, copy_vector
from dopslam.compute.linalg import cholesky, solve_lower


@compiled
def _inverse(matrix, size):
    """Inverse of a symmetric positive definite matrix; a pivot lost to rounding is raised."""
    factor, inverse = matrix.copy(), np.zeros((size, size))
    if not cholesky(factor, size):
        copy_matrix(matrix, factor)
        for i in range(size):
            factor[i, i] *= 1.0 + 1e-9
        if not cholesky(factor, size):
            raise ValueError("the agent's covariance is not positive definite")
    for i in range(size):
        inverse[i, i] = 1.0
    solve_lower(factor, size, inverse)
    out = np.zeros((size, size))
    for i in range(size):
        for j in range(size):
            value = 0.0
            for k in range(size):
                value += inverse[k, i] * inverse[k, j]
            out[i, j] = value
    return out


@compiled
def match(part, chosen, low, high, means, covariances, centers, gains, pull, mean, covariance, center, gain, spread):
    """Moments of the components' mixture, written into mean, covariance, center, gain and spread.

    Parameters
    ----------
    part (groups, ·) : weights of the components in every group: 0 the agent and all other features, then one per row of
        the feature low … high − 1 at work
    chosen (active,) : the components that count
    means (active, d), covariances (active, d, d) : the agent in each
    centers (active, 3R), gains (active, 3R, d) : the features given the agent, at its mean
    pull (active, 3R, n) : U, what the measurement takes off C
    """
    active, size, wide = chosen.shape[0], mean.shape[0], gain.shape[0]
    groups, n = part.shape[0], pull.shape[2]
    group_mean, group_inverse = np.zeros((groups, size)), np.zeros((groups, size, size))
    group_covariance = np.zeros((groups, size, size))
    for g in range(groups):
        for q in range(active):
            w = part[g, chosen[q]]
            for j in range(size):
                group_mean[g, j] += w * means[q, j]
        for q in range(active):
            w = part[g, chosen[q]]
            if w == 0.0:
                continue
            for j in range(size):
                for a in range(size):
                    group_covariance[g, j, a] += w * (
                        covariances[q, j, a] + (means[q, j] - group_mean[g, j]) * (means[q, a] - group_mean[g, a])
                    )
        if active > 1:
            copy_matrix(_inverse(group_covariance[g], size), group_inverse[g])
    root = np.zeros((active, size, size))
    if active > 1:
        for q in range(active):
            copy_matrix(covariances[q], root[q])
            if not cholesky(root[q], size):
                clear(root[q])
            for j in range(size):
                for a in range(j + 1, size):
                    root[q, j, a] = 0.0
    offset = np.zeros((active, wide, n + size + 1))  # what is left given the agent: signs −, +, +
    row = np.empty(size)
    for i in range(wide):
        r = i // 3
        g = 1 + r - low if low <= r < high else 0
        value = 0.0
        for q in range(active):
            value += part[g, chosen[q]] * centers[q, i]
        if active == 1:
            for j in range(size):
                gain[i, j] = gains[0, i, j]
        else:
            for j in range(size):
                row[j] = 0.0
            for q in range(active):
                w = part[g, chosen[q]]
                if w == 0.0:
                    continue
                for j in range(size):
                    add = (centers[q, i] - value) * (means[q, j] - group_mean[g, j])
                    for a in range(size):
                        add += gains[q, i, a] * covariances[q, a, j]
                    row[j] += w * add
            for j in range(size):
                gain[i, j] = 0.0
                for a in range(size):
                    gain[i, j] += row[a] * group_inverse[g, a, j]
        center[r, i % 3] = value
        for j in range(size):
            center[r, i % 3] += gain[i, j] * (group_mean[0, j] - group_mean[g, j])
        for q in range(active):
            w = math.sqrt(part[g, chosen[q]])
            for b in range(n):
                offset[q, i, b] = w * pull[q, i, b]
            if active > 1:
                left = centers[q, i] - value
                for j in range(size):
                    left -= gain[i, j] * (means[q, j] - group_mean[g, j])
                    turned = 0.0
                    for a in range(j, size):
                        turned += (gains[q, i, a] - gain[i, a]) * root[q, a, j]
                    offset[q, i, n + j] = w * turned
                offset[q, i, n + size] = w * left
    for i in range(wide):
        gi = 1 + i // 3 - low if low <= i // 3 < high else 0
        for j in range(i + 1):
            gj = 1 + j // 3 - low if low <= j // 3 < high else 0
            scale = 0.0
            if gi == gj:
                scale = 1.0
            else:
                for q in range(active):
                    scale += math.sqrt(part[gi, chosen[q]] * part[gj, chosen[q]])
            value = scale * spread[i, j]
            for q in range(active):
                for b in range(n):
                    value -= offset[q, i, b] * offset[q, j, b]
                if active > 1:
                    for b in range(n, n + size + 1):
                        value += offset[q, i, b] * offset[q, j, b]
            spread[i, j] = value
            spread[j, i] = value
    copy_vector(group_mean[0], mean)
    copy_matrix(group_covariance[0], covariance)
