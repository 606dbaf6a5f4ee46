"""Where a filter starts that is told nothing: the snapshots of a run joined, and its first scans smoothed with a map of their own.

A scan alone often leaves a ridge: place and clock trade against each other, or a turned world explains nearly as much. No
filter can be linearized there. Some scans that share their landmarks have no ridge any more.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
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
TWICE = 2.0  # the filter reads these scans again: half their information is left for then (covariance intersection)


def started(problem: Any, scans: Scans, doppler: bool) -> Any:
    """A :class:`~dopslam.slam.filter.Problem` with the start that the scans alone tell, where it asks for that."""
    if not problem.snapshot:
        return problem
    found = snapshot.start(
        scans, problem.motion, problem.anchor, problem.height, prior=(problem.mean, problem.covariance), doppler=doppler
    )
    mean, covariance = found.mean, found.covariance
    if isinstance(problem.motion, CoordinatedTurn) and not np.any(scans.anchor):
        with suppress(FilterError, np.linalg.LinAlgError):  # then the snapshots' own answer is left
            mean, covariance = _smoothed(problem, scans, found, doppler)
    return replace(problem, mean=mean, covariance=covariance, snapshot=False)


def _smoothed(problem: Any, scans: Scans, found: snapshot.Start, doppler: bool) -> tuple[Array, Array]:
    """Mean (n,) and covariance (n, n) one period before the first scan, from the first scans together."""
    motion, first = problem.motion, scans.take(slice(0, WINDOW))
    data = rows_of(first, problem.stations.position, problem.height, motion.speed, doppler=doppler)
    state, covariance = track_of(problem, found, first.steps)
    information = np.asarray(np.linalg.inv(problem.covariance + KNOWN * np.eye(motion.dimension)), float)
    information[:POSE], information[:, :POSE] = 0.0, 0.0
    chain, choices = Chain(motion, state[0], information, first.pace(motion.interval)), Choices()
    results = [smooth(data, chain, state, covariance, choices)]
    if np.mean(results[0].owner >= 0) < PLENTY:
        results.append(grow(data, chain, state, covariance, choices, locator(problem, first, doppler)))
    best = max(results, key=lambda r: r.score).estimate
    spread = TWICE * best.covariance[0]
    if not (np.isfinite(best.state[0]).all() and np.linalg.eigvalsh(spread)[0] > 0):
        raise FilterError("start: the first scans together leave no place")
    return best.state[0], spread


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
