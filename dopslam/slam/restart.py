"""A filter that has lost its receiver is found out by its own history, and started anew from what the scans tell.

Works on any filter's whole run (:func:`watched`). Up to the step from which the receiver was lost its history stands;
from there on the filter runs again, from a start that the next scans alone give (:mod:`dopslam.slam.snapshot`). The map
from before stays where the new run does not find the same landmark again. What is lost from the beginning on has a wrong
start, and is run anew as a whole. A new run that is lost as well is discarded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from dopslam.errors import FilterError
from dopslam.models.scans import Scans
from dopslam.records import edges_of
from dopslam.slam.batch.start import started
from dopslam.slam.health import DECLARED, FEWEST, Verdict, judge
from dopslam.slam.history import Diagnostics, History

Told = tuple[History, Diagnostics]
Problem = Any  # of dopslam.slam.filter, which calls this module
Go = Callable[[Problem, Scans], Told]

MOST = 3  # restarts of one run
WINDOW = 20  # scans that a start is found from
SAME = 16.0  # squared Mahalanobis distance of two estimates of one landmark: 1.1e-3 of the right ones lie beyond


def watched(problem: Problem, scans: Scans, go: Go, *, whole: bool, doppler: bool) -> Told:
    """Run a filter, and again from where it lost its receiver.

    Parameters
    ----------
    problem : what the filter is told
    scans : of the whole run
    go : runs the filter on a problem and scans
    whole : whether its estimates use the scans of the whole run, so that no part of them stands alone
    doppler : whether the new start may use Doppler

    Returns
    -------
    History, Diagnostics
        ``history.restarted`` says from where and why; ``history.lost`` is left to whoever judges the result.

    Raises
    ------
    FilterError
        What the filter raised, if a new start does not mend it.
    """
    told, verdict, failure = _tried(problem, scans, go)
    said: list[str] = []
    for _ in range(MOST):
        if not verdict.reason or (told is None and problem.snapshot):
            break
        since = 0 if whole or told is None or verdict.since < FEWEST else verdict.since
        found = None
        for first in dict.fromkeys([since, 0]):
            found = _anew(problem, scans, go, told, first, whole, doppler)
            if found is not None and _better(found[1], verdict):
                break
            found = None
        if found is None:
            break
        said.append(f"from step {first}: {verdict.reason}")
        told, verdict = found
    if told is None:
        raise failure or FilterError(verdict.reason)
    return replace(told[0], restarted="; ".join(said)), told[1]


def _tried(problem: Problem, scans: Scans, go: Go) -> tuple[Told | None, Verdict, FilterError | None]:
    """What a run leaves and what is to be thought of it; a filter that ends with an error is lost from the beginning."""
    try:
        told = go(problem, scans)
    except FilterError as error:
        return None, Verdict(str(error)), error
    return told, judge(told[0], scans, problem.anchor, problem.height), None


def _better(new: Verdict, old: Verdict) -> bool:
    """Whether a new run is an improvement: not lost, or only much later, which another start may mend."""
    return not new.reason or new.since >= old.since + 2 * FEWEST


def _anew(
    problem: Problem, scans: Scans, go: Go, told: Told | None, first: int, whole: bool, doppler: bool
) -> tuple[Told, Verdict] | None:
    """The run with another one from step ``first`` on, and the verdict on it; None if there is no start or no end."""
    rest = scans if first == 0 else scans.take(slice(first, None))
    try:
        start = replace(problem, snapshot=True)
        if not whole:
            start = started(start, rest.take(slice(0, WINDOW)), doppler)
        new = go(start, rest)
    except FilterError:
        return None
    if first and told is not None:
        new = joined(told, new, scans, first)
    return new, judge(new[0], scans, problem.anchor, problem.height)


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
