"""Landmarks given the track: fitted to their detections, judged by evidence, found by voting over the steps.

The track enters as states with covariances that are added to R (errors of neighboring steps taken as independent here;
the whole-run least squares has them jointly). The evidence of a landmark over "all its detections are false" is

    Σ_i [log p(z_i | x̂) − log c(z_i)] + log λ + ½ log |2πP|,

Laplace's integral over its place under a uniform density of landmarks λ: it decides whether there is a landmark, and of
which kind. A departure that is left unexplained counts with its uniform density.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from dopslam.models.measurement import SP, SR, VA
from dopslam.slam.batch.kernels import explain_rows
from dopslam.slam.batch.noise import Scales
from dopslam.slam.batch.rows import KINDS, Map, Rows, linearize, place

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LOOSE = 1e-6  # 1/m²: information on a landmark's place from nothing but being somewhere
STIFF = 1e6  # 1/m²: on its height where no elevation is measured
LEAST = 3  # steps that a landmark must be seen from
RELATED = 15.0  # deviations within which a landmark may be another's continuation
GATE = 30.0  # squared Mahalanobis distance beyond which a detection does not vote
EXPECTED = 10.0  # landmarks of a kind thought possible within the reach of the longest path
STEADY = 0.5  # share of a landmark's detections that must not be outliers
RARE = 0.1  # of those of several reflections


@dataclass(frozen=True, slots=True)
class Belief:
    """The track as the landmarks see it: states (K, n) at the scans, covariances (K, n, n), the noise of rows, and the
    length [m] of the longest path."""

    state: Array
    covariance: Array
    noise: Scales
    reach: float


def believe(data: Rows, state: Array, covariance: Array, noise: Scales) -> Belief:
    """The track as the landmarks see it."""
    longest = float(np.max(data.z[:, 0] - state[data.step, 3], initial=1.0))
    return Belief(np.ascontiguousarray(state), np.ascontiguousarray(covariance), noise, longest)


@dataclass(frozen=True, slots=True)
class Fit:
    """Landmarks fitted to groups of detections.

    Attributes
    ----------
    position : (G, 3), covariance : (G, 3, 3)
    evidence : (G,) over false detections; −inf where the detections contradict the landmark most of the time
    square : (M,) squared Mahalanobis length of each detection's residual
    """

    position: Array
    covariance: Array
    evidence: Array
    square: Array


def holds(data: Rows) -> Array:
    """(3,) information on every landmark's place that keeps it finite; the height is held where it cannot be seen."""
    return np.array([LOOSE, LOOSE, STIFF if data.flat else LOOSE])


def log_density(data: Rows, belief: Belief, kind: Index) -> Array:
    """log λ of landmarks per m³ (or m², the height being held): some, anywhere within the longest path."""
    expected = np.where(kind == SR, RARE, EXPECTED)
    height = np.sqrt(2 * np.pi / STIFF) if data.flat else 2 * belief.reach
    return np.log(expected / ((2 * belief.reach) ** 2 * height))


def explain(data: Rows, belief: Belief, rows: Index, group: Index, kind: Index, position: Array, covariance: Array):
    """How landmarks (G,) of kinds, positions and covariances explain detections `rows` (M,) of groups (M,).

    Returns log p(z) (M,), −inf where the path cannot exist, squared Mahalanobis lengths and weights (M,), and the normal
    equations (G, 3, 3), (G, 3) of the landmarks' places.
    """
    return explain_rows(
        rows, group, data.z, data.covariance, data.used, data.spans, data.step, belief.state, belief.covariance,
        data.station, data.stations, data.height, data.speed, kind, np.ascontiguousarray(position),
        np.ascontiguousarray(covariance), belief.noise.scale, belief.noise.share,
    )  # fmt: skip


def fit(data: Rows, belief: Belief, rows: Index, group: Index, kind: Index, start: Array, rounds: int = 6) -> Fit:
    """Fit landmarks (G,) of kinds (G,) from `start` (G, 3) to detections `rows` (M,) of groups (M,)."""
    count, hold = len(kind), np.diag(holds(data))
    position, nothing = np.array(start, float), np.zeros((count, 3, 3))
    reach = np.zeros(count)
    far = np.linalg.norm(position[group, :2] - belief.state[data.step[rows], :2], axis=1)
    np.maximum.at(reach, group, 0.3 * np.maximum(far, 1.0))
    for i in range(rounds + 1):
        density, square, weight, information, vector = explain(data, belief, rows, group, kind, position, nothing)
        information += hold
        if i < rounds:
            change = np.linalg.solve(information, vector[..., None])[..., 0]
            position += change / np.maximum(1.0, np.linalg.norm(change, axis=1) / np.maximum(reach, 1e-9))[:, None]
    inverse = np.linalg.inv(information)
    evidence = log_density(data, belief, kind) + 0.5 * np.linalg.slogdet(2 * np.pi * inverse)[1]
    evidence += np.bincount(group, np.where(np.isneginf(density), -1e3, density) - data.false[rows], count)
    ordinary = np.bincount(group, weight, count) / np.maximum(np.bincount(group, minlength=count), 1)
    evidence[ordinary < STEADY * belief.noise.weight] = -np.inf
    return Fit(position, inverse, evidence, square)


def decide_kinds(data: Rows, belief: Belief, found: Map, owner: Index, hold_on: float = 3.0) -> tuple[Map, Array]:
    """Every landmark as the kind that its detections speak for, and its evidence (J,).

    `owner` (N,) names the landmark of each detection, -1 none. A kind changes only for `hold_on` more evidence. Base
    stations stay what they are, with infinite evidence.
    """
    base = len(data.stations)
    rows = np.flatnonzero(owner >= base)
    count = len(found) - base
    if not count:
        return found, np.full(base, np.inf)
    group = owner[rows] - base
    best = _surest(data, belief, rows, group, count)
    kind, position, covariance = found.kind[base:].copy(), found.position[base:].copy(), found.covariance[base:].copy()
    evidence = np.full(count, -np.inf)
    trials = []
    for candidate in KINDS:
        kinds = np.full(count, candidate)
        start, _ = place(data, best, belief.state[data.step[best]], kinds)
        own = found.kind[base:] == candidate
        near = {VA: found.kind[base:] == SR, SR: found.kind[base:] == VA}.get(candidate, own) | own
        start[near] = found.position[base:][near]
        trials.append(fit(data, belief, rows, group, kinds, start))
    score = np.array([t.evidence for t in trials])
    score = np.where(np.isneginf(score).all(axis=0), 0.0, score)
    current = np.array([KINDS.index(k) for k in kind.tolist()])
    score[current, np.arange(count)] += hold_on
    for i, trial in enumerate(trials):
        chosen = np.argmax(score, axis=0) == i
        kind[chosen], position[chosen] = KINDS[i], trial.position[chosen]
        covariance[chosen], evidence[chosen] = trial.covariance[chosen], trial.evidence[chosen]
    judged = Map(kind, position, found.station[base:], covariance)
    return found.take(slice(0, base)).joined(judged), np.concatenate([np.full(base, np.inf), evidence])


def _surest(data: Rows, belief: Belief, rows: Index, group: Index, count: int) -> Index:
    """For every group the detection with the sharpest angles; row 0 for a group without any."""
    spread = np.einsum("nii->ni", data.covariance[rows])[:, 1] + belief.covariance[data.step[rows], 2, 2]
    best, order = np.zeros(count, dtype=np.int64), np.argsort(-spread, kind="stable")
    best[group[order]] = rows[order]
    return best


def _neighbors(data: Rows, seeds: Index, free: NDArray[np.bool_], window: int) -> tuple[Index, Index]:
    """Pairs (seed, detection): free detections within `window` steps of each seed, not of its own step."""
    rows = np.flatnonzero(free)
    step = data.step[rows]
    low = np.searchsorted(step, data.step[seeds] - window)
    high = np.searchsorted(step, data.step[seeds] + window, side="right")
    counts = high - low
    which = np.repeat(np.arange(len(seeds)), counts)
    other = rows[np.arange(counts.sum()) + np.repeat(low - np.concatenate([[0], np.cumsum(counts)[:-1]]), counts)]
    good = (data.step[other] != data.step[seeds[which]]) & (data.station[other] == data.station[seeds[which]])
    return which[good], other[good]


def vote(data: Rows, belief: Belief, owner: Index, count: int, window: int = 6) -> tuple[Map, Index]:
    """New landmarks among the detections that no landmark explains.

    Detections of some steps are tried first and take what belongs to their landmarks; then all that are left.

    Parameters
    ----------
    owner : (N,) landmark of each detection, -1 none
    count : landmarks so far
    window : steps on both sides from which a detection is supported at first

    Returns
    -------
    found : Map of the new landmarks
    owner : (N,) with their detections
    """
    owner, found = (
        owner.copy(),
        Map(np.empty(0, np.int64), np.empty((0, 3)), np.empty(0, np.int64), np.empty((0, 3, 3))),
    )
    for spacing in (window, 1):
        seeds = np.flatnonzero((owner < 0) & (data.step % spacing == spacing // 2))
        for seed in _promising(data, belief, seeds, owner < 0, window).tolist():
            if owner[seed] >= 0:
                continue
            grown = _grow(data, belief, owner < 0, seed, window)
            if grown is not None:
                owner[grown[1]] = count + len(found)
                found = found.joined(grown[0])
    return found, owner


def _promising(data: Rows, belief: Belief, seeds: Index, free: NDArray[np.bool_], window: int) -> Index:
    """Seeds that enough detections of other steps agree with, the best supported first."""
    best = np.zeros(len(seeds))
    for kind in KINDS if len(seeds) else ():
        kinds = np.full(len(seeds), kind)
        position, possible = place(data, seeds, belief.state[data.step[seeds]], kinds)
        own = fit(data, belief, seeds, np.arange(len(seeds)), kinds, position, rounds=2)
        good = np.flatnonzero(possible & (own.square < GATE * max(belief.noise.usual, 1.0)))
        which, other = _neighbors(data, seeds[good], free, window)
        if not len(which):
            continue
        gain = _gain(data, belief, other, good[which], kinds, own)
        # Of each step only the best detection votes.
        key = which * data.steps + data.step[other]
        order = np.lexsort((-gain, key))
        first = order[np.unique(key[order], return_index=True)[1]]
        score = np.bincount(which[first], np.maximum(gain[first], 0.0), len(good))
        votes = np.bincount(which[first], gain[first] > 0, len(good))
        best[good] = np.maximum(best[good], np.where(votes >= LEAST - 1, score, 0.0))
    order = np.argsort(-best, kind="stable")
    return seeds[order[best[order] > 0]]


def _gain(data: Rows, belief: Belief, rows: Index, group: Index, kind: Index, found: Fit) -> Array:
    """log p(z)/c(z) (M,) of detections for fitted landmarks; −inf beyond the gate."""
    density, square, *_ = explain(data, belief, rows, group, kind, found.position, found.covariance)
    return np.where(square < GATE * max(belief.noise.usual, 1.0), density - data.false[rows], -np.inf)


def _grow(data: Rows, belief: Belief, free, seed: int, window: int) -> tuple[Map, Index] | None:
    """The landmark with most evidence that a seed stands for, and its detections."""
    best, evidence = None, 0.0
    one, rows = np.zeros(1, np.int64), np.array([seed])
    for kind in KINDS:
        kinds = np.array([kind])
        position, possible = place(data, rows, belief.state[data.step[rows]], kinds)
        own = fit(data, belief, rows, one, kinds, position)
        if not possible[0] or not own.square[0] < GATE * max(belief.noise.usual, 1.0):
            continue
        grown = _gather(data, belief, free, rows, kinds, own, window)
        if grown is not None and grown[0].evidence[0] > evidence:
            evidence, (found, chosen) = grown[0].evidence[0], grown
            best = Map(kinds, found.position, data.station[rows], found.covariance), chosen
    return best


def _gather(data: Rows, belief: Belief, free, rows: Index, kind: Index, found: Fit, window: int):
    """A landmark's detections gathered along the track until they stand, and its fit to them."""
    low = high = int(data.step[rows[0]])
    station = data.station[rows[0]]
    for _ in range(12):
        near = np.arange(data.offsets[max(low - window, 0)], data.offsets[min(high + window + 1, data.steps)])
        near = near[free[near] & (data.station[near] == station)]
        gain = _gain(data, belief, near, np.zeros(len(near), np.int64), kind, found)
        order = np.lexsort((-gain, data.step[near]))
        order = order[np.unique(data.step[near][order], return_index=True)[1]]
        chosen = near[order[gain[order] > 0]]
        if len(chosen) < LEAST:
            return None
        same = np.array_equal(chosen, rows)
        rows, low, high = chosen, int(data.step[chosen].min()), int(data.step[chosen].max())
        found = fit(data, belief, rows, np.zeros(len(rows), np.int64), kind, found.position, rounds=3)
        if same:
            break
        window = min(2 * window, 48)
    return (found, rows) if found.evidence[0] > 0 else None


def merge(data: Rows, belief: Belief, found: Map, owner: Index, evidence: Array) -> tuple[Map, Index]:
    """Landmarks that are one: never seen at the same step, and with more evidence together than apart."""
    base = len(data.stations)
    for _ in range(3):
        pairs = _related(data, belief, found, owner)
        if not len(pairs):
            return found, owner
        members = [np.flatnonzero((owner == i) | (owner == j)) for i, j in pairs]
        rows, group = np.concatenate(members), np.repeat(np.arange(len(pairs)), [len(m) for m in members])
        larger = np.where(np.bincount(owner[owner >= 0], minlength=len(found))[pairs].argmax(axis=1) == 0, *pairs.T)
        best = np.full(len(pairs), -np.inf)
        kind, position = np.zeros(len(pairs), np.int64), np.zeros((len(pairs), 3))
        covariance = np.zeros((len(pairs), 3, 3))
        surest = _surest(data, belief, rows, group, len(pairs))
        for candidate in KINDS:
            kinds = np.full(len(pairs), candidate)
            start = place(data, surest, belief.state[data.step[surest]], kinds)[0]
            same = (found.kind[larger] == SP) == (candidate == SP)
            start[same] = found.position[larger][same]
            trial = fit(data, belief, rows, group, kinds, start, rounds=4)
            better = trial.evidence > best
            best[better], kind[better] = trial.evidence[better], candidate
            position[better], covariance[better] = trial.position[better], trial.covariance[better]
        gain = best - evidence[pairs].sum(axis=1)
        touched = np.zeros(len(found), bool)
        found = Map(found.kind.copy(), found.position.copy(), found.station, found.covariance.copy())
        evidence, owner = evidence.copy(), owner.copy()
        for p in np.argsort(-gain).tolist():
            i, j = pairs[p]
            if not gain[p] > 0 or touched[i] or touched[j]:
                continue
            touched[[i, j]] = True
            owner[owner == j] = i
            found.kind[i], found.position[i], found.covariance[i] = kind[p], position[p], covariance[p]
            evidence[i], evidence[j] = best[p], -np.inf
        if not touched.any():
            return found, owner
        keep = (evidence > -np.inf) | (np.arange(len(found)) < base)
        number = np.where(keep, np.cumsum(keep) - 1, -1)
        found, evidence, owner = found.take(keep), evidence[keep], np.where(owner >= 0, number[owner], -1)
    return found, owner


def _related(data: Rows, belief: Belief, found: Map, owner: Index) -> Index:
    """Pairs (P, 2) of landmarks without a common step, one of which predicts arrivals of the other near enough."""
    base, count = len(data.stations), len(found)
    rows = np.flatnonzero(owner >= base)
    seen = csr_array((np.ones(len(rows)), (owner[rows], data.step[rows])), shape=(count, data.steps))
    apart = (seen @ seen.T).toarray() == 0
    times = np.bincount(owner[rows], minlength=count)
    middle = np.bincount(owner[rows], data.step[rows], count) / np.maximum(times, 1)
    # Every landmark against the detection of the other that is nearest to its own middle.
    nearest = np.full((count, count), -1)
    for j in range(base, count):
        own = rows[owner[rows] == j]
        if len(own):
            at = np.searchsorted(data.step[own], middle)
            low, high = own[np.maximum(at - 1, 0)], own[np.minimum(at, len(own) - 1)]
            close = np.abs(data.step[low] - middle) < np.abs(data.step[high] - middle)
            nearest[:, j] = np.where(close, low, high)
    same = found.station[:, None] == found.station
    i, j = np.nonzero(apart & same & (nearest >= 0) & (np.arange(count)[:, None] >= base))
    if not len(i):
        return np.empty((0, 2), np.int64)
    row = nearest[i, j]
    law, step = np.where(found.kind[i] == VA, SR, found.kind[i]), data.step[row]
    linear = linearize(data, row, belief.state[step], law, found.position[i])
    variance = np.einsum("nii->ni", data.covariance[row])
    variance = variance + np.einsum("mia,mab,mib->mi", linear.by_state, belief.covariance[step], linear.by_state)
    variance += np.einsum("mia,mab,mib->mi", linear.by_point, found.covariance[i], linear.by_point)
    near = (linear.error**2 / variance < RELATED**2)[:, :3].all(axis=1)
    both = np.unique(np.sort(np.column_stack([i[near], j[near]]), axis=1), axis=0)
    return both[: 4 * count]
