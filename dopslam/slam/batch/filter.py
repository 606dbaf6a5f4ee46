"""The whole-run smoother as an entry of the table of filters: its starts, and its result as a history.

It starts from the joint filter, or from the snapshots where nothing is told of the start, the filter fails, or leaves too
much of the detections unexplained, and from the surest windows of the run outwards where the snapshots explain little
as well; of several results the one with most evidence counts. Every step's estimate uses the
scans of the whole run: it is to be compared with the smoothing bound.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from dopslam.errors import FilterError
from dopslam.models.scans import Scans
from dopslam.slam.batch.grow import grow
from dopslam.slam.batch.result import Rerun, diagnostics_of, history_of
from dopslam.slam.batch.rows import Map, rows_of
from dopslam.slam.batch.smoother import Choices, scaled, smooth
from dopslam.slam.batch.start import PLENTY, POSE, locator, track_of
from dopslam.slam.batch.track import KNOWN, Chain
from dopslam.slam.filter import Capabilities, Problem
from dopslam.slam.history import Diagnostics, History
from dopslam.slam.pmb.filters import Joint
from dopslam.slam.snapshot import start as snapshot

Array = NDArray[np.float64]

ENOUGH = 0.8  # share of the detections that a good start explains
REPORTED = 0.5  # existence from which a filter's landmark is tried


@dataclass(frozen=True, slots=True, kw_only=True)
class Batch(Rerun):
    """Robust least squares over all detections of a run, their association re-estimated in rounds.

    ``step`` smooths all scans so far anew; ``run`` is the intended way.

    Attributes
    ----------
    doppler : use the Doppler row
    noise : ``"given"`` takes the detections' covariances as they are, up to rare outliers; ``"scaled"`` learns from the
        residuals how far they are wrong
    rounds : most rounds of association
    """

    capabilities = Capabilities(states=(4, 6), whole_run=True, intervals=True)
    largest_order: ClassVar[int | None] = 1

    doppler: bool = True
    noise: Literal["given", "scaled"] = "given"
    rounds: int = 12

    def __post_init__(self) -> None:
        if self.noise not in ("given", "scaled"):
            raise FilterError(f'batch: noise {self.noise!r} must be "given" or "scaled"')

    def run(self, problem: Problem, scans: Scans, rng: np.random.Generator) -> tuple[History, Diagnostics]:
        """Smooth a whole run.

        Raises
        ------
        FilterError
            If neither the filter nor the snapshots give a start.
        """
        motion, pace = problem.motion, scans.pace(problem.motion.interval)
        data = rows_of(scans, problem.stations.position, problem.height, problem.speed, doppler=self.doppler)
        information = np.asarray(np.linalg.inv(problem.covariance + KNOWN * np.eye(motion.dimension)), float)
        if problem.snapshot:
            information[:POSE], information[:, :POSE] = 0.0, 0.0
        choices, result, failure = Choices(self.rounds), None, None
        if not problem.snapshot:
            chain = Chain(motion, np.asarray(problem.mean, float), information, pace)
            try:
                state, covariance, found = _filtered(problem, scans, rng, self.doppler)
                result = smooth(data, chain, state, covariance, choices, found)
            except FilterError as error:
                failure = error
        if result is None or np.mean(result.owner >= 0) < ENOUGH:
            try:
                state, covariance = _located(problem, scans, self.doppler)
                mean = state[0] if problem.snapshot else problem.mean
                chain = Chain(motion, np.asarray(mean, float), information, pace)
                others = [smooth(data, chain, state, covariance, choices)]
                if np.mean(others[0].owner >= 0) < PLENTY:
                    others.append(grow(data, chain, state, covariance, choices, locator(problem, scans, self.doppler)))
                result = max([r for r in (result, *others) if r is not None], key=lambda r: r.score)
            except FilterError as error:
                if result is None:
                    raise failure or error from error
        if self.noise == "scaled":
            result = scaled(data, chain, result, choices)
        return history_of(data, result), diagnostics_of(data, result)


def _filtered(problem: Problem, scans: Scans, rng: np.random.Generator, doppler: bool) -> tuple[Array, Array, Map]:
    """Track (K + 1, n), covariances and landmarks that the joint filter leaves."""
    history, _ = Joint(doppler=doppler).run(problem, scans, rng)
    last = {int(history.track[row]): row for row in np.flatnonzero(history.existence > REPORTED)}
    rows = np.array(sorted(last.values()), dtype=np.int64)
    station = np.zeros(len(rows), dtype=np.int64)
    found = Map(history.kind[rows], history.position[rows], station, history.position_covariance[rows])
    state = np.vstack([problem.mean, history.mean])
    return state, np.concatenate([np.asarray(problem.covariance)[None], history.covariance]), found


def _located(problem: Problem, scans: Scans, doppler: bool) -> tuple[Array, Array]:
    """Track (K + 1, n) and covariances from the snapshots alone; speed and turn rate as told."""
    found = snapshot.start(
        scans, problem.motion, problem.anchor, problem.height, prior=(problem.mean, problem.covariance), doppler=doppler
    )
    return track_of(problem, found, scans.steps)
