"""Fixed-interval smoothing of the joint filter: every step's state from the scans of the whole run.

The filter's own associations and landmark types are kept; track and map are estimated once, together, by the robust
least squares of :mod:`dopslam.slam.batch.track`. What the filter left unassociated stays so: `batch` goes further.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dopslam.models.scans import Scans
from dopslam.slam.batch.landmarks import LEAST
from dopslam.slam.batch.noise import GIVEN
from dopslam.slam.batch.result import Rerun, diagnostics_of, history_of
from dopslam.slam.batch.rows import Map, rows_of
from dopslam.slam.batch.smoother import Smoothed, only_stations
from dopslam.slam.batch.start import started
from dopslam.slam.batch.track import KNOWN, Chain, optimize
from dopslam.slam.filter import Capabilities, Problem
from dopslam.slam.history import Diagnostics, History
from dopslam.slam.pmb.density import BS_TRACK, NO_TRACK
from dopslam.slam.pmb.filters import Joint


@dataclass(frozen=True, slots=True, kw_only=True)
class Interval(Rerun):
    """Joint filter, smoothed over the whole run on its own associations.

    ``step`` filters and smooths all scans so far anew; ``run`` is the intended way.

    Attributes
    ----------
    doppler, iterations, associations, gate : of the joint filter
    confirmed : existence at its end from which a landmark's detections are used
    """

    capabilities = Capabilities(states=(4, 6), whole_run=True, intervals=True)
    largest_order: ClassVar[int | None] = 1

    doppler: bool = True
    iterations: int = 3
    associations: int = 10
    gate: float = 40.0
    confirmed: float = 0.5

    def run(self, problem: Problem, scans: Scans, rng: np.random.Generator) -> tuple[History, Diagnostics]:
        """Filter a whole run, then smooth it."""
        problem = started(problem, scans, self.doppler)
        joint = Joint(doppler=self.doppler, iterations=self.iterations, associations=self.associations, gate=self.gate)
        history, diagnostics = joint.run(problem, scans, rng)
        data = rows_of(scans, problem.stations.position, problem.height, problem.speed, doppler=self.doppler)
        found, owner = _mapped(only_stations(data), history, diagnostics, self.confirmed)
        information = np.asarray(np.linalg.inv(problem.covariance + KNOWN * np.eye(problem.motion.dimension)), float)
        chain = Chain(problem.motion, np.asarray(problem.mean, float), information, scans.pace(problem.motion.interval))
        estimate = optimize(data, chain, GIVEN, owner, np.vstack([problem.mean, history.mean]), found)
        result = Smoothed(estimate, owner, np.full(len(found), 50.0), GIVEN, -estimate.cost, 1)
        return history_of(data, result), diagnostics_of(data, result)


def _mapped(base: Map, history: History, diagnostics: Diagnostics, confirmed: float):
    """Landmarks confirmed at their end, and the landmark (N,) of every detection by the likeliest associations."""
    last = {int(history.track[row]): row for row in range(len(history.track))}
    rows = np.array([r for r in last.values() if history.existence[r] > confirmed], dtype=np.int64)
    number = {int(history.track[r]): len(base) + i for i, r in enumerate(rows)}
    named = np.concatenate([np.empty(0, np.int64), *(a[0] for a in diagnostics.associations)])
    # A track is numbered by the detection that bore it, which was new then.
    named = np.where((named == NO_TRACK) & np.isin(np.arange(len(named)), list(number)), np.arange(len(named)), named)
    owner = np.array([0 if t == BS_TRACK else number.get(int(t), -1) for t in named], dtype=np.int64)
    seen = np.bincount(owner[owner >= 0], minlength=len(base) + len(rows))
    keep = (seen >= LEAST) | (np.arange(len(seen)) < len(base))
    order = np.where(keep, np.cumsum(keep) - 1, -1)
    station = np.zeros(len(rows), dtype=np.int64)
    found = base.joined(Map(history.kind[rows], history.position[rows], station, history.position_covariance[rows]))
    return found.take(keep), np.where(owner >= 0, order[owner], -1)
