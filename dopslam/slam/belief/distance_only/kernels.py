"""Compiled kernels of the distance-only filter: Gaussian mixtures in the plane that every agent particle carries.

Arrays: ``agent`` (2, N) positions; C components of all features one behind the other, feature k owns
``first[k]:first[k + 1]``; ``weight`` (C, N) and ``mean`` (C, 2, N), single precision, given the particle's trajectory, the
weights of a feature sum to 1 for every particle; ``covariance`` (C, 3) = xx, xy, yy, common to the particles. A distance is linearized at the component's mean; its variance is σ² + eᵀPe.
"""

from __future__ import annotations

import numpy as np

from dopslam.compute.compiled import compiled_with

_BLOCK = 512  # particles worked on at a time: their intermediate results stay in the fastest cache
_NORMAL = np.float32(1 / np.sqrt(2 * np.pi))


def _vectorized(function):
    """Compiled without the interpreter's lock, sums in any order so that they use vector instructions; no assumption
    about NaN or infinity."""
    return compiled_with(function, nogil=True, fastmath={"reassoc", "contract", "arcp", "nsz"})


@_vectorized
def predicted(agent, share, chosen, weight, mean, covariance):
    """Weight, mean and variance (C,) of the components' distances over the ``chosen`` particles with weights ``share``,
    without measurement noise."""
    total = len(mean)
    mass, center, spread = np.empty(total), np.empty(total), np.empty(total)
    for c in range(total):
        s0, s1, s2, mapped = 1e-30, 0.0, 0.0, 0.0
        for j in range(chosen.size):
            i = chosen[j]
            w = share[j] * weight[c, i]
            dx, dy = mean[c, 0, i] - agent[0, i], mean[c, 1, i] - agent[1, i]
            squared = dx * dx + dy * dy + 1e-20
            d = np.sqrt(squared)
            s0 += w
            s1 += w * d
            s2 += w * squared
            form = covariance[c, 0] * dx * dx + 2 * covariance[c, 1] * dx * dy + covariance[c, 2] * dy * dy
            mapped += w * form / squared
        mass[c], center[c] = s0, s1 / s0
        spread[c] = max(s2 / s0 - center[c] * center[c], 0.0) + mapped / s0
    return mass, center, spread


@_vectorized
def condition(
    agent, first, weight, mean, covariance, held, z, coefficient, missed, variance, prior, start, stop, lam, sums
):  # fmt: skip
    """Messages and conditional updates of all components for particles ``start`` to ``stop``; changes weight and mean.

    λ_k(i) = Σ_c w_c(i) λ_c(i), λ_c(i) = missed + Σ_m coefficient_km N(z_m; d_c(i), σ² + eᵀPe), into ``lam`` (K, N). Weights
    become w_c λ_c, which sum to λ_k. A component's mean moves to that of its posterior over missed and all measurements;
    ``sums`` (C, 4) collects the weight and the change of the covariance, weighted with ``prior`` (N,). The first
    ``held`` features, known ones, are not updated.
    """
    size = _BLOCK
    ux, uy, distance, inverse = (
        np.empty(size, np.float32), np.empty(size, np.float32), np.empty(size, np.float32), np.empty(size, np.float32),
    )  # fmt: skip
    total, s1, s2 = np.empty(size, np.float32), np.empty(size, np.float32), np.empty(size, np.float32)
    used = np.empty(z.size, np.int64)
    one, half = np.float32(1), np.float32(0.5)
    third, quarter = np.float32(1 / 3), np.float32(0.25)
    floor = np.float32(-0.5)
    for begin in range(start, stop, size):
        n = min(size, stop - begin)
        for k in range(len(first) - 1):
            count = 0
            for m in range(z.size):
                if coefficient[k, m] > 0:
                    used[count] = m
                    count += 1
            row = lam[k, begin : begin + n]
            for i in range(n):
                row[i] = 0
            for c in range(first[k], first[k + 1]):
                mx, my = mean[c, 0, begin : begin + n], mean[c, 1, begin : begin + n]
                ax, ay = agent[0, begin : begin + n], agent[1, begin : begin + n]
                p0, p1, p2 = (
                    np.float32(covariance[c, 0]), np.float32(covariance[c, 1]), np.float32(covariance[c, 2]),
                )  # fmt: skip
                for i in range(n):
                    dx, dy = mx[i] - ax[i], my[i] - ay[i]
                    d = np.sqrt(dx * dx + dy * dy) + np.float32(1e-9)
                    dx, dy = dx / d, dy / d
                    gx, gy = p0 * dx + p1 * dy, p1 * dx + p2 * dy
                    ux[i], uy[i], distance[i] = gx, gy, d
                    inverse[i] = one / (variance + gx * dx + gy * dy)
                    total[i], s1[i], s2[i] = missed, 0, 0
                for j in range(count):
                    measured = np.float32(z[used[j]])
                    scale = np.float32(coefficient[k, used[j]]) * _NORMAL
                    for i in range(n):
                        e = measured - distance[i]
                        # exp(t) as the 64th power of a polynomial: no call, so the loop is vectorized; flat below −32
                        t = max(-half * e * e * inverse[i] * np.float32(1 / 64), floor)
                        p = one + t * (one + half * t * (one + third * t * (one + quarter * t)))
                        p *= p
                        p *= p
                        p *= p
                        p *= p
                        p *= p
                        p *= p
                        value = scale * np.sqrt(inverse[i]) * p
                        total[i] += value
                        s1[i] += value * e
                        s2[i] += value * e * e
                share = weight[c, begin : begin + n]
                for i in range(n):
                    share[i] *= total[i]
                    row[i] += share[i]
                if k < held:
                    continue
                w, xx, xy, yy = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
                own = prior[begin : begin + n]
                for i in range(n):
                    reciprocal = one / total[i]
                    mid = s1[i] * reciprocal
                    gain = mid * inverse[i]
                    mx[i] += ux[i] * gain
                    my[i] += uy[i] * gain
                    # P − K(S·share − spread)Kᵀ with K = Pe/S
                    change = (s2[i] * reciprocal - mid * mid) * inverse[i] - (one - missed * reciprocal)
                    f = own[i] * share[i]
                    w += f
                    f *= change * inverse[i]
                    xx += f * ux[i] * ux[i]
                    xy += f * ux[i] * uy[i]
                    yy += f * uy[i] * uy[i]
                sums[c, 0] += w
                sums[c, 1] += xx
                sums[c, 2] += xy
                sums[c, 3] += yy


@_vectorized
def averages(weight, mean, lam, share):
    """Posterior mass (C,) and mean (C, 2) of one feature's components over the particles with weights ``share`` (N,);
    weight (C, N) and lam (N,) as :func:`condition` leaves them."""
    mass, center = np.empty(len(weight)), np.empty((len(weight), 2))
    scale = np.empty(lam.size, np.float32)
    for i in range(lam.size):
        scale[i] = share[i] / lam[i]
    for c in range(len(weight)):
        s0, sx, sy = np.float32(1e-30), np.float32(0), np.float32(0)
        x0, y0 = mean[c, 0, 0], mean[c, 1, 0]
        for i in range(lam.size):
            w = weight[c, i] * scale[i]
            s0 += w
            sx += w * (mean[c, 0, i] - x0)
            sy += w * (mean[c, 1, i] - y0)
        mass[c], center[c, 0], center[c, 1] = s0, x0 + sx / s0, y0 + sy / s0
    return mass / mass.sum(), center


@_vectorized
def groups(weight, center, covariance, floor, near):
    """Component → group (C,), −1 for weights below ``floor``: a heavier component takes those with squared Mahalanobis
    distance below ``near``."""
    order = np.argsort(-weight)
    group = np.full(len(weight), -1)
    count = 0
    for a in order:
        if group[a] >= 0 or weight[a] < floor:
            continue
        p0, p1, p2 = covariance[a, 0], covariance[a, 1], covariance[a, 2]
        scale = 1.0 / (p0 * p2 - p1 * p1)
        for b in order:
            if group[b] >= 0 or weight[b] < floor:
                continue
            dx, dy = center[b, 0] - center[a, 0], center[b, 1] - center[a, 1]
            if b == a or (p2 * dx * dx - 2 * p1 * dx * dy + p0 * dy * dy) * scale < near:
                group[b] = count
        count += 1
    return group, count


@_vectorized
def merged(mass, center, covariance, group, count, weight, mean, lam, ancestors, out_weight, out_mean):
    """Covariances (G, 3) of the groups; their weights and means of the particles ``ancestors`` into ``out_weight`` (G, N)
    and ``out_mean`` (G, 2, N).

    weight (C, N) as :func:`condition` leaves them, lam (N,) their sums; mass (C,), center (C, 2) : averages over particles
    """
    size = ancestors.size
    own, middle, out = np.zeros(count), np.zeros((count, 2)), np.zeros((count, 3))
    for c in range(len(mass)):
        g = group[c]
        if g >= 0:
            own[g] += mass[c]
            middle[g, 0] += mass[c] * center[c, 0]
            middle[g, 1] += mass[c] * center[c, 1]
    for g in range(count):
        middle[g, 0] /= own[g]
        middle[g, 1] /= own[g]
        for i in range(size):
            out_weight[g, i] = 0
            out_mean[g, 0, i] = 0
            out_mean[g, 1, i] = 0
    scale, w, x, y = (
        np.empty(size, np.float32), np.empty(size, np.float32), np.empty(size, np.float32), np.empty(size, np.float32),
    )  # fmt: skip
    for i in range(size):
        scale[i] = 1 / lam[ancestors[i]]
    # A trace of the average keeps a component where a particle gives it no weight at all.
    for c in range(len(mass)):
        g = group[c]
        if g < 0:
            continue
        trace = np.float32(1e-6 * mass[c] + 1e-30)
        for i in range(size):  # gathered apart: the sums below use vector instructions
            j = ancestors[i]
            w[i], x[i], y[i] = weight[c, j], mean[c, 0, j], mean[c, 1, j]
        for i in range(size):
            value = w[i] * scale[i] + trace
            out_weight[g, i] += value
            out_mean[g, 0, i] += value * x[i]
            out_mean[g, 1, i] += value * y[i]
        share = mass[c] / own[g]
        dx, dy = center[c, 0] - middle[g, 0], center[c, 1] - middle[g, 1]
        out[g, 0] += share * (covariance[c, 0] + dx * dx)
        out[g, 1] += share * (covariance[c, 1] + dx * dy)
        out[g, 2] += share * (covariance[c, 2] + dy * dy)
    total = np.zeros(size, np.float32)
    for g in range(count):
        for i in range(size):
            total[i] += out_weight[g, i]
            inverse = np.float32(1) / out_weight[g, i]
            out_mean[g, 0, i] *= inverse
            out_mean[g, 1, i] *= inverse
    for g in range(count):
        for i in range(size):
            out_weight[g, i] /= total[i]
    return out
