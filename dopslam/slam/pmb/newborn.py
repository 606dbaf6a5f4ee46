"""Newborn landmarks of an update: which ones, where, and how their errors hang together with all others."""

from __future__ import annotations

import math

import numpy as np

from dopslam.compute.compiled import clear, compiled, copy_matrix
from dopslam.compute.linalg import cholesky, solve_lower
from dopslam.models.kernels import SP, SR, VA, linearize, noise_entry, subtract
from dopslam.slam.pmb.birth import HELD, first_guess, fit_landmark, fitting
from dopslam.slam.pmb.density import BIRTHS

RARE = 1e-3  # of the pruning threshold: below it a type of a track is dropped
PLAUSIBLE = 16.0  # χ² of the redundant rows up to which a newborn informs the UE (99.9 % of three degrees of freedom)


@compiled
def inform(mean, covariance, n, at, z, noise, kind, x, share, model, work):
    """Let the m - 3 redundant rows of a newborn's measurement inform the UE and the blocks before row `at`.

    Three of m rows place the landmark; the others are a measurement of the UE: with Π = R̃⁻¹ - R̃⁻¹BG and
    r = z - h, ŝ⁺ = ŝ + P_sAᵀΠr and P_s⁺ = P_s - P_sAᵀΠAP_s, and likewise every older block. The measurement is clutter
    with probability 1 - `share`: the moments are those of the mixture. Iterated like the update of tracks. VA and SP
    predict the same rows, so that it does not matter which of them it is. `x` follows the UE. False if nothing was done.
    """
    m = z.shape[0]
    predicted, by_state, by_landmark = np.empty(m), np.empty((m, n)), np.empty((m, 3))
    # Columns: L⁻¹B, L⁻¹ν, L⁻¹AP. The last row is the landmark's height where it is held, and else nothing.
    factor, white = np.empty((m, m)), np.empty((m + 1, 4 + at))
    nu, none = np.empty(m), np.zeros((n, n))
    gain, own = np.empty((3, m)), np.empty((3, 3))
    point = mean[:n].copy()
    shift = np.empty(at)
    for _ in range(model.iterations):
        linearize(point, x, kind, model.site, predicted, by_state, by_landmark)
        subtract(z, predicted, by_landmark, by_state, nu)
        clear(white)
        for i in range(m):
            for k in range(n):
                for j in range(at):
                    white[i, 4 + j] += by_state[i, k] * covariance[k, j]
            white[i, 3] = nu[i]
            for k in range(n):
                white[i, 3] -= by_state[i, k] * (mean[k] - point[k])
            for j in range(3):
                white[i, j] = by_landmark[i, j]
            for j in range(m):
                factor[i, j] = noise_entry(noise, kind, i, j)
                for k in range(n):
                    factor[i, j] += white[i, 4 + k] * by_state[j, k]
        if not cholesky(factor, m):
            return False
        solve_lower(factor, m, white)
        if model.planar:
            white[m, 2] = 1.0 / HELD
            white[m, 3] = ((model.site[3] if kind == SP else model.site[2]) - x[2]) / HELD
        for c in range(3):  # take the span of L⁻¹B out of all columns to its right
            square = 0.0
            for i in range(m + 1):
                square += white[i, c] * white[i, c]
            for j in range(c + 1, 4 + at):
                along = 0.0
                for i in range(m + 1):
                    along += white[i, c] * white[i, j]
                along /= square
                for i in range(m + 1):
                    white[i, j] -= along * white[i, c]
        for j in range(at):
            shift[j] = 0.0
            for i in range(m + 1):
                shift[j] += white[i, 4 + j] * white[i, 3]
        for k in range(n):
            point[k] = mean[k] + shift[k]
        valid, _, _ = fit_landmark(z, noise, point, none, kind, model.site, model.planar, -np.inf, x, gain, own, work)
        if not valid:
            return False
    spread = share * (1.0 - share)
    for i in range(at):
        mean[i] += share * shift[i]
        for j in range(i + 1):  # one half, mirrored: symmetric to the last digit
            value = spread * shift[i] * shift[j]
            for k in range(m + 1):
                value -= share * white[k, 4 + i] * white[k, 4 + j]
            covariance[i, j] += value
            covariance[j, i] = covariance[i, j]
    return True


@compiled
def give_birth(mean, covariance, n, size, scan, measurement, kinds, association, start, real, model):
    """Append the newborn blocks of one association; `mean` and `covariance` have room for them beyond `size`.

    The UE and the older blocks first take what the measurement says about them (`inform`; `real` is the probability
    that it is a VA or an SP), and the newborn is then where the UE makes it be: with G = (BᵀR⁻¹B)⁻¹BᵀR⁻¹ its error is
    -G(A e_s + ε), its covariance with the UE and every landmark -G A P_s·, and between two births G A P_s AᵀGᵀ. The UE
    stays as it is in the paper's filter and at a doubtful birth, where R̃ = R + A P_s Aᵀ takes the place of R in G.
    """
    m = scan.z.shape[1]
    gain, own = np.empty((3, m)), np.empty((3, 3))
    predicted, by_state, by_landmark = np.empty(m), np.empty((m, n)), np.empty((m, 3))
    spread, work = np.zeros((n, n)), fitting(m, n)
    informed = False
    for c in range(measurement.shape[0]):
        p, kind = measurement[c], kinds[c]
        at = size + 3 * c
        x = mean[at : at + 3]
        for i in range(3):
            x[i] = start[c, i]
        if association[p] >= 0:  # explained otherwise here; the block has weight zero
            for i in range(3):
                covariance[at + i, at + i] = 1.0
            continue
        z, noise, state = scan.z[p], scan.covariance[p], mean[:n]
        if c == 0 or measurement[c - 1] != p:  # the sibling of the other type must not use the measurement again
            copy_matrix(covariance[:n, :n], spread)
            informed = False
            if model.inform and real[p] > 0.5 and kind != SR:
                _, chi2, _ = fit_landmark(
                    z, noise, state, spread, kind, model.site, model.planar, -np.inf, x, gain, own, work
                )
                if chi2 < PLAUSIBLE:
                    informed = inform(mean, covariance, n, at, z, noise, kind, x, real[p], model, work)
            if informed:
                clear(spread)
        valid, _, _ = fit_landmark(z, noise, state, spread, kind, model.site, model.planar, -np.inf, x, gain, own, work)
        if not valid:  # the updated UE makes the path impossible; keep the prediction's point, widely
            if not first_guess(z, noise, state, kind, model.site, x):
                for i in range(3):
                    x[i] = start[c, i]
            for i in range(3):
                covariance[at + i, at + i] = HELD**2 if model.planar and i == 2 else 100.0
            continue
        linearize(state, x, kind, model.site, predicted, by_state, by_landmark)
        pull = np.zeros((3, n))
        for i in range(3):
            for k in range(n):
                for r in range(m):
                    pull[i, k] -= gain[i, r] * by_state[r, k]
        for i in range(3):
            for j in range(at):
                value = 0.0
                for k in range(n):
                    value += pull[i, k] * covariance[k, j]
                covariance[at + i, j] = value
                covariance[j, at + i] = value
        # G R Gᵀ rather than (BᵀR̃⁻¹B)⁻¹, which is the same where the fit has converged to the last digit: with this one the
        # whole covariance is positive definite wherever it ended.
        reach = np.zeros((3, m))
        for i in range(3):
            for r in range(m):
                for k in range(m):
                    reach[i, r] += gain[i, k] * noise_entry(noise, kind, k, r)
        for i in range(3):
            for j in range(i + 1):
                value = own[i, 2] * own[j, 2] / HELD**2 if model.planar else 0.0
                for r in range(m):
                    value += reach[i, r] * gain[j, r]
                for k in range(n):
                    value += pull[j, k] * covariance[at + i, k]
                covariance[at + i, at + j] = value
                covariance[at + j, at + i] = value


@compiled
def newborn_table(log_weight, association, log_term, log_new, prune):
    """Measurement and kind of every birth whose existence over all associations reaches `prune`, and whose type's share
    `RARE` times that, the likeliest measurement first: they inform the UE one after another, in an order that must not depend on that of the detections.
    """
    count = log_new.shape[0]
    measurement, kinds = np.empty(BIRTHS * count, dtype=np.int64), np.empty(BIRTHS * count, dtype=np.int64)
    total = 0
    for p in np.argsort(-log_new):
        new = 0.0
        for a in range(association.shape[0]):
            if association[a, p] < 0:
                new += math.exp(log_weight[a])
        existence = 0.0
        for t in range(BIRTHS):
            existence += new * math.exp(log_term[p, t] - log_new[p])
        for t in range(BIRTHS):
            if existence >= prune and new * math.exp(log_term[p, t] - log_new[p]) >= RARE * prune:
                measurement[total] = p
                kinds[total] = VA + t
                total += 1
    return measurement[:total].copy(), kinds[:total].copy()
