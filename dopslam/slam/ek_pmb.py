"""The EK-PMB SLAM filter of paper A, Section IV: one recursion, two densities.

`step` reads as the paper's block diagram. The paper's filter (`joint=False`) keeps only the marginals of UE
and map after each step, (31)-(32), and becomes overconfident; ours (`joint=True`, default) keeps one
Gaussian over UE and landmarks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dopslam.compiled import compiled, copy_matrix, copy_vector
from dopslam.errors import FilterError
from dopslam.models.kernels import propagate_state
from dopslam.models.motion import CoordinatedTurn
from dopslam.models.scans import Scans
from dopslam.slam.birth import new_hypotheses
from dopslam.slam.hypotheses import Associations, best_associations, local_hypotheses, normalize
from dopslam.slam.pmb import (
    BS_TRACK,
    NO_TRACK,
    PMB,
    FilterParameters,
    Model,
    Scan,
    compile_model,
    initial_density,
    select,
)
from dopslam.slam.update import update

Array = NDArray[np.float64]


class Info(NamedTuple):
    """Diagnostics of one step; nothing of it is carried on.

    Attributes
    ----------
    weight : (g,) array; normalized weights of the γ best associations
    track : (g, M) int array; track number of each measurement, -1 for the BS, -2 for new or clutter
    existence : (M,) array; predicted existence of the track that the likeliest association gives each
    measurement nis : float; νᵀS⁻¹ν of the likeliest association
    rows : int; its degrees of freedom
    """

    weight: Array
    track: NDArray[np.int64]
    existence: Array
    nis: float
    rows: int


@compiled
def ue_size(density):
    """Entries of the UE's state, 4 or 6."""
    return density.mean.shape[0] - 3 * (density.kind.shape[0] - 1)


@compiled
def predict(density, model):
    """UE through eq. (1), r ← p_S r; landmarks are static and the BS always exists."""
    n = ue_size(density)
    size = density.mean.shape[0]
    jacobian = np.empty((n, n))
    mean = density.mean.copy()
    covariance = density.covariance.copy()
    moved_state = propagate_state(density.mean[:n], model.interval, model.site[4], model.turn_rate, jacobian)
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
            value = model.process_noise[i, j]
            for k in range(n):
                value += moved[i, k] * jacobian[j, k]
            covariance[i, j] = value
            covariance[j, i] = value
    weight = density.weight * model.survival
    weight[0] = 1.0
    return PMB(
        mean,
        covariance,
        density.kind,
        weight,
        density.track,
        density.reference,
        density.detections,
        density.trail,
    )


@compiled
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
    """Drop the blocks whose weight lies below `threshold`."""
    kept = np.empty(density.kind.shape[0], dtype=np.int64)
    count = 1
    kept[0] = 0
    for b in range(1, density.kind.shape[0]):
        if density.weight[b] >= threshold:
            kept[count] = b
            count += 1
    if count == density.kind.shape[0]:
        return density
    return select(density, kept[:count])


@compiled
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


@compiled
def step(posterior, scan, model):
    """One recursion (30) with γ data associations; returns the next posterior and its diagnostics.

    Parameters
    ----------
    posterior : PMB after the previous scan
    scan : Scan
    model : Model
    """
    n = ue_size(posterior)
    prior = predict(posterior, model)
    local = local_hypotheses(prior, n, scan, model)
    log_term, log_new, position = new_hypotheses(prior, n, scan, local, model)
    associations, _ = best_associations(local, log_new, model)
    chosen = worth_updating(associations, model.negligible)
    updated, log_weight, nis, rows = update(prior, n, local, scan, chosen, log_term, log_new, position, model)
    weight, track, existence = name_tracks(prior, local, associations, log_weight)
    return prune(updated, model.prune), Info(weight, track, existence, nis, rows)


@dataclass(frozen=True, slots=True)
class Diagnostics:
    """What happened inside a run, one entry per step.

    Attributes
    ----------
    nis, nis_rows : (K,) arrays; νᵀS⁻¹ν of the likeliest association and its degrees of freedom
    weights : K arrays (g,); normalized association weights, the likeliest first
    associations : K arrays (g, M); track of each measurement, -1 the BS, -2 new or clutter
    existence : K arrays (M,); predicted existence of the track each measurement went to
    map_existence : K pairs (track (H,), weight (H,)) of all blocks after each step; siblings repeat their
    track
    """

    nis: Array
    nis_rows: NDArray[np.int64]
    weights: tuple[Array, ...]
    associations: tuple[NDArray[np.int64], ...]
    existence: tuple[Array, ...]
    map_existence: tuple[tuple[NDArray[np.int64], Array], ...]


@dataclass(frozen=True, slots=True)
class History:
    """State and map after every step; the map is ragged, step k owns rows map_offsets[k]:map_offsets[k + 1].

    Attributes
    ----------
    mean : (K, n) array [m, m, rad, m(, m/s, rad/s)]
    covariance : (K, n, n) array
    map_offsets : (K + 1,) int array
    position : (N, 3) array [m]; of the track's likelier type
    position_covariance : (N, 3, 3) array
    existence : (N,) array; r of the track
    va_probability : (N,) array; P(VA | exists)
    kind : (N,) int array; the likelier type, 1 VA or 2 SP
    track : (N,) int array; number of the measurement that bore the track
    """

    mean: Array
    covariance: Array
    map_offsets: NDArray[np.int64]
    position: Array
    position_covariance: Array
    existence: Array
    va_probability: Array
    kind: NDArray[np.int64]
    track: NDArray[np.int64]

    @property
    def steps(self) -> int:
        """Number of steps K."""
        return len(self.mean)

    def rows(self, step: int) -> slice:
        """Map rows of one step."""
        return slice(int(self.map_offsets[step]), int(self.map_offsets[step + 1]))

    def reported(self, step: int, kind: int, threshold: float = 0.5) -> Array:
        """Positions (·, 3) of the landmarks of one kind with existence above the threshold."""
        rows = self.rows(step)
        wanted = (self.kind[rows] == kind) & (self.existence[rows] > threshold)
        return self.position[rows][wanted]


def scan_of(scans: Scans, k: int, doppler: bool) -> Scan:
    """Scan k in the form the recursion reads, with or without its Doppler row."""
    rows = scans.rows(k)
    m = 6 if doppler else 5
    z = np.ascontiguousarray(scans.z[rows, :m])
    return Scan(
        z=z,
        covariance=np.ascontiguousarray(scans.covariance[rows, :m, :m]),
        log_snr=np.zeros(len(z)) if scans.snr is None else np.log(np.maximum(scans.snr[rows], 1e-12)),
        first=rows.start,
        clutter=scans.clutter_intensity(doppler),
    )


@compiled
def extract(posterior):
    """Map of a density, one row per track: position, covariance, existence, P(VA), kind, track number."""
    n = ue_size(posterior)
    blocks = posterior.kind.shape[0]
    position, covariance = np.empty((blocks, 3)), np.empty((blocks, 3, 3))
    existence, va = np.zeros(blocks), np.zeros(blocks)
    kind, track = np.zeros(blocks, dtype=np.int64), np.zeros(blocks, dtype=np.int64)
    count = 0
    b = 1
    while b < blocks:
        best, last = b, b
        while last < blocks and posterior.track[last] == posterior.track[b]:
            existence[count] += posterior.weight[last]
            if posterior.kind[last] == 1:
                va[count] += posterior.weight[last]
            if posterior.weight[last] > posterior.weight[best]:
                best = last
            last += 1
        va[count] /= max(existence[count], 1e-300)
        start = n + 3 * (best - 1)
        copy_vector(posterior.mean[start : start + 3], position[count])
        copy_matrix(posterior.covariance[start : start + 3, start : start + 3], covariance[count])
        kind[count], track[count] = posterior.kind[best], posterior.track[best]
        count += 1
        b = last
    return position[:count], covariance[:count], existence[:count], va[:count], kind[:count], track[:count]


def check_inputs(scans: Scans, parameters: FilterParameters, model: Model, mean: Array) -> None:
    """Refuse what cannot be filtered, with a remedy."""
    if model.use_snr and scans.snr is None:
        raise FilterError(
            "detection model 'snr' needs Scans.snr; give the ρ of each detection or use ConstantDetection"
        )
    if model.process_noise.shape[0] != np.size(mean):
        raise FilterError(
            f"prior mean has {np.size(mean)} entries but the motion model {model.process_noise.shape[0]}; "
            "use 4 for known and 6 for unknown speed and turn rate in both"
        )


def run(
    scans: Scans,
    prior: tuple[Array, Array],
    motion: CoordinatedTurn,
    bs: Array,
    parameters: FilterParameters | None = None,
    height: float = 0.0,
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
    check_inputs(scans, parameters, model, prior[0])
    posteriors, infos = [], []
    for posterior, info in filter_steps(scans, prior, parameters, model):
        posteriors.append(posterior)
        infos.append(info)
    return collect(posteriors), diagnose(infos, posteriors)


def filter_steps(
    scans: Scans, prior: tuple[Array, Array], parameters: FilterParameters, model: Model
) -> Iterator[tuple[PMB, Info]]:
    """Posterior and diagnostics after every scan, one at a time."""
    posterior = initial_density(*prior)
    for k in range(scans.steps):
        try:
            posterior, info = step(posterior, scan_of(scans, k, parameters.doppler), model)
        except ValueError as error:
            raise FilterError(f"step {k}: {error}; check the measurement covariances and the prior") from error
        yield posterior, info


def collect(posteriors: list[PMB]) -> History:
    """The densities of all steps as one flat record."""
    n = posteriors[0].mean.size - 3 * (posteriors[0].kind.size - 1)
    maps = [extract(p) for p in posteriors]
    columns = [np.concatenate([m[i] for m in maps]) for i in range(6)]
    return History(
        np.array([p.mean[:n] for p in posteriors]),
        np.array([p.covariance[:n, :n] for p in posteriors]),
        np.concatenate([[0], np.cumsum([len(m[0]) for m in maps])]).astype(np.int64),
        *columns,
    )


def diagnose(infos: list[Info], posteriors: list[PMB]) -> Diagnostics:
    """The diagnostics of all steps as one record."""
    return Diagnostics(
        nis=np.array([i.nis for i in infos]),
        nis_rows=np.array([i.rows for i in infos], dtype=np.int64),
        weights=tuple(i.weight for i in infos),
        associations=tuple(i.track for i in infos),
        existence=tuple(i.existence for i in infos),
        map_existence=tuple((p.track[1:], p.weight[1:]) for p in posteriors),
    )


__all__ = ["BS_TRACK", "NO_TRACK", "Diagnostics", "FilterParameters", "History", "Info", "run", "step"]
