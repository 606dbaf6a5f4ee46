"""The whole-run smoother: rounds of association, voting, deciding kinds and least squares, until the association stands.

It starts from any track with covariances: a filter's, or the chain of snapshots. Landmarks of a filter may be given; those
that the detections do not speak for are dropped, and what no landmark explains votes for new ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dopslam.errors import FilterError
from dopslam.slam.batch.associate import associate
from dopslam.slam.batch.landmarks import LEAST, Belief, believe, decide_kinds, merge, vote
from dopslam.slam.batch.noise import GIVEN, Scales, learned
from dopslam.slam.batch.rows import Map, Rows, uniform
from dopslam.slam.batch.track import Chain, Estimate, optimize

OFTEN = 10  # detections of a landmark whose residuals tell of the noise

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Choices:
    """Choices of the whole-run smoother.

    Attributes
    ----------
    rounds : int
        Most rounds of association.
    """

    rounds: int = 12

    def __post_init__(self) -> None:
        if self.rounds < 1:
            raise FilterError(f"batch: rounds {self.rounds} must be 1 or more")


@dataclass(frozen=True, slots=True)
class Smoothed:
    """Result of the rounds.

    Attributes
    ----------
    estimate : Estimate
    owner : (N,) int array; landmark of each detection in `estimate.found`, -1 none
    evidence : (J,) of every landmark over its detections being false
    noise : Scales
    score : float; log evidence of the run: what starts are compared by
    rounds : int; taken
    """

    estimate: Estimate
    owner: Index
    evidence: Array
    noise: Scales
    score: float
    rounds: int


def only_stations(data: Rows) -> Map:
    """The map that is known: the base stations."""
    count = len(data.stations)
    return Map(np.zeros(count, np.int64), data.stations.copy(), np.arange(count), np.zeros((count, 3, 3)))


def smooth(
    data: Rows, chain: Chain, state: Array, covariance: Array, choices: Choices, found: Map | None = None
) -> Smoothed:
    """Rounds from a track (K + 1, n) with covariances (K + 1, n, n) until the association stands."""
    found = only_stations(data) if found is None else only_stations(data).joined(found)
    return _rounds(data, chain, state, covariance, choices, found)


def scaled(data: Rows, chain: Chain, result: Smoothed, choices: Choices) -> Smoothed:
    """More rounds from a result with the covariances as given, in which it is learned how far they are wrong.

    Only then: residuals of a track that is still wrong tell of the track.
    """
    estimate = result.estimate
    return _rounds(data, chain, estimate.state, estimate.covariance, choices, estimate.found, result)


def _rounds(
    data: Rows,
    chain: Chain,
    state: Array,
    covariance: Array,
    choices: Choices,
    found: Map,
    given: Smoothed | None = None,
) -> Smoothed:
    noise = GIVEN if given is None else _learned(data, given.estimate, given.owner)
    owner, done, settled = np.full(len(data.z), -2), 0, False
    while done < choices.rounds and not settled:
        done += 1
        belief = believe(data, state[1:], covariance[1:], noise)
        before = owner
        found, owner, evidence = _associated(data, belief, found)
        estimate = optimize(data, chain, noise, owner, state, found)
        state, covariance, found = estimate.state, estimate.covariance, estimate.found
        settled = np.array_equal(owner, before)
        if given is not None and not settled:
            noise = _learned(data, estimate, owner)
    return Smoothed(estimate, owner, evidence, noise, _score(data, estimate, owner), done)


def _associated(data: Rows, belief: Belief, found: Map) -> tuple[Map, Index, Array]:
    """Association, new landmarks, kinds; landmarks without evidence are dropped and their detections freed."""
    base = len(data.stations)
    owner = associate(data, belief, found)
    found, owner, _ = _kept(found, owner, base, np.full(len(found), np.inf))
    new, owner = vote(data, belief, owner, len(found))
    found, evidence = decide_kinds(data, belief, found.joined(new), owner)
    found, owner, evidence = _kept(found, owner, base, evidence)
    found, owner = merge(data, belief, found, owner, evidence)
    return found, owner, evidence


def _kept(found: Map, owner: Index, base: int, evidence: Array) -> tuple[Map, Index, Array]:
    count = np.bincount(owner[owner >= 0], minlength=len(found))
    good = (count >= LEAST) & (evidence > 0)
    good[:base] = True
    number = np.where(good, np.cumsum(good) - 1, -1)
    return found.take(good), np.where(owner >= 0, number[owner], -1), evidence[good]


def _learned(data: Rows, estimate: Estimate, owner: Index) -> Scales:
    """Scales from the residuals of what is seen often: a landmark of three detections is fitted to their errors."""
    base = len(data.stations)
    rows = np.flatnonzero(owner >= 0)
    count = np.bincount(owner[rows], minlength=len(estimate.found))
    often = (count >= OFTEN) | (np.arange(len(count)) < base)
    if count[often].sum() >= 0.3 * len(rows):
        rows = rows[often[owner[rows]]]
    used = data.used_by(rows, estimate.found.kind[owner[rows]]).sum(axis=1)
    # Residuals are smaller than errors by what the fit took: as many rows as there are unknowns, those of the track
    # in proportion.
    seen = np.unique(owner[rows])
    free = 4 * data.steps * count[seen].sum() / count.sum() + (2 if data.flat else 3) * np.sum(seen >= base)
    shrink = max(1.0 - free / max(used.sum(), 1), 0.3)
    return learned(estimate.square[rows] / shrink, used)


def _score(data: Rows, estimate: Estimate, owner: Index) -> float:
    """log evidence of the run: Laplace's integral over track and map, and the uniform density of what is free."""
    rows = np.flatnonzero(owner >= 0)
    used = data.used_by(rows, estimate.found.kind[owner[rows]])
    variance = np.linalg.slogdet(np.where(used[:, :, None] & used[:, None, :], data.covariance[rows], np.eye(6)))[1]
    told = -0.5 * variance - 0.5 * used.sum(axis=1) * np.log(2 * np.pi)
    told = told + uniform(data.spans, data.used[rows] & ~used) - data.false[rows]
    return float(told.sum() - estimate.cost - 0.5 * estimate.log_determinant)
