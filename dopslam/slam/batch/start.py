"""Where a filter starts that is told nothing: the snapshots of a run joined, and its first scans smoothed with a map of their own.

A scan alone often leaves a ridge: place and clock trade against each other, or a turned world explains nearly as much. No
filter can be linearized there. Some scans that share their landmarks have no ridge any more.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dopslam.errors import FilterError
from dopslam.models import unmeasured
from dopslam.models.motion import CoordinatedTurn
from dopslam.models.scans import Scans
from dopslam.slam.batch.grow import Locate, grow
from dopslam.slam.batch.rows import rows_of
from dopslam.slam.batch.smoother import Choices, smooth
from dopslam.slam.batch.track import KNOWN, Chain
from dopslam.slam.snapshot import start as snapshot
from dopslam.slam.snapshot.candidates import Prior
from dopslam.slam.snapshot.locate import Search, find_modes

Array = NDArray[np.float64]

POSE = 4  # entries of a state that a snapshot tells
PLENTY = 0.95  # share of the detections explained from which the chain of snapshots is not doubted
WINDOW = 60  # scans that are smoothed for a start, at most
SOON = 1e-3  # periods after its start that a filter reads the scan at which it starts
TWICE = 2.0  # the filter reads these scans again: half their information is left for then (covariance intersection)


@dataclass(frozen=True, slots=True)
class Guide:
    """The track that the first scans of a run together have, with which a filter that started there can be compared.

    Attributes
    ----------
    state, covariance : (K + 1, n), (K + 1, n, n) arrays; from one step before the first scan on
    share : of the detections, that it explains
    kind, position : (L,), (L, 3) arrays; the base stations and landmarks that it has found
    """

    state: Array
    covariance: Array
    share: float
    kind: NDArray[np.int64]
    position: Array

    @property
    def steps(self) -> int:
        """Scans that it covers."""
        return len(self.state) - 1

    def later(self, steps: int) -> Guide:
        """The track of a run that begins so many steps earlier; of these it says nothing."""
        nothing = np.full((steps, *self.state.shape[1:]), np.nan)
        spread = np.full((steps, *self.covariance.shape[1:]), np.nan)
        return replace(
            self, state=np.concatenate([nothing, self.state]), covariance=np.concatenate([spread, self.covariance])
        )

    def begun(self, problem: Any, scans: Scans, step: int, intervals: bool) -> tuple[Any, Scans]:
        """Problem and scans from a step on, for a filter that starts on this track.

        The start is the state at the scan itself, which the filter is told to come right after: a period earlier nothing would
        be left of it where the motion says little. A filter that cannot be told so (``intervals``) starts a period earlier.
        """
        at = step + 1 if intervals else step
        begun = replace(problem, mean=self.state[at], covariance=TWICE * self.covariance[at], snapshot=False)
        rest = scans if step == 0 else scans.take(slice(step, None))
        if not intervals:
            return begun, rest
        interval = problem.motion.interval * rest.pace(problem.motion.interval)
        interval[0] = SOON * problem.motion.interval
        return begun, replace(rest, interval=interval)


def started(problem: Any, scans: Scans, doppler: bool) -> Any:
    """A :class:`~dopslam.slam.filter.Problem` with the start that the scans alone tell, where it asks for that: one period
    before the first of them."""
    problem, guide = guided(problem, scans, doppler)
    return problem if guide is None else guide.begun(problem, scans, 0, intervals=False)[0]


def guided(problem: Any, scans: Scans, doppler: bool) -> tuple[Any, Guide | None]:
    """The same for a filter that may start on the track of the first scans together; None where the start stems from single
    scans, or was told."""
    if not problem.snapshot:
        return problem, None
    found = snapshot.start(
        scans, problem.motion, problem.anchor, problem.height, prior=(problem.mean, problem.covariance), doppler=doppler
    )
    guide = None
    if isinstance(problem.motion, CoordinatedTurn) and not np.any(scans.anchor):
        with suppress(FilterError, np.linalg.LinAlgError):  # then the snapshots' own answer is left
            guide = _smoothed(problem, scans, found, doppler)
    return replace(problem, mean=found.mean, covariance=found.covariance, snapshot=False), guide


def _smoothed(problem: Any, scans: Scans, found: snapshot.Start, doppler: bool) -> Guide:
    """The track of the first scans together."""
    motion, first = problem.motion, scans.take(slice(0, WINDOW))
    data = rows_of(first, problem.stations.position, problem.height, motion.speed, doppler=doppler)
    state, covariance = track_of(problem, found, first.steps)
    information = np.asarray(np.linalg.inv(problem.covariance + KNOWN * np.eye(motion.dimension)), float)
    information[:POSE], information[:, :POSE] = 0.0, 0.0
    chain, choices = Chain(motion, state[0], information, first.pace(motion.interval)), Choices()
    results = [smooth(data, chain, state, covariance, choices)]
    if np.mean(results[0].owner >= 0) < PLENTY:
        results.append(grow(data, chain, state, covariance, choices, locator(problem, first, doppler)))
    chosen = max(results, key=lambda r: r.score)
    best = chosen.estimate
    if not (np.isfinite(best.state[0]).all() and np.linalg.eigvalsh(best.covariance[0])[0] > 0):
        raise FilterError("start: the first scans together leave no place")
    return Guide(best.state, best.covariance, float(np.mean(chosen.owner >= 0)), best.found.kind, best.found.position)


def track_of(problem: Any, found: snapshot.Start, steps: int) -> tuple[Array, Array]:
    """Track (K + 1, n) and covariances of the snapshots alone over K steps; speed and turn rate as told."""
    n = problem.motion.dimension
    state = np.tile(np.asarray(problem.mean, float), (steps + 1, 1))
    covariance = np.tile(np.asarray(problem.covariance, float), (steps + 1, 1, 1))
    covariance[:, :POSE, POSE:], covariance[:, POSE:, :POSE] = 0.0, 0.0
    state[0, :POSE], state[1:, :POSE] = found.mean[:POSE], found.chain.mean[:steps]
    covariance[0, :POSE, :POSE] = found.covariance[:POSE, :POSE]
    covariance[1:, :POSE, :POSE] = found.chain.covariance[:steps]
    return state, covariance + KNOWN * np.eye(n)


def locator(problem: Any, scans: Scans, doppler: bool) -> Locate:
    """How a scan is located with what is predicted for it."""
    search = Search(refined=60, iterations=10)
    planar = unmeasured.planar(np.einsum("nii->ni", scans.covariance))

    def locate(step: int, mean: Array, covariance: Array) -> tuple[Array, Array]:
        rays = snapshot.rays_of(scans, step, problem.anchor, problem.height, planar, doppler)
        modes = find_modes(rays, Prior(mean[:POSE], covariance[:POSE, :POSE]), search)
        state, spread = np.tile(mean, (len(modes), 1)), np.tile(covariance, (len(modes), 1, 1))
        spread[:, :POSE, POSE:], spread[:, POSE:, :POSE] = 0.0, 0.0
        state[:, :POSE], spread[:, :POSE, :POSE] = modes.pose, modes.covariance
        return state, spread

    return locate
