"""Fixed-lag iterated smoother on the filter's own associations.

The filter linearizes early and never revisits it. The smoother keeps the last `lag` UE states and all
confirmed landmarks as variables of a nonlinear least-squares problem (motion (1), measurements (3), a
Gaussian prior at the window's tail), relinearizes all of them every step (Gauss-Newton in information form)
and marginalizes the oldest state. With a lag as long as the run it is the batch MAP estimate. A landmark
enters with no prior information, as in the PCRB.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dopslam.compute.compiled import compiled, copy_matrix, copy_vector, take
from dopslam.errors import FilterError
from dopslam.models.kernels import move_state
from dopslam.models.measurement import BS, SR, seen_noise
from dopslam.models.motion import MotionModel
from dopslam.models.scans import Scans
from dopslam.slam.history import Diagnostics, History
from dopslam.slam.pmb import ek_pmb
from dopslam.slam.pmb.density import BS_TRACK, NO_TRACK, FilterParameters, compile_model
from dopslam.slam.pmb.window import build, eliminate, enlarge, solve_window

Array = NDArray[np.float64]

KNOWN = 1e-12  # variance that stands for none where a state is known exactly: information must stay finite


@dataclass(frozen=True, slots=True)
class SmootherParameters:
    """Choices of the fixed-lag smoother.

    Attributes
    ----------
    lag : int
        Steps that are revisited.
    iterations : int
        Most Gauss-Newton iterations per step.
    delayed : bool
        Every step is told `lag` steps later, with all that was measured until then.
    confirmed : float
        Existence times type probability from which a track's measurements are used.
    """

    lag: int = 5
    iterations: int = 5
    confirmed: float = 0.95
    delayed: bool = False

    def __post_init__(self) -> None:
        if self.lag < 1 or self.iterations < 1:
            raise FilterError(f"SmootherParameters: lag {self.lag}, iterations {self.iterations} must be ≥ 1")


@compiled
def find(values, wanted):
    """Place of `wanted` in `values`, or -1."""
    for i in range(values.shape[0]):
        if values[i] == wanted:
            return i
    return -1


@compiled
def active(named, offsets, tracks, first, scan, last):
    """Measurements of scans `scan` … `last - 1` whose landmark is a variable (or the BS): window index, landmark index
    (-1: BS), row. State 0 of the window precedes scan `first`.
    """
    room = offsets[last] - offsets[scan]
    when, which = np.empty(room, dtype=np.int64), np.empty(room, dtype=np.int64)
    rows = np.empty(room, dtype=np.int64)
    count = 0
    for k in range(scan, last):
        for row in range(offsets[k], offsets[k + 1]):
            slot = find(tracks, named[row])
            if slot >= 0 or named[row] == BS_TRACK:
                when[count], which[count], rows[count] = k + 1 - first, slot, row
                count += 1
    return when[:count], which[:count], rows[:count]


@compiled
def agree(information, vector, n, tracks, kinds, landmarks, wanted, kind, position):
    """Follow the filter: forget the landmarks that are not `wanted` or of another kind, take up the new ones.

    Parameters
    ----------
    information, vector : prior over (s_tail, x_1 … x_H)
    tracks, kinds, landmarks : (H,), (H,), (H, 3) arrays; the variables
    wanted, kind, position : (N,), (N,), (N, 3) arrays; tracks that may be variables (-2 where not), as the filter has
        them
    """
    old = tracks.shape[0]
    keep, drop = np.empty(n + 3 * old, dtype=np.int64), np.empty(3 * old, dtype=np.int64)
    stay = np.empty(old, dtype=np.int64)
    kept = 0
    for i in range(n):
        keep[i] = i
    for h in range(old):
        at = find(wanted, tracks[h])
        if at >= 0 and kind[at] == kinds[h]:
            stay[kept] = h
            for i in range(3):
                keep[n + 3 * kept + i] = n + 3 * h + i
            kept += 1
        else:
            for i in range(3):
                drop[3 * (h - kept) + i] = n + 3 * h + i
    new = np.empty(wanted.shape[0], dtype=np.int64)
    count = 0
    for i in range(wanted.shape[0]):
        slot = find(tracks, wanted[i])
        if wanted[i] != NO_TRACK and (slot < 0 or kind[i] != kinds[slot]):
            new[count] = i
            count += 1
    valid = True
    if kept < old:
        information, vector, valid = eliminate(information, vector, keep[: n + 3 * kept], drop[: 3 * (old - kept)])
    if kept == old and count == 0:
        return information, vector, tracks, kinds, landmarks, valid
    total = kept + count
    grown = np.zeros(n + 3 * total)
    copy_vector(vector, grown)
    all_tracks, all_kinds = np.empty(total, dtype=np.int64), np.empty(total, dtype=np.int64)
    all_landmarks = np.empty((total, 3))
    copy_vector(take(tracks, stay[:kept]), all_tracks)
    copy_vector(take(kinds, stay[:kept]), all_kinds)
    for i in range(kept):
        copy_vector(landmarks[stay[i]], all_landmarks[i])
    for i in range(count):
        all_tracks[kept + i], all_kinds[kept + i] = wanted[new[i]], kind[new[i]]
        copy_vector(position[new[i]], all_landmarks[kept + i])
    return enlarge(information, grown.shape[0], grown.shape[0]), grown, all_tracks, all_kinds, all_landmarks, valid


@compiled
def candidates(named, offsets, first, k, track, kind, likely, confirmed, tracks, kinds):
    """Tracks that may be variables after scan k: those that are already, with the same kind, and the confirmed ones with
    a measurement in the window; -2 in place of the others.
    """
    wanted = np.full(track.shape[0], NO_TRACK)
    for i in range(track.shape[0]):
        used = find(named[offsets[first] : offsets[k + 1]], track[i]) >= 0
        slot = find(tracks, track[i])
        if (slot >= 0 and kind[i] == kinds[slot]) or (likely[i] > confirmed and used):
            wanted[i] = track[i]
    return wanted


@compiled
def smooth(z, whiteners, offsets, chosen, map_offsets, track, kind, likely, position, spread, information, start,
           weight, pace, model, lag, delay, iterations, confirmed):  # fmt: skip
    """Smooth a whole run; overwrites `position` and `spread` of the map rows that are variables of the window.

    Returns
    -------
    means, covariances : (K, n), (K, n, n) arrays; of each step from the scans up to `delay` steps later
    failed : int; step with a singular information matrix, -1 if none
    """
    steps, n = offsets.shape[0] - 1, start.shape[0]
    means, covariances = np.empty((steps, n)), np.empty((steps, n, n))
    vector = np.zeros(n)
    for i in range(n):
        for j in range(n):
            vector[i] += information[i, j] * start[j]
    states = np.empty((1, n))
    copy_vector(start, states[0])
    tracks, kinds = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    landmarks = np.empty((0, 3))
    jacobian, own = np.empty((n, n)), np.arange(n)
    named = np.full(z.shape[0], NO_TRACK)
    first = 0  # scan after states[0]
    for k in range(steps):
        low, high = map_offsets[k], map_offsets[k + 1]
        for row in range(offsets[k], offsets[k + 1]):  # a measurement that bore a track bears its number
            born = chosen[row] == NO_TRACK and find(track[low:high], row) >= 0
            named[row] = row if born else chosen[row]
        moved = move_state(states[-1], model.site, model.interval * pace[k], model.turn_rate, jacobian)
        states = enlarge(states, states.shape[0] + 1, n)
        copy_vector(moved, states[-1])
        wanted = candidates(
            named, offsets, first, k, track[low:high], kind[low:high], likely[low:high], confirmed, tracks, kinds
        )
        information, vector, tracks, kinds, landmarks, valid = agree(
            information, vector, n, tracks, kinds, landmarks, wanted, kind[low:high], position[low:high]
        )
        when, which, rows = active(named, offsets, tracks, first, first, k + 1)
        states, landmarks, covariance, solved = solve_window(
            information,
            vector,
            states,
            landmarks,
            kinds,
            when,
            which,
            rows,
            z,
            whiteners,
            weight,
            pace[first:],
            model,
            iterations,
            min(delay, states.shape[0] - 2),
        )
        if not (valid and solved):
            return means, covariances, k
        back = min(delay, states.shape[0] - 2)
        for d in range(0 if k == steps - 1 else delay, back + 1):
            at = (back - d) * n
            copy_vector(states[states.shape[0] - 1 - d], means[k - d])
            copy_matrix(covariance[at : at + n, at : at + n], covariances[k - d])
        for i in range(low, high):
            slot = find(tracks, track[i])
            if slot >= 0:
                at = (back + 1) * n + 3 * slot
                copy_vector(landmarks[slot], position[i])
                copy_matrix(covariance[at : at + 3, at : at + 3], spread[i])
        if states.shape[0] > lag + 1:  # the next state's measurements join the prior, the tail state leaves
            when, which, rows = active(named, offsets, tracks, first, first, first + 1)
            information, vector, _ = build(
                information,
                vector,
                states[:2],
                landmarks,
                kinds,
                when,
                which,
                rows,
                z,
                whiteners,
                weight,
                pace[first:],
                model,
                False,
            )
            size = vector.shape[0]
            for i in range(size):  # g + Λ x: the normal equations as seen from the origin
                for j in range(size):
                    point = states[j // n, j % n] if j < 2 * n else landmarks[(j - 2 * n) // 3, (j - 2 * n) % 3]
                    vector[i] += information[i, j] * point
            information, vector, valid = eliminate(information, vector, np.arange(n, size), own)
            if not valid:
                return means, covariances, k
            states = states[1:].copy()
            first += 1
    return means, covariances, -1


def run(
    scans: Scans,
    prior: tuple[Array, Array],
    motion: MotionModel,
    bs: Array,
    parameters: FilterParameters | None = None,
    height: float = 0.0,
    smoothing: SmootherParameters | None = None,
) -> tuple[History, Diagnostics]:
    """Filter a whole run and smooth it with a fixed lag; the record holds the state and map at each step's
    own time, or `lag` steps later (`delayed`).

    Parameters as in `ek_pmb.run`, with `smoothing`. Unconfirmed landmarks are reported as the filter has
    them.
    """
    parameters, smoothing = parameters or FilterParameters(), smoothing or SmootherParameters()
    arrays = ek_pmb.scan_arrays(scans, parameters.doppler, motion.interval)
    history, diagnostics = ek_pmb.run(scans, prior, motion, bs, parameters, height, arrays)
    z, covariance, _, offsets, _, pace = arrays
    chosen = [np.empty(0, dtype=np.int64), *(a[0] for a in diagnostics.associations)]
    position, spread = history.position.copy(), history.position_covariance.copy()
    n = motion.dimension
    means, covariances, failed = smooth(
        z,
        np.stack([np.linalg.inv(np.linalg.cholesky(seen_noise(covariance, kind))) for kind in (BS, SR)]),
        offsets,
        np.concatenate(chosen),
        history.map_offsets,
        history.track,
        history.kind,
        history.existence * history.type_probability[np.arange(len(history.kind)), history.kind],
        position,
        spread,
        np.linalg.inv(prior[1] + KNOWN * np.eye(n)),
        np.ascontiguousarray(prior[0], dtype=float),
        np.linalg.inv(motion.process_noise + KNOWN * np.eye(n)),
        pace,
        compile_model(parameters, motion, bs, height),
        smoothing.lag,
        smoothing.lag if smoothing.delayed else 0,
        smoothing.iterations,
        smoothing.confirmed,
    )
    if failed >= 0:
        raise FilterError(
            f"smoother, step {failed}: information matrix is singular; use a longer lag or a tighter prior"
        )
    smoothed = replace(history, mean=means, covariance=covariances, position=position, position_covariance=spread)
    if smoothing.delayed:  # the map of that time stands beside the state
        told = smoothed.take(np.minimum(np.arange(scans.steps) + smoothing.lag, scans.steps - 1))
        smoothed = replace(told, mean=means, covariance=covariances)
    return smoothed, diagnostics
