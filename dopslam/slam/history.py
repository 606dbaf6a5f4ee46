"""What a filter run leaves behind: state and map after every step, and its diagnostics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from dopslam.compute.compiled import compiled, copy_vector
from dopslam.errors import FilterError
from dopslam.records import Kind, Ragged, check_offsets, edges_of
from dopslam.slam.pmb.density import INERT, PMB

Array = NDArray[np.float64]

TYPES = len(Kind)
COLUMNS = 15 + TYPES  # of a map row: position 3, covariance 9, existence, kind, track, P(type | exists) of every type


@dataclass(frozen=True, slots=True)
class Diagnostics:
    """What happened inside a run, one entry per step.

    Attributes
    ----------
    nis, nis_rows : (K,) arrays; νᵀS⁻¹ν of the likeliest association and its degrees of freedom
    weights : K arrays (g,); normalized association weights, the likeliest first
    associations : K arrays (g, M); track of each measurement, -1 the BS, -2 new or clutter
    existence : K arrays (M,); predicted existence of the track each measurement went to
    passed_over : (K,) number of measurements that were not read at all, as pieces of one path
        (:mod:`dopslam.slam.pmb.splinters`); empty of a filter that reads them all
    """

    nis: Array
    nis_rows: NDArray[np.int64]
    weights: tuple[Array, ...]
    associations: tuple[NDArray[np.int64], ...]
    existence: tuple[Array, ...]
    passed_over: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @property
    def nis_per_row(self) -> float:
        """Normalized innovation squared over its degrees of freedom, over all steps that tell one; 1 is expected."""
        told = np.isfinite(self.nis) & (self.nis_rows > 0)
        return float(self.nis[told].sum() / self.nis_rows[told].sum()) if told.any() else float("nan")

    @classmethod
    def none(cls, steps: int) -> Diagnostics:
        """Of a filter that tells nothing."""
        return cls(np.full(steps, np.nan), np.zeros(steps, dtype=np.int64), (), (), ())


@dataclass(frozen=True, slots=True)
class History(Ragged):
    """State and map after every step; the map is ragged, step k owns rows map_offsets[k]:map_offsets[k + 1].

    Attributes
    ----------
    mean : (K, n) array [m, m, rad, m(, m/s, rad/s)]
    covariance : (K, n, n) array
    map_offsets : (K + 1,) int array
    position : (N, 3) array [m]; of the track's likelier type
    position_covariance : (N, 3, 3) array
    existence : (N,) array; r of the track
    type_probability : (N, T) array; P(type | exists), column t of the type that :class:`~dopslam.records.Kind` numbers t
    kind : (N,) int array; the likelier type, a number of Kind
    track : (N,) int array; number of the measurement that bore the track
    lost : why the receiver counts as lost, told without the truth (:mod:`dopslam.slam.health`); empty if it does not
    restarted : from which steps the filter was started anew, and why (:mod:`dopslam.slam.restart`); empty if it was not
    nis_per_row : normalized innovation squared of the likeliest association over its degrees of freedom, over all steps; 1 is
        expected, NaN where the filter has none
    passed_over : detections of the whole run that the filter did not read, as pieces of one path
    """

    OFFSETS: ClassVar[str] = "map_offsets"
    PER_STEP: ClassVar[tuple[str, ...]] = ("mean", "covariance")

    mean: Array
    covariance: Array
    map_offsets: NDArray[np.int64]
    position: Array
    position_covariance: Array
    existence: Array
    type_probability: Array
    kind: NDArray[np.int64]
    track: NDArray[np.int64]
    lost: str = ""
    restarted: str = ""
    nis_per_row: float = float("nan")
    passed_over: int = 0

    def __post_init__(self) -> None:
        check_offsets("History", self.map_offsets, len(self.position))

    def reported(self, step: int, kind: int, threshold: float = 0.5) -> Array:
        """Positions (·, 3) of the landmarks of one kind with existence above the threshold."""
        rows = self.rows(step)
        wanted = (self.kind[rows] == kind) & (self.existence[rows] > threshold)
        return self.position[rows][wanted]


@dataclass(frozen=True, slots=True)
class Estimate:
    """State and map after one step, columns as in :class:`History`.

    Attributes
    ----------
    mean, covariance : (n,), (n, n)
    position, position_covariance : (T, 3), (T, 3, 3) of the landmarks
    existence, type_probability, track : (T,), (T, TYPES), (T,)
    """

    mean: Array
    covariance: Array
    position: Array = field(default_factory=lambda: np.zeros((0, 3)))
    position_covariance: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))
    existence: Array = field(default_factory=lambda: np.zeros(0))
    type_probability: Array = field(default_factory=lambda: np.zeros((0, TYPES)))
    track: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))


def settled(estimate: Estimate, who: str, before: Array | None = None) -> Estimate:
    """A filter's answer as arrays of their own: a filter may go on writing into what it handed out.

    Parameters
    ----------
    estimate : as a filter gave it, lists included
    who : for the message
    before : (n,) mean of an earlier step, None at the first

    Raises
    ------
    FilterError
        If it is none, or its parts do not fit each other or the step before.
    """
    if not isinstance(estimate, Estimate):
        raise FilterError(f"{who}: Info.estimate must be a dopslam.Estimate, got {type(estimate).__name__}")
    n = np.size(estimate.mean) if before is None else np.size(before)
    count = np.shape(estimate.existence)[0] if np.ndim(estimate.existence) else 0
    shapes = {
        "mean": (n,), "covariance": (n, n), "position": (count, 3), "position_covariance": (count, 3, 3),
        "existence": (count,), "type_probability": (count, TYPES), "track": (count,),
    }  # fmt: skip
    found = {}
    for name, shape in shapes.items():
        try:
            found[name] = np.array(getattr(estimate, name), np.int64 if name == "track" else float)
        except (TypeError, ValueError) as error:
            raise FilterError(f"{who}: Estimate.{name} is not made of numbers ({error})") from error
        if found[name].shape != shape or n < 4:
            needed = "(n,), x, y, heading, bias and what follows" if name == "mean" and before is None else shape
            raise FilterError(f"{who}: Estimate.{name} has the shape {found[name].shape}, it must be {needed}")
        if not np.isfinite(found[name]).all():
            raise FilterError(f"{who}: Estimate.{name} is not finite")
    for name in ("covariance", "position_covariance"):
        if np.einsum("...ii->...i", found[name]).min(initial=0.0) < 0:
            raise FilterError(f"{who}: Estimate.{name} has a negative variance")
    for name in ("existence", "type_probability"):
        if found[name].min(initial=0.0) < 0 or found[name].max(initial=0.0) > 1 + 1e-6:
            raise FilterError(f"{who}: Estimate.{name} is no probability, from 0 to 1")
    return Estimate(**found)


def answer_of_run(answer: tuple[History, Diagnostics], steps: int, who: str) -> tuple[History, Diagnostics]:
    """What a filter's ``run`` returned, if it is a history of so many steps and its diagnostics.

    Raises
    ------
    FilterError
        If it is not.
    """
    fits = isinstance(answer, tuple) and len(answer) == 2
    if not (fits and isinstance(answer[0], History) and isinstance(answer[1], Diagnostics)):
        raise FilterError(
            f"{who} must return (dopslam.History, dopslam.Diagnostics); Diagnostics.none(steps) if it has none"
        )
    if answer[0].steps != steps:
        raise FilterError(f"{who} returned a history of {answer[0].steps} steps for {steps} scans")
    for name in ("mean", "covariance", "position", "existence"):
        if not np.isfinite(getattr(answer[0], name)).all():
            raise FilterError(f"{who} returned a history whose {name} is not finite")
    return answer


def history_of_estimates(estimates: Sequence[Estimate]) -> History:
    """The record of all steps; a landmark's kind is its likelier type."""

    def column(name: str) -> Array:
        return np.concatenate([getattr(e, name) for e in estimates])

    probability = column("type_probability")
    return History(
        mean=np.array([e.mean for e in estimates]),
        covariance=np.array([e.covariance for e in estimates]),
        map_offsets=edges_of([len(e.existence) for e in estimates]).astype(np.int64),
        position=column("position"),
        position_covariance=column("position_covariance"),
        existence=column("existence"),
        type_probability=probability,
        kind=probability.argmax(axis=1).astype(np.int64),
        track=column("track").astype(np.int64),
    )


@compiled
def write_map(posterior, table, row):
    """Write the map of a density into `table` from `row` on, one line per track; returns the row after the last."""
    blocks = posterior.kind.shape[0]
    n = posterior.mean.shape[0] - 3 * (blocks - 1)
    b = 1
    while b < blocks:
        if posterior.kind[b] == INERT:
            b += 1
            continue
        best, last = b, b
        existence = 0.0
        for t in range(TYPES):
            table[row, 15 + t] = 0.0
        while last < blocks and posterior.track[last] == posterior.track[b]:
            existence += posterior.weight[last]
            table[row, 15 + posterior.kind[last]] += posterior.weight[last]
            if posterior.weight[last] > posterior.weight[best]:
                best = last
            last += 1
        start = n + 3 * (best - 1)
        copy_vector(posterior.mean[start : start + 3], table[row])
        for i in range(3):
            for j in range(3):
                table[row, 3 + 3 * i + j] = posterior.covariance[start + i, start + j]
        table[row, 12] = existence
        table[row, 13] = posterior.kind[best]
        table[row, 14] = posterior.track[best]
        for t in range(TYPES):
            table[row, 15 + t] /= max(existence, 1e-300)
        row += 1
        b = last
    return row


def map_table(posterior: PMB) -> Array:
    """Map rows (T, COLUMNS) of one density."""
    table = np.empty((posterior.kind.size - 1, COLUMNS))
    return table[: write_map(posterior, table, 0)]


def estimate_of(posterior: PMB) -> Estimate:
    """State and map of one density."""
    table, n = map_table(posterior), posterior.mean.size - 3 * (posterior.kind.size - 1)
    return Estimate(
        posterior.mean[:n].copy(),
        posterior.covariance[:n, :n].copy(),
        position=table[:, :3],
        position_covariance=table[:, 3:12].reshape(-1, 3, 3),
        existence=table[:, 12],
        type_probability=table[:, 15:],
        track=table[:, 14].astype(np.int64),
    )


def history_of(mean: Array, covariance: Array, map_offsets: NDArray[np.int64], table: Array) -> History:
    """The record made of states (K, n), covariances (K, n, n) and the map rows of all steps."""
    return History(
        mean,
        covariance,
        map_offsets,
        position=table[:, :3].copy(),
        position_covariance=table[:, 3:12].reshape(-1, 3, 3).copy(),
        existence=table[:, 12].copy(),
        type_probability=table[:, 15:].copy(),
        kind=table[:, 13].astype(np.int64),
        track=table[:, 14].astype(np.int64),
    )
