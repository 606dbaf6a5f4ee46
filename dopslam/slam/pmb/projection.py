"""From several associations to one density (PMBM to PMB): moment matching, marginalization, existence."""

from __future__ import annotations

import math

import numpy as np

from dopslam.compute.compiled import compiled
from dopslam.slam.pmb.density import NO_TRACK, start_of

ONCE = 1.5  # detections (an average over associations) up to which something was seen once


@compiled
def moment_match(log_weight, means, covariances, weights, n):
    """Moments of a mixture in which block b of component a has existence weights[a, b].

    Blocks use weights conditional on their existence, w_ab ∝ w_a β_ab; the Gram form Σ_a √(w_ai w_aj)(P_a +
    δδᵀ) keeps the whole matrix positive semidefinite.
    """
    components, size = means.shape
    blocks = weights.shape[1]
    share = np.zeros((components, size))
    for b in range(blocks):
        total = 0.0
        for a in range(components):
            total += math.exp(log_weight[a]) * weights[a, b]
        low = 0 if b == 0 else start_of(n, b)
        high = n if b == 0 else low + 3
        for a in range(components):
            value = math.exp(log_weight[a]) * weights[a, b] / total if total > 0.0 else 1.0 / components
            for i in range(low, high):
                share[a, i] = value
    # Headings are not wrapped: all components descend from one prior and stay within a fraction of a turn.
    mean = np.zeros(size)
    for a in range(components):
        for i in range(size):
            mean[i] += share[a, i] * means[a, i]
    covariance = np.zeros((size, size))
    root = np.sqrt(share)
    delta = np.empty(size)
    for a in range(components):
        for i in range(size):
            delta[i] = means[a, i] - mean[i]
        for i in range(size):
            scale = root[a, i]
            if scale > 0.0:
                for j in range(size):
                    covariance[i, j] += scale * root[a, j] * (covariances[a, i, j] + delta[i] * delta[j])
    return mean, covariance


@compiled
def drop_cross_covariances(covariance, n):
    """Keep the marginals of the UE and of every landmark only, (31)-(32)."""
    size = covariance.shape[0]
    for i in range(size):
        for j in range(size):
            own_i = -1 if i < n else (i - n) // 3
            own_j = -1 if j < n else (j - n) // 3
            if own_i != own_j:
                covariance[i, j] = 0.0


@compiled
def cap_existence(weight, track, detections, limit, unconfirmed):
    """Scale the siblings of a track so that its existence stays at or below `limit`, or `unconfirmed` where it was detected
    once; the BS is exempt."""
    b = 1
    while b < track.shape[0]:
        last = b
        total = seen = 0.0
        while last < track.shape[0] and track[last] == track[b]:
            total += weight[last]
            seen = max(seen, detections[last])
            last += 1
        most = limit if seen > ONCE else min(limit, unconfirmed)
        if total > most and track[b] > NO_TRACK:
            for i in range(b, last):
                weight[i] *= most / total
        b = last
