"""Whether a filter has lost its receiver, told from its own history and the measurements alone: no truth, no internals.

Every step's state and the landmarks that were declared the step before predict measurements; a measurement near one of
them is explained. The base station is the one landmark whose place is known. A filter that is lost does not explain it
any more, and leaves more measurements unexplained than false ones are expected, or explains its line of sight in
direction but not in length. A receiver that is only hidden from the base station goes on explaining the other paths.

Works on any filter's history. What is judged is its end, or what went on for at least half of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2

from dopslam.models.measurement import BS, SP, jacobians, measure, residual
from dopslam.models.scans import Scans
from dopslam.models.unmeasured import UNSEEN
from dopslam.slam.history import History

Array = NDArray[np.float64]

ROWS = 5  # of a measurement that are looked at: what Doppler says depends on a speed that need not be known
BEYOND = 1.4e-4  # of the right ones lie beyond the squared Mahalanobis distance that is near: 25 of five rows
GATE = chi2.isf(BEYOND, np.arange(1, ROWS + 1))  # by the number of rows that were measured, less one
DECLARED = 0.5  # existence of a landmark from which it counts
FEWEST = 5  # steps with measurements without the base station before anything is said
PAIRS = 20_000  # of measurement and landmark that are looked at together
NEWBORN = 2  # measurements of a new landmark before it is declared
DEVIATIONS = 4.5  # of a number of measurements, or of a sum of squares, above its mean that are no accident
ASTRAY = 0.4  # share of steps that show the line of sight at another length
FAR = 3.0  # mean squared distance per row of what is explained; 1 is expected


@dataclass(frozen=True, slots=True)
class Explained:
    """What a history explains of the measurements, one entry per step.

    Attributes
    ----------
    measured, explained : (K,) numbers of measurements
    sighted : (K,) bool; the base station is among what is explained
    shifted : (K,) bool; it is in direction, but not in length
    distance : (K,) sum of the squared Mahalanobis distances of what is explained
    rows : (K,) measured rows of what is explained
    fresh : (K,) landmarks declared for the first time
    too_far : (K,) bool; the base station is farther than most paths are long, which is impossible
    """

    measured: NDArray[np.int64]
    explained: NDArray[np.int64]
    rows: NDArray[np.int64]
    sighted: NDArray[np.bool_]
    shifted: NDArray[np.bool_]
    distance: Array
    fresh: NDArray[np.int64]
    too_far: NDArray[np.bool_]


def explained(history: History, scans: Scans, station: Array, height: float) -> Explained:
    """Compare the measurements of every step with the state after it and the landmarks declared the step before."""
    steps, measured = history.steps, np.diff(scans.offsets)
    mapped = np.repeat(np.arange(steps), np.diff(history.map_offsets))  # step of every row of the map
    declared = history.existence > DECLARED
    fresh = np.bincount(mapped[declared][np.unique(history.track[declared], return_index=True)[1]], minlength=steps)
    # A landmark whose departure is free explains anything that comes again, from whatever wrong place.
    places = _Places(history, np.flatnonzero(declared & (history.kind <= SP)), mapped, station, height)
    pairs = measured * (1 + np.bincount(mapped[places.row] + 1, minlength=steps + 1)[:steps])
    block = np.cumsum(pairs) // PAIRS
    parts = [_explained_of(places, scans, np.flatnonzero(block == b)) for b in np.unique(block)]
    near, told, distance, sighted, shifted = (np.concatenate(part) for part in zip(*parts, strict=True))
    apart = np.hypot(np.linalg.norm(history.mean[:, :2] - station[:2], axis=1), height - station[2])
    spread = np.sqrt(np.trace(history.covariance[:, :2, :2], axis1=1, axis2=2) + history.covariance[:, 3, 3])
    too_far = (measured > 0) & (apart - 5.0 * spread > _medians(scans) - history.mean[:, 3])
    return Explained(measured, near, told, sighted, shifted & ~sighted, distance, fresh, too_far)


@dataclass(frozen=True, slots=True)
class _Places:
    """What a history says of where things are: `row` are the rows of landmarks in it, `mapped` the step of every row."""

    history: History
    row: NDArray[np.int64]
    mapped: NDArray[np.int64]
    station: Array
    height: float


def _explained_of(places: _Places, scans: Scans, steps: NDArray[np.int64]):
    """Of a series of steps (S,): measurements near something, their measured rows, the sum of their squared distances, whether
    one of them is near the base station, and whether one is in direction."""
    rows = slice(scans.offsets[steps[0]], scans.offsets[steps[-1] + 1])
    z, covariance = scans.z[rows], scans.covariance[rows]
    of = np.repeat(np.arange(len(steps)), np.diff(scans.offsets)[steps])
    predicted, own, first = _predicted(places, steps)
    # every measurement with the base station and the landmarks of its step, the base station first
    many = np.diff(first)[of]
    start = np.cumsum(many) - many
    which = np.repeat(first[of] - start, many) + np.arange(many.sum())
    each = np.repeat(np.arange(len(z)), many)
    off = residual(z[each], predicted[which])[:, :ROWS]
    total = own[which] + covariance[each, :ROWS, :ROWS]
    total = 0.5 * (total + total.swapaxes(-1, -2))
    squared = _squared(off, total)
    nearest = np.minimum.reduceat(squared, start) if len(z) else np.empty(0)
    measured = _measured(covariance)
    gate = GATE[measured - 1]
    near, in_direction = nearest < gate, _squared(off[start, 1:], total[start, 1:, 1:]) < gate

    def summed(values: ArrayLike) -> Array:
        return np.asarray(np.bincount(of, np.asarray(values, float), minlength=len(steps)), float)

    counts = (summed(near).astype(int), summed(near * measured).astype(int))
    return *counts, summed(near * nearest), summed(squared[start] < gate) > 0, summed(in_direction) > 0


def _predicted(places: _Places, steps: NDArray[np.int64]) -> tuple[Array, Array, NDArray[np.int64]]:
    """Predicted measurements (P, 6) and their covariances (P, 5, 5) without noise, of the base station and of the landmarks of
    the step before, step by step, and (S + 1,) where each step begins."""
    history, last = places.history, places.mapped[places.row] + 1
    row = places.row[(last >= steps[0]) & (last <= steps[-1])]
    owner = np.concatenate([steps, places.mapped[row] + 1])
    order = np.argsort(owner, kind="stable")
    count, owner = len(steps), owner[order]
    position = np.vstack([np.broadcast_to(places.station, (count, 3)), history.position[row]])[order]
    kind = np.concatenate([np.full(count, BS), history.kind[row]])[order]
    spread = np.concatenate([np.zeros((count, 3, 3)), history.position_covariance[row]])[order]
    told = (history.mean[owner], position, kind, places.station)
    by_state, by_landmark = (part[..., :ROWS, :] for part in jacobians(*told, height=places.height))
    own = by_state @ history.covariance[owner] @ by_state.swapaxes(-1, -2)
    own = own + by_landmark @ spread @ by_landmark.swapaxes(-1, -2)
    first = np.searchsorted(owner, np.append(steps, steps[-1] + 1))
    return measure(*told, height=places.height), own, first


def _medians(scans: Scans) -> Array:
    """(K,) medians of the path lengths of every scan; not a number where there is none."""
    count, start = np.diff(scans.offsets), scans.offsets[:-1]
    length = scans.z[:, 0][np.lexsort((scans.z[:, 0], np.repeat(np.arange(scans.steps), count)))]
    some = count > 0
    result = np.full(scans.steps, np.nan)
    middle = 0.5 * (length[(start + (count - 1) // 2)[some]] + length[(start + count // 2)[some]])
    result[some] = middle
    return result


def _measured(covariance: Array) -> NDArray[np.int64]:
    """(M,) rows that tell anything, of those that are looked at; the delay always does."""
    return 1 + np.sum(np.einsum("nii->ni", covariance)[:, 1:ROWS] < UNSEEN[1:ROWS], axis=1)


def _squared(off: Array, covariance: Array) -> Array:
    """offᵀ S⁻¹ off (...); what is known exactly, or twice, is known to a part in 10⁵."""
    scale = np.sqrt(np.maximum(np.einsum("...ii->...i", covariance), 1e-300))
    matrix = covariance / (scale[..., :, None] * scale[..., None, :]) + 1e-10 * np.eye(off.shape[-1])
    unit = off / scale
    return np.einsum("...i,...i->...", unit, np.linalg.solve(matrix, unit[..., None])[..., 0])


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a history and its measurements say of the receiver.

    Attributes
    ----------
    reason : why it counts as lost, in a clause; empty if nothing speaks for it
    since : step from which it is; 0 where nothing does
    """

    reason: str = ""
    since: int = 0


def divergence(history: History, scans: Scans, station: Array, height: float) -> str:
    """Why the receiver counts as lost, in a clause; empty if nothing speaks for it. As :func:`judge`."""
    return judge(history, scans, station, height).reason


def judge(history: History, scans: Scans, station: Array, height: float) -> Verdict:
    """Whether, why and since when the receiver counts as lost.

    Parameters
    ----------
    history : of any filter
    scans : what it read
    station : (3,) m, the base station
    height : m, of the receiver's plane
    """
    finite = np.isfinite(history.mean).all(axis=1) & np.isfinite(history.covariance).all(axis=(1, 2))
    if not finite.all():
        broken = int(np.argmin(finite))
        return Verdict(f"its state is no number from step {broken} on", broken)
    seen = explained(history, scans, np.asarray(station, float), height)
    steps = np.flatnonzero(seen.measured > 0)
    last = steps[-2 * FEWEST :]
    if seen.explained[last].sum() >= FEWEST:
        spread = seen.distance[last].sum() / seen.rows[last].sum()
        if spread > FAR:
            return Verdict(
                f"what it still explains is {spread:.1f} times as far off as it claims (1 is expected)",
                _far_since(seen, steps),
            )
    lost = _longest_blind(seen, steps)
    if len(lost) < FEWEST or not (lost[-1] == steps[-1] or 2 * len(lost) >= len(steps)):
        return Verdict()
    return Verdict(why, int(lost[0])) if (why := _why_blind(seen, steps, lost, scans)) else Verdict()


def _why_blind(seen: Explained, steps: NDArray[np.int64], lost: NDArray[np.int64], scans: Scans) -> str:
    """What shows that these steps are not merely without a line of sight; empty if nothing does."""
    where = f"from step {lost[0]} to {lost[-1]} the base station is never where it should be"
    # False detections come at steps without any other too: the silent steps between have their share of what is expected.
    span = int(lost[-1] - lost[0]) + 1
    most = 2 * span * scans.clutter_count
    if not seen.explained[lost].any() and seen.measured[lost].sum() > most + DEVIATIONS * np.sqrt(most):
        return f"{where}, nor is anything of the map"
    if seen.shifted[lost].mean() > ASTRAY:
        return f"{where}: right in direction, wrong in length"
    if seen.too_far[lost].mean() > 0.5:
        return f"{where}, and it would be farther than most paths are long"
    open_, sighted = seen.measured - seen.explained, steps[seen.sighted[steps]]
    usual = max(float(scans.clutter_count), float(open_[sighted].mean()) if len(sighted) >= FEWEST else 0.0)
    expected = max(usual * span + NEWBORN * seen.fresh[lost].sum(), 1.0)
    found, rows = int(open_[lost].sum()), int(seen.rows[lost].sum())
    if found > expected + DEVIATIONS * np.sqrt(expected):
        return f"{where}, and {found} detections are unexplained where {expected:.0f} are usual"
    squared = float(seen.distance[lost].sum())
    if squared > rows + DEVIATIONS * np.sqrt(2 * rows):  # a chi-square sum of as many degrees of freedom
        return f"{where}, and what is explained is {squared / rows:.1f} times as far off as it claims (1 is expected)"
    return ""


def _far_since(seen: Explained, steps: NDArray[np.int64]) -> int:
    """The step from which what is explained has been too far off until the end."""
    rows, squared = seen.rows[steps][::-1].cumsum(), seen.distance[steps][::-1].cumsum()
    far = np.flatnonzero(squared > FAR * np.maximum(rows, 1))
    return int(steps[len(steps) - 1 - far[-1]]) if len(far) else int(steps[0])


def _longest_blind(seen: Explained, steps: NDArray[np.int64]) -> NDArray[np.int64]:
    """The longest series of steps with measurements in which the base station is not explained."""
    sights = np.concatenate([[-1], np.flatnonzero(seen.sighted[steps]), [len(steps)]])
    longest = int(np.argmax(np.diff(sights)))
    return steps[sights[longest] + 1 : sights[longest + 1]]
