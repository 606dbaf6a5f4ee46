"""The update of one Gaussian over receiver and landmarks with all measurements of a data association."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dopslam.compute.compiled import compiled, inlined, take
from dopslam.compute.linalg import factorize, solve_lower, solve_lower_vector
from dopslam.models.kernels import linearize, measured_rows, noise_entry, subtract
from dopslam.models.scans import CELL
from dopslam.slam.pmb.density import start_of
from dopslam.slam.pmb.hypotheses import log_shape
from dopslam.slam.pmb.linear import innovation_covariance, linearize_block, project_rows

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
    ln of the density of ν, a Gaussian's or a Student-t's (`log_shape`). Leaves L⁻¹ν in work.nu and L⁻¹HP in work.projected.
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
    return distance, log_density + log_shape(distance, measured_rows(noise), model.robust)


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
def doubt(mean, n, scan, kind, at, outlier, model, work, scale):
    """Student-t weights: R of a measurement that does not fit the updated state grows by (ν + d)/(ν + m).

    The distance d = eᵀR⁻¹e is that to the state which all measurements of the scan made together, not to the prediction:
    process noise of centimetres hides an error of many millimetres in front of a prediction, but not beside the others.
    `kind` (M,) and `at` (M,) are the kind and the block in `mean` of what each measurement is of, -1 where of nothing.
    """
    m = scan.z.shape[1]
    for p in range(scan.z.shape[0]):
        if at[p] < 0 or outlier[p]:
            continue
        start = start_of(n, at[p]) if at[p] > 0 else 0
        linearize(
            mean[:n], mean[start : start + 3], kind[p], model.site, work.predicted, work.by_state, work.by_landmark
        )
        subtract(scan.z[p], work.predicted, work.by_landmark, work.by_state, work.nu)
        for i in range(m):
            for j in range(m):
                work.factor[i, j] = noise_entry(scan.covariance[p], kind[p], i, j)
        if factorize(work.factor, m):
            squared = solve_lower_vector(work.factor, m, work.nu)
            told = measured_rows(scan.covariance[p])
            scale[p] = max(1.0, (model.robust + squared) / (model.robust + told))


@compiled
def absorb_all(mean, covariance, n, scan, kind, at, scale, point, around, model, work):
    """Update a Gaussian, in place, with all measurements of something, one after the other at one linearization point;
    Σ νᵀS⁻¹ν and Σ ln N(ν; 0, S)."""
    distance = evidence = 0.0
    for p in range(scan.z.shape[0]):
        if at[p] >= 0:
            d, e = _innovate(
                scan.z[p], scan.covariance[p], scale[p], mean, covariance, n, at[p], kind[p], point, around, model, work
            )  # fmt: skip
            distance += d
            evidence += e
            _absorb(mean, covariance, work)
    return distance, evidence


@inlined
def joint_update(density, n, local, scan, association, model, work):
    """One EKF update of `[s; x_1; …]` with all measurements a data association gives to tracks.

    The stacked update is done measurement by measurement at one common linearization point, which is the
    same thing since R is block diagonal; iterating moves that point to the updated mean. Only the last iteration needs
    the whole map: those before ask where receiver and detected landmarks will be, and update these alone.

    Returns
    -------
    mean, covariance : updated Gaussian
    distance : float, Σ νᵀS⁻¹ν around the prediction (NIS)
    evidence : float, ln N(z_stack; h_stack, H P Hᵀ + R)
    """
    count = scan.z.shape[0]
    block, at, kind = np.full(count, -1), np.full(count, -1), np.zeros(count, dtype=np.int64)
    scale, outlier = np.ones(count), np.zeros(count, dtype=np.bool_)
    rows = np.empty(n + 3 * count, dtype=np.int64)
    for i in range(n):
        rows[i] = i
    detected = 0
    for p in range(count):
        t = association[p]
        if t < 0:
            continue
        block[p] = likeliest_block(local, p, t)
        kind[p] = density.kind[block[p]]
        at[p] = 0
        if block[p] > 0:
            detected += 1
            at[p] = detected
            for i in range(3):
                rows[start_of(n, detected) + i] = start_of(n, block[p]) + i
        if local.outlier[p, t]:
            outlier[p] = True
            scale[p] = 1.0 + CELL * math.exp(scan.log_snr[p])
    point, around = density.mean, density.covariance
    distance = evidence = 0.0
    if model.iterations > 1:
        rows = rows[: n + 3 * detected]
        part, spread = take(density.mean, rows), np.empty((rows.shape[0], rows.shape[0]))
        for i in range(rows.shape[0]):
            for j in range(rows.shape[0]):
                spread[i, j] = density.covariance[rows[i], rows[j]]
        part_work = workspace(scan.z.shape[1], n, rows.shape[0])
        at_point, at_spread = part, spread
        for iteration in range(model.iterations - 1):
            moved, narrowed = part.copy(), spread.copy()
            d, e = absorb_all(
                moved, narrowed, n, scan, kind, at, scale, at_point, at_spread, model, part_work
            )  # fmt: skip
            if iteration == 0:
                distance, evidence = d, e
            at_point, at_spread = moved, narrowed
            if model.robust < np.inf:
                doubt(at_point, n, scan, kind, at, outlier, model, part_work, scale)
        point = density.mean.copy()
        around = density.covariance.copy() if model.cubature else density.covariance
        for i in range(rows.shape[0]):
            point[rows[i]] = at_point[i]
            if model.cubature:
                for j in range(rows.shape[0]):
                    around[rows[i], rows[j]] = at_spread[i, j]
    mean, covariance = density.mean.copy(), density.covariance.copy()
    d, e = absorb_all(mean, covariance, n, scan, kind, block, scale, point, around, model, work)
    if model.iterations == 1:
        distance, evidence = d, e
    for p in range(count):  # siblings of the other type: an update of their own, the UE has used the measurement
        t = association[p]
        if t < 1:
            continue
        for b in range(local.first[t], local.first[t + 1]):
            if b != block[p] and local.log_detected[p, b] > -np.inf:
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
