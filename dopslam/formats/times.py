"""Which snapshot every row of a foreign table belongs to: its time stamps decide, also where they are irregular."""

from __future__ import annotations

import numpy as np

from dopslam.errors import DatasetError
from dopslam.records import Track

OFF_TIME = 0.25  # of a period: a detection farther from every step belongs to none
SAME = 1e-3  # of the usual difference: time stamps closer together are of one snapshot
MOST = 1_000_000  # snapshots of a table


def period_of(time: np.ndarray) -> float | None:
    """The period that time stamps show: their smallest usual difference, or the median one where they are irregular; None
    for a single one."""
    gaps = np.diff(_stamps(time)[0])
    if not len(gaps):
        return None
    whole = _whole(gaps)
    return float(np.median(gaps)) if whole is None else float(gaps.sum() / whole.sum())


def snapshots(path, get: dict[str, np.ndarray], truth: Track | None) -> tuple[np.ndarray, np.ndarray | None]:
    """Snapshot (N,) of every row, and the time [s] of every snapshot where it is known.

    With a track its steps are the snapshots; a row outside of them gets −1 or the number of steps. Without, every time
    stamp is one, and where they are multiples of a period those that found nothing are snapshots as well.

    Raises
    ------
    DatasetError
        For a step that is no whole number, a time between two steps of the track, or stamps that span too much.
    """
    if "step" in get:
        step = get["step"]
        if np.any(step != np.round(step)) or np.any(step < 0) or np.any(step >= MOST):
            raise DatasetError(f"{path}: the step column holds numbers that are not whole, below 0, or {MOST} and more")
        return step.astype(int), None if truth is None else truth.time
    if truth is not None:
        return _steps_of(path, get["time"], truth.time), truth.time
    stamps, row = _stamps(get["time"])
    whole = _whole(np.diff(stamps))
    if whole is None:
        return row, stamps
    number = np.concatenate([[0], np.cumsum(whole)]).astype(np.int64)
    if number[-1] >= MOST:
        raise DatasetError(
            f"{path}: times span {np.ptp(stamps):g} s, {number[-1]} periods of {np.ptp(stamps) / number[-1]:g} s, and "
            f"{MOST} are the most; check the unit, or cut the table"
        )
    return number[row], np.interp(np.arange(number[-1] + 1), number, stamps)


def _stamps(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct time stamps in order, and which of them each row has."""
    distinct, row = np.unique(time, return_inverse=True)
    gaps = np.diff(distinct)
    new = gaps > SAME * np.median(gaps) if len(gaps) else np.zeros(0, bool)
    number = np.concatenate([[0], np.cumsum(new)]).astype(np.int64)
    return distinct[np.concatenate([[True], new])], number[row]


def _whole(gaps: np.ndarray) -> np.ndarray | None:
    """Numbers of periods between time stamps, None where they are no multiples of one."""
    if not len(gaps):
        return np.zeros(0)
    ratio = gaps / float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    return None if np.any(np.abs(ratio - np.round(ratio)) > OFF_TIME) else np.round(ratio)


def _steps_of(path, time: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Number of the step of the track that each time belongs to; −1 or the number of steps for those outside."""
    gaps = np.diff(steps) if len(steps) > 1 else np.array([np.inf])
    room = OFF_TIME * np.minimum(np.append(gaps, gaps[-1]), np.insert(gaps, 0, gaps[0]))  # to either side of a step
    after = np.clip(np.searchsorted(steps, time), 0, len(steps) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(time - steps[before]) <= np.abs(time - steps[after]), before, after)
    off = np.abs(time - steps[nearest]) > room[nearest]
    between = off & (time > steps[0]) & (time < steps[-1])
    if between.any():
        row = int(np.argmax(between))
        raise DatasetError(
            f"{path}: data row {row + 1} at {time[row]:g} s lies between two steps of the track, which are at "
            f"{steps[before[row]]:g} and {steps[after[row]]:g} s; give a track at the times of the detections, or a step column"
        )
    return np.where(off, np.where(time < steps[0], -1, len(steps)), nearest)
