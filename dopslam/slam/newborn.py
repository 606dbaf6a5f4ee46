"""Newborn landmarks of an update: which ones, where, and how their errors hang together with all others."""

from __future__ import annotations

import math

import numpy as np

from dopslam.compiled import compiled
from dopslam.models.kernels import VA, linearize
from dopslam.slam.birth import fit_landmark, starting_point


@compiled
def give_birth(mean, covariance, n, size, scan, measurement, kinds, association, start, model):
    """Append the newborn blocks of one association; `mean` and `covariance` have room for them beyond `size`.

    With G = (BᵀR̃⁻¹B)⁻¹BᵀR̃⁻¹ the newborn's error is -G(A e_s + ε): its covariance with the UE and every
    landmark is -G A P_s· and between two births G A P_s AᵀGᵀ. The UE itself stays as it is.
    """
    m = scan.z.shape[1]
    gain, own = np.empty((3, m)), np.empty((3, 3))
    predicted, by_state, by_landmark = np.empty(m), np.empty((m, n)), np.empty((m, 3))
    state_covariance = covariance[:n, :n].copy()
    state = mean[:n]
    for c in range(measurement.shape[0]):
        p, kind = measurement[c], kinds[c]
        at = size + 3 * c
        if association[p] >= 0:  # explained otherwise here; the block has weight zero
            for i in range(3):
                mean[at + i] = start[c, i]
                covariance[at + i, at + i] = 1.0
            continue
        x = mean[at : at + 3]
        for i in range(3):
            x[i] = start[c, i]
        valid, _, _ = fit_landmark(
            scan.z[p], scan.covariance[p], state, state_covariance, kind, model.site, -np.inf, x, gain, own
        )
        if not valid:  # the updated UE makes the path impossible; keep the prediction's point, widely
            if not starting_point(scan.z[p], state, kind, model.site, x):
                for i in range(3):
                    x[i] = start[c, i]
            for i in range(3):
                covariance[at + i, at + i] = 100.0
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
            for j in range(3):
                covariance[at + i, at + j] = own[i, j]


@compiled
def newborn_table(log_weight, association, log_term, log_new, prune):
    """Measurement and kind of every birth whose weight over all associations reaches `prune`."""
    count = log_new.shape[0]
    measurement, kinds = np.empty(2 * count, dtype=np.int64), np.empty(2 * count, dtype=np.int64)
    total = 0
    for p in range(count):
        new = 0.0
        for a in range(association.shape[0]):
            if association[a, p] < 0:
                new += math.exp(log_weight[a])
        for t in range(2):
            if new * math.exp(log_term[p, t] - log_new[p]) >= prune:
                measurement[total] = p
                kinds[total] = VA + t
                total += 1
    return measurement[:total].copy(), kinds[:total].copy()
