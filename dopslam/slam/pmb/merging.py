"""Two tracks of one path become one: which, and how nothing of what either knows is lost or counted twice.

A path that was not recognized for a while, because its detections were distorted or its type was wrong, is born again beside
its old track; the old one then lives on out of sight. Two tracks are taken as one if one of them was not seen in this scan
and they lie where one landmark would: with d the difference of their positions and S its covariance under the joint
Gaussian, "the same" against "two that lie there by chance" has the odds N(d; 0, S)/λ, λ the density of landmarks. Virtual
anchors and second reflections both say where a path comes from, so they may be the same; scatter points are compared among
themselves.

The merged landmark is of a kind that both may be: one that has long been told to be a wall does not become a scatter point
because a doubtful track beside it might be one.

The joint Gaussian is conditioned on d = 0: the exact posterior of one landmark that both have measured, with all that this
says about the receiver and the others. One of the two blocks is then a copy of the other and goes. The landmark exists if
either did.
"""

from __future__ import annotations

import math

import numpy as np

from dopslam.compute.compiled import compiled
from dopslam.compute.linalg import factorize, solve_lower, solve_lower_vector
from dopslam.models.kernels import SP
from dopslam.slam.pmb.density import INERT, NO_TRACK, start_of
from dopslam.slam.pmb.projection import ONCE

APART = 16.0  # squared Mahalanobis distance up to which two positions may be one (99.9 % of χ²₃)
UNSEEN = 0.5  # due detections that the one of the two has missed
DENSEST = 1e-4  # m⁻³ of landmarks, against which two at one place are measured
SMALLEST = 1e-18  # m², of a variance of the difference: below, the two are copies already


@compiled
def merge_duplicates(density, n, model):
    """Merge, in place, the tracks of a density that are one; those that went have weight zero, for `prune` to drop.

    Parameters
    ----------
    density : PMB after an update
    n : int, entries of the receiver's state
    model : Model
    """
    blocks = density.kind.shape[0]
    best = _likeliest(density)
    for i in range(1, blocks):
        if best[i] != i or density.unseen[i] < UNSEEN or density.weight[i] < model.prune:
            continue
        for j in range(1, blocks):
            if best[j] != j or density.track[j] == density.track[i] or density.weight[j] < model.prune:
                continue
            if density.unseen[j] > density.unseen[i] or (density.unseen[j] == density.unseen[i] and j > i):
                continue  # the one seen last stays
            alike = (density.kind[i] == SP) == (density.kind[j] == SP) and _are_one(density, n, i, j)
            if alike and identify(density.mean, density.covariance, n, i, j):
                _join(density, i, j, model)
                break


@compiled
def _likeliest(density):
    """The likeliest block of the track of every block, -1 for the base station and what is inert."""
    blocks = density.kind.shape[0]
    best = np.full(blocks, -1)
    b = 1
    while b < blocks:
        last, top = b, b
        while last < blocks and density.track[last] == density.track[b]:
            top = last if density.weight[last] > density.weight[top] else top
            last += 1
        if density.kind[b] != INERT and density.track[b] > NO_TRACK:
            for i in range(b, last):
                best[i] = top
        b = last
    return best


@compiled
def _are_one(density, n, i, j):
    """Whether two blocks are likelier one landmark than two, by their positions."""
    a, b = start_of(n, i), start_of(n, j)
    p = density.covariance
    difference, spread = np.empty(3), np.empty((3, 3))
    for r in range(3):
        difference[r] = density.mean[b + r] - density.mean[a + r]
        variance = p[a + r, a + r] + p[b + r, b + r] - 2.0 * p[a + r, b + r]
        if difference[r] * difference[r] > APART * variance:
            return False  # each coordinate alone bounds the distance from below
    for r in range(3):
        for c in range(3):
            spread[r, c] = p[a + r, a + c] + p[b + r, b + c] - p[a + r, b + c] - p[b + r, a + c]
        spread[r, r] += SMALLEST
    if not factorize(spread, 3):
        return False
    distance = solve_lower_vector(spread, 3, difference)
    odds = -0.5 * distance - 1.5 * math.log(2.0 * math.pi) - math.log(DENSEST)
    for r in range(3):
        odds -= math.log(spread[r, r])
    return distance < APART and odds > 0.0


@compiled
def identify(mean, covariance, n, i, j):
    """Condition a joint Gaussian, in place, on the positions of two blocks being the same: K = P Hᵀ S⁻¹, H = [… I … -I …].

    False, and nothing done, if their difference is known exactly.
    """
    size = mean.shape[0]
    a, b = start_of(n, i), start_of(n, j)
    projected, nu, spread = np.empty((3, size)), np.empty(3), np.empty((3, 3))
    for r in range(3):
        nu[r] = mean[b + r] - mean[a + r]
        for k in range(size):
            projected[r, k] = covariance[a + r, k] - covariance[b + r, k]
    for r in range(3):
        for c in range(3):
            spread[r, c] = projected[r, a + c] - projected[r, b + c]
        spread[r, r] += SMALLEST
    if not factorize(spread, 3):
        return False
    solve_lower(spread, 3, projected)
    solve_lower_vector(spread, 3, nu)
    for k in range(size):
        for r in range(3):
            mean[k] += projected[r, k] * nu[r]
    for k in range(size):
        for c in range(k + 1):
            value = covariance[k, c]
            for r in range(3):
                value -= projected[r, k] * projected[r, c]
            covariance[k, c] = value
            covariance[c, k] = value
    return True


@compiled
def _join(density, i, j, model):
    """Give the track of block j what that of block i was, and end the latter."""
    gone = stays = alike = agreed = 0.0
    for b in range(1, density.kind.shape[0]):
        if density.track[b] == density.track[i]:
            gone += density.weight[b]
            if (density.kind[b] == SP) == (density.kind[i] == SP):
                alike += density.weight[b]
        elif density.track[b] == density.track[j]:
            stays += density.weight[b]
    alike /= max(gone, 1e-300)
    for b in range(1, density.kind.shape[0]):
        if density.track[b] == density.track[j]:
            density.weight[b] *= alike if (density.kind[b] == SP) == (density.kind[i] == SP) else 1.0 - alike
            agreed += density.weight[b]
    existence = min(1.0 - (1.0 - gone) * (1.0 - stays), model.existence_limit)
    seen = density.detections[i] + density.detections[j]
    if max(density.detections[i], density.detections[j]) < ONCE:  # in one scan, perhaps: that confirms nothing
        existence = min(existence, model.unconfirmed)
    share = density.detections[i] / max(seen, 1e-12)
    for b in range(1, density.kind.shape[0]):
        if density.track[b] == density.track[i]:
            density.weight[b] = 0.0
        elif density.track[b] == density.track[j]:
            density.weight[b] *= existence / max(agreed, 1e-300)
            density.detections[b] = min(seen, model.memory)
            if (density.kind[b] == SP) == (density.kind[i] == SP):  # what spreads alike
                density.reference[b] += share * (density.reference[i] - density.reference[b])
