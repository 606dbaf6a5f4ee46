"""What smoothing a whole run leaves behind, as the record of a history; and its recursion for those who want one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dopslam.models.measurement import BS
from dopslam.models.scans import Scans
from dopslam.records import edges_of
from dopslam.slam.batch.rows import Rows
from dopslam.slam.batch.smoother import Smoothed
from dopslam.slam.filter import Info, Problem
from dopslam.slam.history import TYPES, Diagnostics, Estimate, History
from dopslam.slam.pmb.density import BS_TRACK, NO_TRACK


@dataclass(frozen=True, slots=True)
class Prefix:
    """State of a smoother that reads scan by scan: what it has read."""

    problem: Problem
    scans: Scans | None = None

    def step(self, chosen: Any, scan: Scans, rng: np.random.Generator) -> tuple[Prefix, Info]:
        """All scans so far through ``chosen.run``; what is told is the newest state and the map."""
        scans = scan if self.scans is None else Scans.join([self.scans, scan])
        history, _ = chosen.run(self.problem, scans, rng)
        rows = history.rows(history.steps - 1)
        estimate = Estimate(
            history.mean[-1], history.covariance[-1], history.position[rows], history.position_covariance[rows],
            history.existence[rows], history.type_probability[rows], history.track[rows],
        )  # fmt: skip
        return Prefix(self.problem, scans), Info(estimate)


class Rerun:
    """Online form of a filter that reads the whole run: all scans so far anew; what is told is the newest state."""

    __slots__ = ()

    def init(self, problem: Problem, rng: np.random.Generator) -> Prefix:
        """No scans yet."""
        return Prefix(problem)

    def step(self, state: Prefix, scan: Scans, rng: np.random.Generator) -> tuple[Prefix, Info]:
        """All scans so far."""
        return state.step(self, scan, rng)


def history_of(data: Rows, result: Smoothed) -> History:
    """Smoothed states, and the map, which stands still, at every step."""
    found, steps = result.estimate.found, data.steps
    shown = np.flatnonzero(found.kind != BS)
    born = _first_rows(result, len(found))[shown]
    kind = found.kind[shown]
    existence = 1 / (1 + np.exp(-np.minimum(result.evidence[shown], 50.0)))
    return History(
        mean=result.estimate.state[1:],
        covariance=result.estimate.covariance[1:],
        map_offsets=edges_of(np.full(steps, len(shown))).astype(np.int64),
        position=np.tile(found.position[shown], (steps, 1)),
        position_covariance=np.tile(found.covariance[shown], (steps, 1, 1)),
        existence=np.tile(existence, steps),
        type_probability=np.tile(np.eye(TYPES)[kind], (steps, 1)),
        kind=np.tile(kind, steps).astype(np.int64),
        track=np.tile(born, steps).astype(np.int64),
    )


def _first_rows(result: Smoothed, count: int) -> NDArray[np.int64]:
    """The first detection of every landmark, by which it is numbered."""
    rows = np.flatnonzero(result.owner >= 0)
    first = np.zeros(count, dtype=np.int64)
    first[result.owner[rows[::-1]]] = rows[::-1]
    return first


def diagnostics_of(data: Rows, result: Smoothed) -> Diagnostics:
    """Residuals per step, over the rows that the fit leaves free, and the association."""
    estimate, owner = result.estimate, result.owner
    rows = np.flatnonzero(owner >= 0)
    used = data.used_by(rows, estimate.found.kind[owner[rows]]).sum(axis=1)
    taken = estimate.state.shape[1] * data.steps + 3 * (len(estimate.found) - len(data.stations))
    free = max(used.sum() - taken, 0) / max(used.sum(), 1)
    step = data.step[rows]
    first = _first_rows(result, len(estimate.found))
    named = np.where(owner < 0, NO_TRACK, np.where(owner < len(data.stations), BS_TRACK, first[owner]))
    parts = [slice(int(a), int(b)) for a, b in zip(data.offsets[:-1], data.offsets[1:], strict=True)]
    return Diagnostics(
        nis=np.bincount(step, estimate.square[rows], data.steps).astype(float),
        nis_rows=np.round(np.bincount(step, used * free, data.steps)).astype(np.int64),
        weights=tuple(np.ones(1) for _ in parts),
        associations=tuple(named[s][None] for s in parts),
        existence=tuple(np.ones(s.stop - s.start) for s in parts),
    )
