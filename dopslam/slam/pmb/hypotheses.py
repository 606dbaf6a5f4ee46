"""Local hypotheses and their global combinations: what each measurement may come from, and the γ best ways
at once.

Weights are kept as logarithms. A detected track costs -ln(ρ^{i,p}/ρ^{i,0}), a measurement that is new or
clutter -ln ρ^{new,p} in a column of its own, so that the cost of an association is minus its log-weight up
to a constant.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dopslam.compute.compiled import compiled, copy_matrix, inlined
from dopslam.compute.linalg import factorize, solve_lower_vector
from dopslam.models.kernels import (
    FREE_AZIMUTH,
    FREE_ELEVATION,
    SP,
    SR,
    log_spreading,
    measured_rows,
    noise_entry,
    subtract,
)
from dopslam.models.scans import CELL
from dopslam.slam.association.clusters import k_best_of_clusters
from dopslam.slam.pmb.birth import visible_share
from dopslam.slam.pmb.curvature import add_curvature
from dopslam.slam.pmb.density import INERT, NO_TRACK, look_up, start_of
from dopslam.slam.pmb.linear import innovation_covariance, linearize_block, project_rows

Array = NDArray[np.float64]

ESTABLISHED = 2.5  # detections from which a landmark is no false alarm (an average over associations: no whole number)
DRIFT = 0.2  # rad, by which the departure of a second reflection may differ from where it left the scan before


class Local(NamedTuple):
    """Local hypotheses of all blocks and measurements.

    Attributes
    ----------
    detection : (H + 1,) array; p_D of each block, times its probability to be in sight
    log_detected : (M, H + 1) array; ln(β p_D f(z; ẑ, S)) of each pair, -inf outside the gate
    cell : (M, H + 1) bool array; whether a measurement lies within a resolution cell of a block, gated or not
    outlier : (M, T) bool array; whether a pair is taken as a distorted detection
    first : (T + 1,) int array; blocks of track t are first[t]:first[t + 1], track 0 is the BS
    log_missed : (T,) array; ln ρ^{i,0}
    log_ratio : (M, T) array; ln(ρ^{i,p}/ρ^{i,0})
    """

    detection: Array
    log_detected: Array
    cell: NDArray[np.bool_]
    outlier: NDArray[np.bool_]
    first: NDArray[np.int64]
    log_missed: Array
    log_ratio: Array


class Associations(NamedTuple):
    """The γ best data associations: log-weights (normalized) and the track of each measurement, -1 where
    new.
    """

    log_weight: Array
    track: NDArray[np.int64]


@compiled
def track_starts(track):
    """Block ranges of tracks: siblings lie side by side, and inert blocks belong to nobody."""
    starts = np.empty(track.shape[0] + 1, dtype=np.int64)
    count = 0
    for b in range(track.shape[0]):
        if b == 0 or track[b] != track[b - 1] or track[b] < NO_TRACK:
            starts[count] = b
            count += 1
    starts[count] = track.shape[0]
    return starts[: count + 1].copy()


@compiled
def relative_spread(covariance, n, block):
    """Covariance (3, 3) of the vector from the UE to a landmark block."""
    start = start_of(n, block)
    spread = covariance[start : start + 3, start : start + 3].copy()
    for i in range(3):
        for j in range(2):
            spread[i, j] -= covariance[start + i, j]
            spread[j, i] -= covariance[start + i, j]
    for i in range(2):
        for j in range(2):
            spread[i, j] += covariance[i, j]
    return spread


@compiled
def vector_spread(covariance, n, block):
    """:func:`relative_spread`, of the BS that of the receiver's position."""
    if block > 0:
        return relative_spread(covariance, n, block)
    spread = np.zeros((3, 3))
    copy_matrix(covariance[:2, :2], spread)
    return spread


@compiled
def detection_probability(density, n, block, model):
    """p_D of a block: from its predicted SNR, times the share of its density within the SP range."""
    if block == 0:
        if density.detections[0] == 0.0 and model.use_snr:
            return model.table[-1]
        return look_up(model.table, density.reference[0] - log_spreading(0, density.mean, density.mean, model.site))
    start = start_of(n, block)
    x = density.mean[start : start + 3]
    kind = density.kind[block]
    share = 1.0
    if kind == SP and model.sp_range < np.inf:
        share = visible_share(x, relative_spread(density.covariance, n, block), density.mean, kind, model)
    return share * look_up(model.table, density.reference[block] - log_spreading(kind, x, density.mean, model.site))


@compiled
def local_hypotheses(density, n, scan, model):
    """Missed and detected terms of every track (theory: ρ^{i,0}, ρ^{i,p})."""
    count, m = scan.z.shape
    blocks = density.kind.shape[0]
    size = density.mean.shape[0]
    detection = np.empty(blocks)
    log_detected = np.full((count, blocks), -np.inf)
    cell = np.zeros((count, blocks), dtype=np.bool_)
    predicted, nu = np.empty(m), np.empty(m)
    by_state, by_landmark = np.empty((m, n)), np.empty((m, 3))
    extra, base, factor = np.empty((m, m)), np.empty((m, m)), np.empty((m, m))
    projected = np.empty((m, size))
    constant = -0.5 * m * math.log(2.0 * math.pi)
    for b in range(blocks):
        kind = density.kind[b]
        if kind == INERT:
            detection[b] = 0.0
            continue
        detection[b] = density.visible[b] * detection_probability(density, n, b, model)
        if not linearize_block(
            density.mean, density.covariance, n, b, kind, model, predicted, by_state, by_landmark, extra
        ):
            detection[b] = 0.0
        if detection[b] * density.weight[b] <= 1e-12:
            continue
        project_rows(density.covariance, n, b, by_state, by_landmark, projected)
        innovation_covariance(projected, n, b, by_state, by_landmark, extra, base)
        if model.curvature:
            add_curvature(density, n, b, vector_spread(density.covariance, n, b), model, base)
        log_prior = math.log(density.weight[b] * detection[b])
        for p in range(count):
            if scan.log_snr[p] == -np.inf:
                continue
            subtract(scan.z[p], predicted, by_landmark, by_state, nu)
            near = True
            wide = model.outlier > 0.0 and scan.log_snr[p] > 0.0 and density.detections[b] >= ESTABLISHED
            for i in range(m):
                if wide:
                    noise = noise_entry(scan.covariance[p], kind, i, i)
                    wide = nu[i] * nu[i] < 9.0 * base[i, i] + CELL * math.exp(scan.log_snr[p]) * noise
            cell[p, b] = wide
            for i in range(m):  # each row alone bounds the distance from below
                near = near and nu[i] * nu[i] < model.gate * (base[i, i] + noise_entry(scan.covariance[p], kind, i, i))
            if not near:
                continue
            for i in range(m):
                for j in range(m):
                    factor[i, j] = base[i, j] + noise_entry(scan.covariance[p], kind, i, j)
            if not factorize(factor, m):
                raise ValueError("innovation covariance of a track is not positive definite")
            distance = solve_lower_vector(factor, m, nu)
            if distance < model.gate:
                log_density = constant + log_shape(distance, measured_rows(scan.covariance[p]), model.robust)
                for i in range(m):
                    log_density -= math.log(factor[i, i])
                again = log_again(scan.covariance[p], kind, density.detections[b])
                log_detected[p, b] = log_prior + log_density + again
    first = track_starts(density.track)
    tracks = first.shape[0] - 1
    log_missed = np.empty(tracks)
    log_ratio = np.full((count, tracks), -np.inf)
    for t in range(tracks):
        missed = 1.0
        for b in range(first[t], first[t + 1]):
            missed -= density.weight[b] * detection[b]
        log_missed[t] = math.log(max(missed, 1e-12))
        for p in range(count):
            top = -np.inf
            for b in range(first[t], first[t + 1]):
                top = max(top, log_detected[p, b])
            if top > -np.inf:
                total = 0.0
                for b in range(first[t], first[t + 1]):
                    total += math.exp(log_detected[p, b] - top)
                log_ratio[p, t] = top + math.log(total) - log_missed[t]
    return Local(detection, log_detected, cell, np.zeros((count, tracks), dtype=np.bool_), first, log_missed, log_ratio)


@compiled
def log_again(noise, kind, detections):
    """ln of how much likelier the departure of a second reflection is that has been seen before than that of any.

    Its departure is not explained, but it is no other from scan to scan: it wanders by `DRIFT` at most. Were it any
    direction each time, a wall or an object that happens to leave the base station alike (near the edge between two
    surfaces, where both reflect) would take the path over, and stay in the map when it has gone.
    """
    if kind != SR or detections < ESTABLISHED:
        return 0.0
    azimuth, elevation = noise[3, 3] + DRIFT * DRIFT, noise[4, 4] + DRIFT * DRIFT
    return 0.5 * math.log(max(1.0, FREE_AZIMUTH / azimuth)) + 0.5 * math.log(max(1.0, FREE_ELEVATION / elevation))


@compiled
def log_shape(distance, m, robust):
    """ln of an m-dimensional density at a squared Mahalanobis distance, apart from -½ m ln 2π - ½ ln|S|: Gaussian, or
    Student-t of `robust` degrees of freedom; `m` counts the rows that were measured, the others are Gaussian."""
    if robust == np.inf:
        return -0.5 * distance
    scale = math.lgamma(0.5 * (robust + m)) - math.lgamma(0.5 * robust) - 0.5 * m * math.log(0.5 * robust)
    return scale - 0.5 * (robust + m) * math.log1p(distance / robust)


@inlined
def distort(density, local, log_new, model):
    """Let a detection that lies within a resolution cell of a track, and that the track does not explain, be a distorted
    detection of it (two paths that were not told apart) rather than a landmark beside it.

    R falls with 1/ρ: √(6.6 ρ) standard deviations of a delay are c/B, the width of a resolution cell, and likewise in the
    other rows; half of it on either side (`CELL`). The hypothesis is `model.outlier` times as likely as a birth if the track is in sight. The pair competes for the track
    like any other, so that of two detections in one cell the better one takes the track and the other is born.
    """
    for p in range(log_new.shape[0]):
        for t in range(local.first.shape[0] - 1):
            if local.log_ratio[p, t] > log_new[p]:
                continue
            total = 0.0
            for b in range(local.first[t], local.first[t + 1]):
                if local.cell[p, b]:
                    total += density.weight[b] * local.detection[b]
            if total <= 1e-6:
                continue
            log_ratio = log_new[p] + math.log(model.outlier * total) - local.log_missed[t]
            if log_ratio > local.log_ratio[p, t]:
                local.log_ratio[p, t] = log_ratio
                local.outlier[p, t] = True
                for b in range(local.first[t], local.first[t + 1]):
                    local.log_detected[p, b] = -np.inf
                    if local.cell[p, b]:
                        share = density.weight[b] * local.detection[b]
                        local.log_detected[p, b] = log_new[p] + math.log(max(model.outlier * share, 1e-300))


@compiled
def normalize(log_weight):
    """Log-weights that sum to one."""
    top, total = -np.inf, 0.0
    for i in range(log_weight.shape[0]):
        top = max(top, log_weight[i])
    for i in range(log_weight.shape[0]):
        total += math.exp(log_weight[i] - top)
    return log_weight - (top + math.log(total))


@inlined
def best_associations(local, log_new, model):
    """The γ most likely associations (Murty, cluster by cluster), weighted by products of single-landmark terms.

    Those a tenth of `negligible` below the best are not searched for. Also returns the log of their sum, the
    evidence of the scan apart from Σ ln ρ^{i,0}.
    """
    slack = math.log(10.0 / model.negligible)
    totals, solutions = k_best_of_clusters(-local.log_ratio, -log_new, model.gamma, slack)
    log_weight = normalize(-totals)
    return Associations(log_weight, solutions), -totals[0] - log_weight[0]
