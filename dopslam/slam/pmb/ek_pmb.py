"""The EK-PMB SLAM filter of paper A, Section IV: one recursion, two densities.

`step` reads as the paper's block diagram. The paper's filter (`joint=False`) keeps only the marginals of UE
and map after each step, (31)-(32), and becomes overconfident; ours (`joint=True`, default) keeps one
Gaussian over UE and landmarks.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dopslam.compute.compiled import compiled, copy_matrix, copy_vector, inlined
from dopslam.errors import FilterError
from dopslam.models.kernels import move_state
from dopslam.models.motion import MotionModel
from dopslam.models.scans import Scans
from dopslam.slam.history import COLUMNS, Diagnostics, History, history_of, write_map
from dopslam.slam.pmb.birth import new_hypotheses
from dopslam.slam.pmb.density import (
    BS_TRACK,
    INERT,
    NO_TRACK,
    PMB,
    FilterParameters,
    Model,
    Scan,
    compile_model,
    initial_density,
    select,
)
from dopslam.slam.pmb.hypotheses import (
    ESTABLISHED,
    Associations,
    best_associations,
    distort,
    local_hypotheses,
    normalize,
    track_starts,
)
from dopslam.slam.pmb.merging import merge_duplicates
from dopslam.slam.pmb.newborn import RARE
from dopslam.slam.pmb.sleeping import nobody, whole
from dopslam.slam.pmb.splinters import pass_over_splinters, passed_over
from dopslam.slam.pmb.update import update
from dopslam.slam.pmb.waking import rest, wake, write_sleepers

Array = NDArray[np.float64]

LARGEST_STATE = 1e24  # of prior and process noise: beyond, compiled code overflows


class Info(NamedTuple):
    """Diagnostics of one step; nothing of it is carried on.

    Attributes
    ----------
    weight : (g,) array; normalized weights of the γ best associations
    track : (g, M) int array; track number of each measurement, -1 for the BS, -2 for new or clutter
    existence : (M,) array; predicted existence of the track that the likeliest association gives each measurement
    nis : float; νᵀS⁻¹ν of the likeliest association
    rows : int; its degrees of freedom
    """

    weight: Array
    track: NDArray[np.int64]
    existence: Array
    nis: float
    rows: int


@compiled
def ue_size(density):
    """Entries of the UE's state."""
    return density.mean.shape[0] - 3 * (density.kind.shape[0] - 1)


@compiled
def predict_sight(density, model):
    """P(in sight) of every block one step later. One that was detected less than `ESTABLISHED` times may be a false
    alarm: it must be seen where it is said to be."""
    visible = density.visible.copy()
    for b in range(visible.shape[0]):
        if b == 0 or density.detections[b] >= ESTABLISHED:
            back = model.reappear / (1.0 + model.reappear * density.unseen[b])
            visible[b] += (1.0 - visible[b]) * back - visible[b] * model.hide
    return visible


@compiled
def predict(density, model, pace):
    """UE through eq. (1) over `pace` periods, r ← p_S r; landmarks are static and the BS always exists."""
    n = ue_size(density)
    size = density.mean.shape[0]
    jacobian = np.empty((n, n))
    mean = density.mean.copy()
    covariance = density.covariance.copy()
    moved_state = move_state(density.mean[:n], model.site, model.interval * pace, model.turn_rate, jacobian)
    copy_vector(moved_state, mean)
    moved = np.zeros((n, size))
    for i in range(n):
        for k in range(n):
            f = jacobian[i, k]
            if f != 0.0:
                for j in range(size):
                    moved[i, j] += f * density.covariance[k, j]
    for i in range(n):
        for j in range(n, size):
            covariance[i, j] = moved[i, j]
            covariance[j, i] = moved[i, j]
        for j in range(i + 1):
            value = pace * model.process_noise[i, j]
            for k in range(n):
                value += moved[i, k] * jacobian[j, k]
            covariance[i, j] = value
            covariance[j, i] = value
    weight = density.weight * model.survival
    for b in range(weight.shape[0]):
        if b == 0 or density.kind[b] == INERT:
            weight[b] = 1.0
    return PMB(
        mean,
        covariance,
        density.kind,
        weight,
        density.track,
        density.reference,
        density.detections,
        predict_sight(density, model),
        density.unseen,
        density.idle,
        density.origin,
        density.trail,
    )


@inlined
def worth_updating(associations, negligible):
    """The associations above `negligible` times the best weight, renormalized."""
    keep = 0
    while keep < associations.log_weight.shape[0] and associations.log_weight[keep] >= associations.log_weight[
        0
    ] + math.log(negligible):
        keep += 1
    return Associations(normalize(associations.log_weight[:keep]), associations.track[:keep])


@compiled
def prune(density, threshold):
    """Drop the tracks whose existence lies below `threshold`, and of the others the types below `RARE` times that: a type
    that one measurement makes unlikely may be the right one. Blocks that sleepers hang on become inert instead."""
    kept = np.empty(density.kind.shape[0], dtype=np.int64)
    count = 1
    kept[0] = 0
    first = track_starts(density.track)
    for t in range(1, first.shape[0] - 1):
        existence = 0.0
        for b in range(first[t], first[t + 1]):
            existence += density.weight[b]
        for b in range(first[t], first[t + 1]):
            if existence >= threshold and density.weight[b] >= RARE * threshold:
                kept[count] = b
                count += 1
            elif density.origin[b] > 0:
                kept[count] = b
                count += 1
                if existence < threshold and density.kind[b] != INERT:
                    density.kind[b], density.weight[b], density.track[b] = INERT, 1.0, NO_TRACK - 1
    if count == density.kind.shape[0]:
        return density
    return select(density, kept[:count])


@inlined
def name_tracks(prior, local, associations, final_log_weight):
    """Diagnostics: weights (the likeliest association first), track numbers and existence."""
    count = associations.track.shape[1]
    weight = np.empty(associations.log_weight.shape[0])
    kept = final_log_weight.shape[0]
    mass = 0.0
    for a in range(weight.shape[0]):
        weight[a] = math.exp(associations.log_weight[a])
        mass += weight[a] if a < kept else 0.0
    best = 0
    for a in range(kept):
        weight[a] = mass * math.exp(final_log_weight[a])
        if weight[a] > weight[best]:
            best = a
    track = np.empty(associations.track.shape, dtype=np.int64)
    existence = np.zeros(count)
    for p in range(count):
        for a in range(weight.shape[0]):
            t = associations.track[a, p]
            track[a, p] = prior.track[local.first[t]] if t >= 0 else NO_TRACK
        t = associations.track[best, p]
        if t >= 0:
            for b in range(local.first[t], local.first[t + 1]):
                existence[p] += prior.weight[b]
    if best > 0:
        for p in range(count):
            track[0, p], track[best, p] = track[best, p], track[0, p]
        weight[0], weight[best] = weight[best], weight[0]
    return weight, track, existence


@inlined
def step(posterior, scan, model):
    """One recursion (30) with γ data associations; returns the next posterior and its diagnostics.

    Parameters
    ----------
    posterior : PMB after the previous scan
    scan : Scan
    model : Model
    """
    n = ue_size(posterior)
    return recursion(predict(posterior, model, scan.pace), n, scan, model)


@inlined
def recursion(prior, n, scan, model):
    """The same from the predicted density on; in the scan `splinters` are marked, as one that passes them over."""
    pass_over_splinters(prior, n, scan, model)
    local = local_hypotheses(prior, n, scan, model)
    log_term, log_new, position = new_hypotheses(prior, n, scan, local, model)
    distort(prior, local, log_new, model)
    associations, _ = best_associations(local, log_new, model)
    chosen = worth_updating(associations, model.negligible)
    updated, log_weight, nis, rows = update(prior, n, local, scan, chosen, log_term, log_new, position, model)
    weight, track, existence = name_tracks(prior, local, associations, log_weight)
    if model.merge:
        merge_duplicates(updated, n, model)
    return prune(updated, model.prune), Info(weight, track, existence, nis, rows)


@compiled
def single_step(posterior, scan, model):
    """:func:`step` alone, for scans that come one at a time."""
    return step(posterior, scan, model)


@compiled
def filter_scans(z, covariance, log_snr, offsets, clutter, pace, density, model, at):
    """The recursion over all scans; `at[0]` holds the step in work, for the message of an error.

    Parameters
    ----------
    z, covariance, log_snr : (N, m), (N, m, m), (N,) arrays; scan k owns rows offsets[k]:offsets[k + 1]
    clutter : float; clutter intensity c(z)
    pace : (K,) array; time since the scan before, in periods of the motion model
    density : PMB before the first scan
    model : Model
    at : (1,) int array

    Returns
    -------
    density : PMB after the last scan
    mean, covariance, map_offsets, table : as `history.history_of` reads them
    weight, count : (K, γ), (K,) arrays; association weights and how many there are
    track : (γ, N) int array; track of each measurement in each association
    existence, nis, rows : (N,), (K,), (K,) arrays; as in `Info`
    """
    steps, n = offsets.shape[0] - 1, ue_size(density)
    mean, spread = np.empty((steps, n)), np.empty((steps, n, n))
    map_offsets, table = np.zeros(steps + 1, dtype=np.int64), np.empty((16 * steps, COLUMNS))
    weight, count = np.zeros((steps, model.gamma)), np.empty(steps, dtype=np.int64)
    track, existence = np.empty((model.gamma, z.shape[0]), dtype=np.int64), np.empty(z.shape[0])
    nis, rows = np.empty(steps), np.empty(steps, dtype=np.int64)
    asleep = nobody(n)
    for k in range(steps):
        at[0] = k
        first, last = offsets[k], offsets[k + 1]
        scan = Scan(z[first:last], covariance[first:last], log_snr[first:last], first, clutter, pace[k])
        prior, asleep = wake(predict(density, model, scan.pace), n, scan, asleep, model)
        density, info = recursion(prior, n, scan, model)
        if model.lazy:
            density, asleep = rest(density, n, asleep)
        if k == steps - 1:
            density, asleep = whole(density, n, asleep), nobody(n)
        copy_vector(density.mean[:n], mean[k])
        copy_matrix(density.covariance[:n, :n], spread[k])
        while map_offsets[k] + density.kind.shape[0] + asleep.kind.shape[0] > table.shape[0]:
            larger = np.empty((2 * table.shape[0], COLUMNS))
            copy_matrix(table, larger)
            table = larger
        map_offsets[k + 1] = write_sleepers(asleep, density, n, table, write_map(density, table, map_offsets[k]))
        count[k] = info.weight.shape[0]
        copy_vector(info.weight, weight[k])
        copy_matrix(info.track, track[:, first:last])
        copy_vector(info.existence, existence[first:last])
        nis[k], rows[k] = info.nis, info.rows
    return density, mean, spread, map_offsets, table[: map_offsets[steps]], weight, count, track, existence, nis, rows


def scan_arrays(
    scans: Scans, doppler: bool, period: float
) -> tuple[Array, Array, Array, NDArray[np.int64], float, Array]:
    """Measurements, covariances, ln ρ (zeros where unknown), offsets, clutter intensity and pace of all scans, with or
    without the Doppler row; `period` [s] is the motion model's.
    """
    m = 6 if doppler else 5
    z = np.array(scans.z[:, :m], order="C")  # a copy: read-only arrays would be compiled for anew
    covariance = np.array(scans.covariance[:, :m, :m], order="C")
    log_snr = np.zeros(len(scans.z)) if scans.snr is None else np.log(np.maximum(scans.snr, 1e-12))
    offsets = scans.offsets.astype(np.int64)
    return z, covariance, log_snr, offsets, scans.clutter_intensity(doppler), scans.pace(period)


def scan_of(scans: Scans, k: int, doppler: bool, period: float) -> Scan:
    """Scan k in the form the recursion reads, with or without its Doppler row."""
    z, covariance, log_snr, offsets, clutter, pace = scan_arrays(scans, doppler, period)
    rows = slice(int(offsets[k]), int(offsets[k + 1]))
    return Scan(z[rows], covariance[rows], log_snr[rows], rows.start, clutter, float(pace[k]))


def check_inputs(scans: Scans, parameters: FilterParameters, model: Model, mean: Array, covariance: Array) -> None:
    """Refuse what cannot be filtered, with a remedy."""
    if model.use_snr and scans.snr is None:
        raise FilterError(
            "detection model 'snr' needs Scans.snr; give the ρ of each detection or use ConstantDetection"
        )
    for name, values in (
        ("prior mean", mean),
        ("prior covariance", covariance),
        ("process noise", model.process_noise),
    ):
        if not np.all(np.abs(values) < LARGEST_STATE):  # NaN included
            raise FilterError(f"{name} holds values that are not finite or above {LARGEST_STATE:g} in magnitude")
    if model.process_noise.shape[0] != np.size(mean):
        raise FilterError(
            f"prior mean has {np.size(mean)} entries but the motion model {model.process_noise.shape[0]}; "
            "they are the same states"
        )


def run(
    scans: Scans,
    prior: tuple[Array, Array],
    motion: MotionModel,
    bs: Array,
    parameters: FilterParameters | None = None,
    height: float = 0.0,
    arrays: tuple[Array, Array, Array, NDArray[np.int64], float, Array] | None = None,
) -> tuple[History, Diagnostics]:
    """Filter a whole run.

    Parameters
    ----------
    scans : Scans
    prior : (mean (n,), covariance (n, n)) of the UE one interval before the first scan
    motion : CoordinatedTurn
    bs : (3,) array [m]
    parameters : FilterParameters, default the joint filter
    height : float, height of the UE's plane [m]
    arrays : of :func:`scan_arrays`, in which what is passed over is then marked; made where not given

    Returns
    -------
    History, Diagnostics

    Raises
    ------
    FilterError
        If the inputs do not fit together or a covariance stops being positive definite (its step is named).
    """
    parameters = parameters or FilterParameters()
    model = compile_model(parameters, motion, bs, height)
    check_inputs(scans, parameters, model, *prior)
    arrays, at = arrays or scan_arrays(scans, parameters.doppler, motion.interval), np.zeros(1, dtype=np.int64)
    try:
        _, mean, covariance, map_offsets, table, weight, count, track, existence, nis, rows = filter_scans(
            *arrays, initial_density(*prior), model, at
        )
    except ValueError as error:
        raise FilterError(
            f"step {at[0]}: {error}; check the measurement covariances and the prior: the likely cause is a prior too wide "
            'for a linearization, and the remedy a start from a snapshot (filter.start = "snapshot")'
        ) from error
    owned = [scans.rows(k) for k in range(scans.steps)]
    diagnostics = Diagnostics(
        nis=nis,
        nis_rows=rows,
        weights=tuple(w[:g] for w, g in zip(weight, count, strict=True)),
        associations=tuple(track[:g, s] for g, s in zip(count, owned, strict=True)),
        existence=tuple(existence[s] for s in owned),
        passed_over=passed_over(*arrays[2:4]),
    )
    return history_of(mean, covariance, map_offsets, table), diagnostics


__all__ = ["BS_TRACK", "NO_TRACK", "Diagnostics", "FilterParameters", "History", "Info", "run", "step"]
