"""The update of the density under the kept data associations, and its projection onto one PMB."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dopslam.compute.compiled import compiled, copy_matrix, copy_vector, inlined
from dopslam.models.kernels import VA, log_spreading, measured_rows
from dopslam.slam.pmb.density import PMB, start_of
from dopslam.slam.pmb.hypotheses import log_again, normalize
from dopslam.slam.pmb.joint import joint_update, likeliest_block, workspace
from dopslam.slam.pmb.newborn import give_birth, newborn_table
from dopslam.slam.pmb.projection import cap_existence, drop_cross_covariances, moment_match

Array = NDArray[np.float64]


@inlined
def weights_after(density, local, scan, association, model, weight, reference, detections, visible, unseen):
    """Block weights r'μ', SNR references, detection counts and sight of the existing tracks after one association.

    A miss moves P(in sight) by Bayes' rule, v ← v(1 - p_D)/(1 - v p_D); a detection sets it to 1. A distorted detection
    leaves the existence alone and counts as a miss for the sight, so that what goes on beside a landmark that has gone
    becomes a landmark of its own. Nothing hides a landmark and not what is seen within its resolution cell: such a miss
    counts against its existence (`Model.beside`), until of two tracks of one path the one that is seen is left. What was
    seen `Model.memory` times is no piece of another path: one house stands behind the other in the same cell.
    """
    tracks = local.first.shape[0] - 1
    for b in range(density.kind.shape[0]):
        weight[b] = density.weight[b]
        reference[b] = density.reference[b]
        detections[b] = density.detections[b]
        due = local.detection[b]  # v p_D
        visible[b] = (density.visible[b] - due) / max(1.0 - due, 1e-12) if due > 0.0 else density.visible[b]
        unseen[b] = density.unseen[b] + due / max(density.visible[b], 1e-12)
    for t in range(1, tracks):
        for b in range(local.first[t], local.first[t + 1]):
            weight[b] *= (1.0 - local.detection[b]) / math.exp(local.log_missed[t])
    for t in range(1, tracks):
        missed, beside = True, False
        for p in range(scan.z.shape[0]):
            missed = missed and association[p] != t
            for b in range(local.first[t], local.first[t + 1]):
                beside = beside or local.cell[p, b]
        if missed and beside:
            existence = seen = 0.0
            for b in range(local.first[t], local.first[t + 1]):
                existence += weight[b]
                seen = max(seen, density.detections[b])
            if seen > model.memory - 0.5:
                continue
            for b in range(local.first[t], local.first[t + 1]):
                weight[b] *= model.beside / (1.0 - existence + model.beside * existence)
    for p in range(scan.z.shape[0]):
        t = association[p]
        if t < 0:
            continue
        if local.outlier[p, t]:  # neither a detection nor a miss: what was seen may have been something else
            for b in range(local.first[t], local.first[t + 1]):
                weight[b] = density.weight[b]
            continue
        total = local.log_ratio[p, t] + local.log_missed[t]
        for b in range(local.first[t], local.first[t + 1]):
            weight[b] = math.exp(local.log_detected[p, b] - total) if t > 0 else 1.0
            n = density.mean.shape[0] - 3 * (density.kind.shape[0] - 1)
            start = start_of(n, b) if b > 0 else 0
            seen = scan.log_snr[p] + log_spreading(
                density.kind[b], density.mean[start : start + 3], density.mean, model.site
            )
            detections[b] = min(detections[b] + 1.0, model.memory)
            reference[b] += (seen - reference[b]) / detections[b]
            visible[b], unseen[b] = 1.0, 0.0


@inlined
def update(density, n, local, scan, chosen, log_term, log_new, position, model):
    """Update under every association in `chosen`, project onto one PMB.

    Returns
    -------
    posterior : PMB (nothing pruned yet)
    log_weight : (g,) array, final weights of the associations
    distance : float, rows : int; NIS of the likeliest association and its degrees of freedom
    """
    components, count = chosen.track.shape
    m = scan.z.shape[1]
    old = density.kind.shape[0]
    size = density.mean.shape[0]
    measurement, kinds = newborn_table(chosen.log_weight, chosen.track, log_term, log_new, model.prune)
    born = kinds.shape[0]
    full = size + 3 * born
    start = np.empty((born, 3))
    for c in range(born):
        copy_vector(position[measurement[c], kinds[c] - VA], start[c])
    real = np.zeros(count)
    for p in range(count):
        real[p] = min(1.0, (math.exp(log_term[p, 0]) + math.exp(log_term[p, 1])) / math.exp(log_new[p]))
    means, covariances = np.zeros((components, full)), np.zeros((components, full, full))
    weights = np.zeros((components, old + born))
    references, detections = np.zeros((components, old + born)), np.zeros((components, old + born))
    visible, unseen = np.ones((components, old + born)), np.zeros((components, old + born))
    log_weight = chosen.log_weight.copy()
    work = workspace(m, n, size)
    distance, rows, best = 0.0, 0, -np.inf
    for a in range(components):
        association = chosen.track[a]
        mean, covariance, d, evidence = joint_update(density, n, local, scan, association, model, work)
        copy_vector(mean, means[a])
        copy_matrix(covariance, covariances[a])
        weights_after(
            density, local, scan, association, model, weights[a], references[a], detections[a], visible[a], unseen[a]
        )
        if born > 0:
            give_birth(means[a], covariances[a], n, size, scan, measurement, kinds, association, start, real, model)
        for c in range(born):
            p, t = measurement[c], kinds[c] - VA
            if association[p] < 0:
                weights[a, old + c] = math.exp(log_term[p, t] - log_new[p])
            x = means[a, size + 3 * c : size + 3 * c + 3]
            references[a, old + c] = scan.log_snr[p] + log_spreading(kinds[c], x, means[a], model.site)
            detections[a, old + c] = 1.0
        if model.reweight:
            log_weight[a] += evidence - single_evidence(density, local, scan, association)
        if log_weight[a] > best:
            best, distance, rows = log_weight[a], d, 0
            for p in range(count):
                rows += measured_rows(scan.covariance[p]) if association[p] >= 0 else 0
    log_weight = normalize(log_weight)
    if components == 1:
        mean, covariance = means[0], covariances[0]
    else:
        mean, covariance = moment_match(log_weight, means, covariances, weights, n)
    weight, reference, detection = np.zeros(old + born), np.zeros(old + born), np.zeros(old + born)
    sight, missing = np.zeros(old + born), np.zeros(old + born)
    for b in range(old + born):
        for a in range(components):
            share = math.exp(log_weight[a])
            weight[b] += share * weights[a, b]
            reference[b] += share * references[a, b]
            detection[b] += share * detections[a, b]
            sight[b] += share * visible[a, b]
            missing[b] += share * unseen[a, b]
    if not model.joint:
        drop_cross_covariances(covariance, n)
    kind, track = np.empty(old + born, dtype=np.int64), np.empty(old + born, dtype=np.int64)
    idle, origin = np.zeros(old + born), np.zeros(old + born, dtype=np.int64)
    copy_vector(density.origin, origin)
    for b in range(old):
        idle[b] = density.idle[b] + 1.0
        for p in range(count):
            if local.log_detected[p, b] > -np.inf or local.cell[p, b]:
                idle[b] = 0.0
    copy_vector(density.kind, kind)
    copy_vector(density.track, track)
    for c in range(born):
        kind[old + c] = kinds[c]
        track[old + c] = scan.first + measurement[c]
    cap_existence(weight, track, detection, model.existence_limit, model.unconfirmed)
    trail = np.empty((density.trail.shape[0] + 1, 2))
    copy_matrix(density.trail, trail)
    copy_vector(mean[:2], trail[density.trail.shape[0]])
    posterior = PMB(mean, covariance, kind, weight, track, reference, detection, sight, missing, idle, origin, trail)
    return posterior, log_weight, distance, rows


@compiled
def single_evidence(density, local, scan, association):
    """Σ ln N(z^p; ẑ, S) over the pairs of an association: what the evidence of the joint update replaces."""
    total = 0.0
    for p in range(association.shape[0]):
        t = association[p]
        if t >= 0:
            b = likeliest_block(local, p, t)
            total += local.log_detected[p, b] - math.log(density.weight[b] * local.detection[b])
            total -= log_again(scan.covariance[p], density.kind[b], density.detections[b])
    return total
