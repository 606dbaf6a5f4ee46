"""The update of the density under the kept data associations, and its projection onto one PMB."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dopslam.compute.compiled import compiled, copy_matrix, copy_vector, inlined
from dopslam.models.kernels import (
    VA,
    factorize,
    linearize,
    noise_entry,
    solve_lower,
    solve_lower_vector,
    subtract,
)
from dopslam.slam.pmb.birth import log_spreading
from dopslam.slam.pmb.density import PMB, start_of
from dopslam.slam.pmb.hypotheses import CELL, normalize
from dopslam.slam.pmb.linear import innovation_covariance, linearize_block, project_rows
from dopslam.slam.pmb.newborn import give_birth, newborn_table
from dopslam.slam.pmb.projection import cap_existence, drop_cross_covariances, moment_match

Array = NDArray[np.float64]


class Workspace(NamedTuple):
    """Arrays of one measurement's linear update, sized once per step."""

    predicted: Array
    nu: Array
    by_state: Array
    by_landmark: Array
    extra: Array
    factor: Array
    projected: Array


@compiled
def workspace(m, n, size):
    """Buffers for measurements of m rows, a UE of n entries and a state of `size`."""
    return Workspace(
        np.empty(m),
        np.empty(m),
        np.empty((m, n)),
        np.empty((m, 3)),
        np.empty((m, m)),
        np.empty((m, m)),
        np.empty((m, size)),
    )


@compiled
def _innovate(z, noise, scale, mean, covariance, n, block, kind, point, around, model, work):
    """Whiten one innovation with `scale` times R, linearized at `point` (its Gaussian `around`, for cubature); νᵀS⁻¹ν and
    ln N(ν; 0, S). Leaves L⁻¹ν in work.nu and L⁻¹HP in work.projected.
    """
    m = z.shape[0]
    linearize_block(point, around, n, block, kind, model, work.predicted, work.by_state, work.by_landmark, work.extra)
    subtract(z, work.predicted, work.by_landmark, work.by_state, work.nu)
    start = start_of(n, block)
    for i in range(m):
        for k in range(n):
            work.nu[i] -= work.by_state[i, k] * (mean[k] - point[k])
        if block > 0:
            for k in range(3):
                work.nu[i] -= work.by_landmark[i, k] * (mean[start + k] - point[start + k])
        for j in range(m):
            work.extra[i, j] += scale * noise_entry(noise, kind, i, j)
    project_rows(covariance, n, block, work.by_state, work.by_landmark, work.projected)
    innovation_covariance(work.projected, n, block, work.by_state, work.by_landmark, work.extra, work.factor)
    if not factorize(work.factor, m):
        raise ValueError("innovation covariance of an update is not positive definite")
    solve_lower(work.factor, m, work.projected)
    distance, log_density = 0.0, -0.5 * m * math.log(2.0 * math.pi)
    for i in range(m):
        value = work.nu[i]
        for k in range(i):
            value -= work.factor[i, k] * work.nu[k]
        work.nu[i] = value / work.factor[i, i]
        distance += work.nu[i] * work.nu[i]
        log_density -= math.log(work.factor[i, i])
    return distance, log_density - 0.5 * distance


@compiled
def _absorb(mean, covariance, work):
    """Kalman update from the whitened innovation: m += Wᵀu, P -= WᵀW with W = L⁻¹HP."""
    m = work.nu.shape[0]
    size = mean.shape[0]
    for k in range(m):
        u = work.nu[k]
        for j in range(size):
            mean[j] += work.projected[k, j] * u
    for i in range(size):
        row = covariance[i]
        for k in range(0, m - 1, 2):  # two rows at a time: half the traffic through P
            w, w_next = work.projected[k, i], work.projected[k + 1, i]
            for j in range(size):
                row[j] -= w * work.projected[k, j] + w_next * work.projected[k + 1, j]
        if m % 2 == 1:
            w = work.projected[m - 1, i]
            for j in range(size):
                row[j] -= w * work.projected[m - 1, j]


@compiled
def _absorb_block(mean, covariance, n, block, work):
    """The same for one landmark block alone; all others stay, their cross-covariances with it follow."""
    m = work.nu.shape[0]
    size = mean.shape[0]
    start = start_of(n, block)
    for k in range(m):
        for i in range(3):
            mean[start + i] += work.projected[k, start + i] * work.nu[k]
    for i in range(start, start + 3):
        for k in range(m):
            w = work.projected[k, i]
            for j in range(size):
                covariance[i, j] -= w * work.projected[k, j]
    for i in range(start, start + 3):
        for j in range(size):
            covariance[j, i] = covariance[i, j]


@compiled
def likeliest_block(local, p, t):
    """The block of track t that explains measurement p best: the type that enters the joint update."""
    best = local.first[t]
    for b in range(local.first[t], local.first[t + 1]):
        if local.log_detected[p, b] > local.log_detected[p, best]:
            best = b
    return best


@compiled
def doubt(mean, n, local, scan, association, kind, model, work, scale):
    """Student-t weights: R of a measurement that does not fit the updated state grows by (ν + d)/(ν + m).

    The distance d = eᵀR⁻¹e is that to the state which all measurements of the scan made together, not to the prediction:
    process noise of centimetres hides an error of many millimetres in front of a prediction, but not beside the others.
    """
    m = scan.z.shape[1]
    for p in range(scan.z.shape[0]):
        t = association[p]
        if t < 0 or local.outlier[p, t]:
            continue
        b = likeliest_block(local, p, t)
        start = start_of(n, b) if b > 0 else 0
        linearize(
            mean[:n], mean[start : start + 3], kind[b], model.site, work.predicted, work.by_state, work.by_landmark
        )
        subtract(scan.z[p], work.predicted, work.by_landmark, work.by_state, work.nu)
        for i in range(m):
            for j in range(m):
                work.factor[i, j] = noise_entry(scan.covariance[p], kind[b], i, j)
        if factorize(work.factor, m):
            squared = solve_lower_vector(work.factor, m, work.nu)
            scale[p] = max(1.0, (model.robust + squared) / (model.robust + m))


@inlined
def joint_update(density, n, local, scan, association, model, work):
    """One EKF update of `[s; x_1; …]` with all measurements a data association gives to tracks.

    The stacked update is done measurement by measurement at one common linearization point, which is the
    same thing since R is block diagonal; iterating moves that point to the updated mean.

    Returns
    -------
    mean, covariance : updated Gaussian
    distance : float, Σ νᵀS⁻¹ν around the prediction (NIS)
    evidence : float, ln N(z_stack; h_stack, H P Hᵀ + R)
    """
    count = scan.z.shape[0]
    point, around = density.mean, density.covariance
    distance = evidence = 0.0
    mean, covariance = density.mean.copy(), density.covariance.copy()
    scale = np.ones(count)
    for p in range(count):
        if association[p] >= 0 and local.outlier[p, association[p]]:
            scale[p] = 1.0 + CELL * math.exp(scan.log_snr[p])
    for iteration in range(model.iterations):
        if iteration > 0:
            if model.robust < np.inf:
                doubt(mean, n, local, scan, association, density.kind, model, work, scale)
            point, around = mean, covariance
            mean, covariance = density.mean.copy(), density.covariance.copy()
        for p in range(count):
            t = association[p]
            if t < 0:
                continue
            b = likeliest_block(local, p, t)
            d, e = _innovate(
                scan.z[p],
                scan.covariance[p],
                scale[p],
                mean,
                covariance,
                n,
                b,
                density.kind[b],
                point,
                around,
                model,
                work,
            )
            if iteration == 0:
                distance += d
                evidence += e
            _absorb(mean, covariance, work)
    for p in range(count):  # siblings of the other type: an update of their own, the UE has used the measurement
        t = association[p]
        if t < 1:
            continue
        used = likeliest_block(local, p, t)
        for b in range(local.first[t], local.first[t + 1]):
            if b != used and local.log_detected[p, b] > -np.inf:
                _innovate(
                    scan.z[p],
                    scan.covariance[p],
                    scale[p],
                    mean,
                    covariance,
                    n,
                    b,
                    density.kind[b],
                    mean,
                    covariance,
                    model,
                    work,
                )
                _absorb_block(mean, covariance, n, b, work)
    return mean, covariance, distance, evidence


@inlined
def weights_after(density, local, scan, association, model, weight, reference, detections, visible, unseen):
    """Block weights r'μ', SNR references, detection counts and sight of the existing tracks after one association.

    A miss moves P(in sight) by Bayes' rule, v ← v(1 - p_D)/(1 - v p_D); a detection sets it to 1. A distorted detection
    leaves the existence alone and counts as a miss for the sight, so that what goes on beside a landmark that has gone
    becomes a landmark of its own. Nothing hides a landmark and not what is seen within its resolution cell: such a miss
    counts against its existence (`Model.beside`), until of two tracks of one path the one that is seen is left.
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
            existence = 0.0
            for b in range(local.first[t], local.first[t + 1]):
                existence += weight[b]
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
            log_weight[a] += evidence - single_evidence(density, local, association)
        if log_weight[a] > best:
            best, distance, rows = log_weight[a], d, 0
            for p in range(count):
                rows += m if association[p] >= 0 else 0
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
def single_evidence(density, local, association):
    """Σ ln N(z^p; ẑ, S) over the pairs of an association: what the evidence of the joint update replaces."""
    total = 0.0
    for p in range(association.shape[0]):
        t = association[p]
        if t >= 0:
            b = likeliest_block(local, p, t)
            total += local.log_detected[p, b] - math.log(density.weight[b] * local.detection[b])
    return total
