"""A filter that has lost its receiver is found out by its own history, and started anew from what the scans tell.

Where the start was found from the first scans together, their track is a second witness: a filter that leaves it by more than
it can account for is started anew on it, from there.

Works on any filter's whole run (:func:`watched`). Up to the step from which the receiver was lost its history stands;
from there on the filter runs again, from a start that the next scans alone give (:mod:`dopslam.slam.snapshot`). The map
from before stays where the new run does not find the same landmark again. What is lost from the beginning on has a wrong
start, and is run anew as a whole. A new run that is lost as well is discarded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from dopslam.errors import FilterError
from dopslam.models.measurement import measure, residual, wrap
from dopslam.models.scans import Scans
from dopslam.models.unmeasured import UNSEEN
from dopslam.records import edges_of
from dopslam.slam.batch.start import Guide, guided
from dopslam.slam.health import DECLARED, FEWEST, ROWS, Verdict, explained, judge
from dopslam.slam.history import Diagnostics, History

Told = tuple[History, Diagnostics]
Problem = Any  # of dopslam.slam.filter, which calls this module
Go = Callable[[Problem, Scans], Told]

MOST = 3  # restarts of one run
WINDOW = 20  # scans that a start is found from
ASTRAY = 100.0  # squared distance from the track of the first scans: five deviations in each of four entries
APART = 9.0  # mean square by which measurements tell two tracks apart: what is nearer is overconfident, but not lost
POSE = 4  # entries that are compared
SAME = 16.0  # squared Mahalanobis distance of two estimates of one landmark: 1.1e-3 of the right ones lie beyond


def watched(problem: Problem, scans: Scans, go: Go, *, whole: bool, doppler: bool, intervals: bool) -> Told:
    """Run a filter, and again from where it lost its receiver.

    Parameters
    ----------
    problem : what the filter is told
    scans : of the whole run
    go : runs the filter on a problem and scans
    whole : whether its estimates use the scans of the whole run, so that no part of them stands alone
    doppler : whether a start may use Doppler
    intervals : whether the filter honours any time between scans

    Returns
    -------
    History, Diagnostics
        ``history.restarted`` says from where and why, ``history.lost`` what no new start has mended.

    Raises
    ------
    FilterError
        What the filter raised, if a new start does not mend it.
    """
    guide = None
    if not whole:
        problem, guide = guided(problem, scans, doppler)
    watch = _Watch(problem, scans, go, whole, doppler, intervals, guide)
    told, verdict, failure = watch.tried()
    said: list[str] = []
    for _ in range(MOST):
        if not verdict.reason or (told is None and problem.snapshot):
            break
        better = watch.better(told, verdict)
        if better is None:
            break
        first, told, new = better
        said.append(f"from step {first}: {verdict.reason}")
        verdict = new
    if told is None:
        raise failure or FilterError(verdict.reason)
    return replace(told[0], restarted="; ".join(said), lost=verdict.reason), told[1]


@dataclass(frozen=True, slots=True)
class _Watch:
    """A run that is watched: what :func:`watched` is told, and the track of the first scans, where these gave the start."""

    problem: Problem
    scans: Scans
    go: Go
    whole: bool
    doppler: bool
    intervals: bool
    guide: Guide | None

    def tried(self) -> tuple[Told | None, Verdict, FilterError | None]:
        """What the first run leaves and what is to be thought of it; one that ends with an error is lost from the beginning."""
        try:
            told = self.go(*self._begun(self.problem, 0, self.guide))
        except FilterError as error:
            return None, Verdict(str(error)), error
        return told, self.judged(told[0]), None

    def better(self, told: Told | None, verdict: Verdict) -> tuple[int, Told, Verdict] | None:
        """A step from which another run mends what the verdict says, that run, and the verdict on it; None if none does."""
        since = 0 if self.whole or told is None else verdict.since
        guide = self.guide
        if guide is not None and told is not None and since < guide.steps:
            # What the first scans say together is not found anew from fewer of them.
            tried = [(first, guide) for first in (since, since + 2, since + FEWEST) if 0 < first < guide.steps]
        else:
            tried = [(first, None) for first in dict.fromkeys([since if since >= FEWEST else 0, 0])]
        for first, along in tried:
            new = self._anew(told, first, along)
            # Lost only much later is an improvement too: another start may mend that.
            if new is not None and (not new[1].reason or new[1].since >= verdict.since + 2 * FEWEST):
                return first, *new
        return None

    def _anew(self, told: Told | None, first: int, guide: Guide | None) -> tuple[Told, Verdict] | None:
        """The run with another one from step ``first`` on, and the verdict on it; None if there is no start or no end.

        It starts on the guide's track, or where there is none is located from the next scans.
        """
        try:
            problem = replace(self.problem, snapshot=True)
            if guide is None and not self.whole:
                problem, guide = guided(problem, self.scans.take(slice(first, first + WINDOW)), self.doppler)
                guide = None if guide is None else guide.later(first)
            new = self.go(*self._begun(problem, first, guide))
        except FilterError:
            return None
        if first and told is not None:
            new = joined(told, new, self.scans, first)
        return new, self.judged(new[0])

    def _begun(self, problem: Problem, first: int, guide: Guide | None) -> tuple[Problem, Scans]:
        """What the filter is told from a step on."""
        if guide is not None:
            return guide.begun(problem, self.scans, first, self.intervals)
        return problem, self.scans if first == 0 else self.scans.take(slice(first, None))

    def judged(self, history: History) -> Verdict:
        """What is to be thought of a run.

        One that leaves the track of the first scans is lost from there on, whatever it explains, unless it explains more than
        they do. One that keeps to their track until its end is not lost, however far off what it explains may be: then the
        measurements are less accurate than they claim.
        """
        guide, told = self.guide, (self.scans, self.problem.anchor, self.problem.height)
        verdict = judge(history, *told)
        if guide is None:
            return verdict
        apart = history.mean[: guide.steps, :POSE] - guide.state[1:, :POSE]
        apart[:, 2] = wrap(apart[:, 2])
        spread = history.covariance[: guide.steps, :POSE, :POSE] + guide.covariance[1:, :POSE, :POSE]
        squared = np.einsum("ki,ki->k", apart, np.linalg.solve(spread, apart[..., None])[..., 0])
        astray = (squared > ASTRAY) & (self._seen_apart(history, guide) > APART)
        ends = np.flatnonzero(np.diff(np.concatenate([[0], astray, [0]])))
        series = [(int(first), int(end)) for first, end in zip(ends[::2], ends[1::2], strict=True)]
        series = [(first, end) for first, end in series if end - first >= FEWEST]
        if not series and guide.steps >= history.steps and np.median(squared[verdict.since :]) < ASTRAY:
            return Verdict()
        if not series or (verdict.reason and verdict.since <= series[0][0]):
            return verdict
        seen = explained(history, *told)
        if seen.explained[: guide.steps].sum() > guide.share * seen.measured[: guide.steps].sum():
            return verdict
        first, end = series[0]
        return Verdict(f"up to step {end - 1} it is not where the first scans together say", first)

    def _seen_apart(self, history: History, guide: Guide) -> NDArray:
        """(K,) mean square, in units of the measurements' variances, of what would be measured here less what would be there."""
        variance = np.median(np.einsum("nii->ni", self.scans.covariance), axis=0)
        used = np.flatnonzero(variance[:ROWS] < UNSEEN[:ROWS])
        landmarks, height = (guide.position, guide.kind, self.problem.anchor), self.problem.height
        here = measure(history.mean[: guide.steps, None], *landmarks, height=height)
        off = residual(here, measure(guide.state[1:, None], *landmarks, height=height))[..., used]
        return np.mean(off**2 / variance[used], axis=(1, 2))


def joined(old: Told, new: Told, scans: Scans, first: int) -> Told:
    """The old run up to step ``first`` and the new one from there on, with the map of both.

    A landmark that the new run finds again keeps its old number; one that it does not find stays as it was last known.
    """
    history, before = new[0], old[0]
    shift = int(scans.offsets[first])
    kept, number = _of_both(before, first - 1, history, shift)
    track = np.array([number[int(t)] for t in history.track], dtype=np.int64)
    parts = [before.take(slice(0, first))]
    present = [set(track[history.rows(k)].tolist()) for k in range(history.steps)]
    rows, source, counts = [], [], []
    for k in range(history.steps):
        stay = [row for row in kept if int(before.track[row]) not in present[k]]
        own = np.arange(history.map_offsets[k], history.map_offsets[k + 1])
        rows += [*own, *stay]
        source += [True] * len(own) + [False] * len(stay)
        counts.append(len(own) + len(stay))
    at, new_rows = np.array(rows, dtype=np.int64), np.array(source, dtype=bool)

    def column(name: str) -> NDArray:
        theirs, ours = getattr(before, name), track if name == "track" else getattr(history, name)
        filled = np.empty((len(at), *theirs.shape[1:]), theirs.dtype)
        filled[new_rows], filled[~new_rows] = ours[at[new_rows]], theirs[at[~new_rows]]
        return filled

    names = ("position", "position_covariance", "existence", "type_probability", "kind", "track")
    columns: dict[str, Any] = {name: column(name) for name in names}
    parts.append(History(history.mean, history.covariance, edges_of(counts).astype(np.int64), **columns))
    return History.join(parts), _told(old[1], new[1], first, number, shift)


def _of_both(before: History, step: int, history: History, shift: int) -> tuple[list[int], dict[int, int]]:
    """Rows of the old map that stay, and the number of every landmark of the new one in the whole run."""
    rows = before.rows(step)
    kept = [row for row in range(rows.start, rows.stop) if before.existence[row] > DECLARED]
    last = {int(t): row for row, t in enumerate(history.track)}
    number = {t: t + shift for t in last}
    sure = [t for t, row in last.items() if history.existence[row] > DECLARED]
    if kept and sure:
        there = [last[t] for t in sure]
        apart = before.position[kept][:, None] - history.position[there][None]
        spread = before.position_covariance[kept][:, None] + history.position_covariance[there][None]
        squared = np.einsum("abi,abi->ab", apart, np.linalg.solve(spread, apart[..., None])[..., 0])
        squared[before.kind[kept][:, None] != history.kind[there][None]] = np.inf
        for i, j in zip(*linear_sum_assignment(np.minimum(squared, 2 * SAME)), strict=True):
            if squared[i, j] < SAME:
                number[sure[j]] = int(before.track[kept[i]])
    return kept, number


def _told(old: Diagnostics, new: Diagnostics, first: int, number: dict[int, int], shift: int) -> Diagnostics:
    """Diagnostics of the old run up to a step and of the new one from there on."""

    def renumbered(track: NDArray[np.int64]) -> NDArray[np.int64]:
        flat = [number.get(int(t), int(t) + shift) if t >= 0 else int(t) for t in track.ravel()]
        return np.array(flat, dtype=np.int64).reshape(track.shape)

    return Diagnostics(
        nis=np.concatenate([old.nis[:first], new.nis]),
        nis_rows=np.concatenate([old.nis_rows[:first], new.nis_rows]),
        weights=(*old.weights[:first], *new.weights),
        associations=(*old.associations[:first], *map(renumbered, new.associations)),
        existence=(*old.existence[:first], *new.existence),
        passed_over=np.concatenate([old.passed_over[:first], new.passed_over]),
    )
