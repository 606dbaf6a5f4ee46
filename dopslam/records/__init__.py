"""The nouns that pass between rooms: what was driven, what was traced, what was detected.

Frozen records of flat NumPy arrays. Ragged sets (paths or detections per step) are flat columns plus ``offsets``:
step ``k`` owns rows ``offsets[k]:offsets[k + 1]``. World frame right-handed, z up; SI units, radians.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from enum import IntEnum
from typing import Any, ClassVar, Self

import numpy as np

from dopslam.errors import DopslamError

SPEED_OF_LIGHT = 299_792_458.0  # m/s


class Kind(IntEnum):
    """Landmark types: base station, virtual anchor and scatter point of paper A (paper B: PS), and second reflection.

    A second reflection is the base station mirrored at two walls: length, arrival and Doppler of a virtual anchor, its
    departure unexplained.
    """

    BS = 0
    VA = 1
    SP = 2
    SR = 3


ABSENT = np.zeros(0, np.int64)  # of a column that is zero in every row unless it is given
ABSENT.flags.writeable = False


class Ragged:
    """Base of the records whose rows belong to steps: step ``k`` owns rows ``edges[k]:edges[k + 1]`` of every column.

    A record names its offsets (``OFFSETS``), the arrays with one entry per step (``PER_STEP``), and the arrays that its
    rows own raggedly themselves (``NESTED``: offsets and values). All other arrays are columns, one entry per row.
    """

    __slots__ = ()
    OFFSETS: ClassVar[str] = "offsets"
    PER_STEP: ClassVar[tuple[str, ...]] = ()
    NESTED: ClassVar[tuple[tuple[str, str], ...]] = ()

    @property
    def edges(self) -> np.ndarray:
        """(K + 1,) offsets of the steps."""
        return getattr(self, self.OFFSETS)

    @property
    def steps(self) -> int:
        """Number of steps K."""
        return len(self.edges) - 1

    @property
    def step_of_row(self) -> np.ndarray:
        """(N,) step that owns each row."""
        return np.repeat(np.arange(self.steps), np.diff(self.edges))

    def rows(self, step: int) -> slice:
        """Rows of one step."""
        return slice(int(self.edges[step]), int(self.edges[step + 1]))

    def _columns(self) -> list[str]:
        other = {self.OFFSETS, *self.PER_STEP, *(name for pair in self.NESTED for name in pair)}
        arrays: Any = fields(self)  # type: ignore[arg-type]
        return [f.name for f in arrays if f.name not in other and isinstance(getattr(self, f.name), np.ndarray)]

    def take(self, steps) -> Self:
        """The record of some steps, in the order given: an index array, a mask or a slice."""
        steps = np.arange(self.steps)[steps]
        counts = np.diff(self.edges)[steps]
        rows = _spread(self.edges[steps], counts)
        taken: dict[str, Any] = {self.OFFSETS: edges_of(counts)} | {n: getattr(self, n)[rows] for n in self._columns()}
        taken |= {n: getattr(self, n)[steps] for n in self.PER_STEP if getattr(self, n) is not None}
        for edges, values in self.NESTED:
            inner = getattr(self, edges)
            sizes = np.diff(inner)[rows]
            taken |= {edges: edges_of(sizes), values: getattr(self, values)[_spread(inner[rows], sizes)]}
        return replace(self, **taken)  # type: ignore[type-var]

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        """Records of successive steps as one; what is no array is taken from the first."""
        first = parts[0]
        joined: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in [*first._columns(), *first.PER_STEP, *(values for _, values in first.NESTED)]
            if getattr(first, name) is not None
        }
        for name in [first.OFFSETS, *(edges for edges, _ in first.NESTED)]:
            joined[name] = edges_of(np.concatenate([np.diff(getattr(part, name)) for part in parts]))
        return replace(first, **joined)  # type: ignore[type-var]


def edges_of(counts) -> np.ndarray:
    """(K + 1,) offsets of the steps from their numbers of rows (K,)."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def _spread(first: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Indices first[i] … first[i] + counts[i] − 1 of every i, one behind the other."""
    return np.arange(int(counts.sum())) + np.repeat(first - np.concatenate([[0], np.cumsum(counts)[:-1]]), counts)


def fill_absent(record, names: tuple[str, ...], rows: int) -> None:
    """Zeros for the columns that were left out."""
    for name in names:
        if getattr(record, name) is ABSENT:
            object.__setattr__(record, name, np.zeros(rows, np.int64))


def check_offsets(record: str, offsets: np.ndarray, rows: int) -> None:
    """Refuse offsets that do not rise from 0 to the number of rows."""
    if offsets.ndim != 1 or offsets.size == 0 or offsets[0] != 0 or offsets[-1] != rows or np.any(np.diff(offsets) < 0):
        raise DopslamError(
            f"{record}: offsets must rise from 0 to the number of rows ({rows}), got {offsets.tolist()[:6]}…"
        )


def _check_columns(record, columns: tuple[str, ...], rows: int) -> None:
    for name in columns:
        column, where = np.asarray(getattr(record, name)), f"{type(record).__name__}.{name}"
        shape = SHAPES.get(name, ())
        if column.ndim == 0 or len(column) != rows:
            raise DopslamError(f"{where} has {column.shape[:1] or 'no'} rows where {rows} are needed")
        if column.shape[1:] != shape:
            raise DopslamError(f"{where} has shape {column.shape}; expected {(rows, *shape)}")
        if column.dtype.kind not in KINDS.get(name, "fiu"):
            raise DopslamError(
                f"{where} holds {column.dtype} numbers; expected {KINDS.get(name, 'f')[0]!r}, see numpy kinds"
            )
        if not np.all(np.isfinite(column)) and not (name in UNKNOWN and np.all(np.isnan(column))):
            raise DopslamError(f"{where} holds non-finite values; remove those rows first")


UNKNOWN = ("bias",)  # NaN throughout where nobody knows it

SHAPES = {  # of a row, where it is no single number
    **dict.fromkeys(("aoa", "aod"), (2,)), "covariance": (6, 6), **dict.fromkeys(("position", "velocity", "vertices"), (3,)),
    "triangles": (3, 3),
}  # fmt: skip
KINDS = {  # numpy's letters of number types, where they are not any real ones
    **dict.fromkeys(("a", "gain"), "cfiu"), **dict.fromkeys(("anchor", "flags", "kind", "order", "landmark"), "iu"),
}  # fmt: skip


@dataclass(frozen=True)
class Track:
    """The receiver's true motion at the K measured steps.

    Attributes
    ----------
    time : (K,) s
    position : (K, 3) m, world frame
    heading : (K,) rad, azimuth of the receiver's array and direction of travel
    velocity : (K, 3) m/s, world frame
    bias : (K,) m, clock bias times c; NaN throughout where nobody knows it, as of a measured drive
    start : (4,) [x m, y m, heading rad, bias m], mean of what the receiver knows one period before the first step
    """

    time: np.ndarray
    position: np.ndarray
    heading: np.ndarray
    velocity: np.ndarray
    bias: np.ndarray
    start: np.ndarray

    def __post_init__(self):
        _check_columns(self, ("time", "position", "heading", "velocity", "bias"), len(self.time))

    @property
    def steps(self) -> int:
        """Number of measured steps K."""
        return len(self.time)

    @property
    def state(self) -> np.ndarray:
        """(K, 4) state of paper A, eq. (1): [x m, y m, heading rad, bias m]."""
        return np.column_stack([self.position[:, :2], self.heading, self.bias])


@dataclass(frozen=True)
class BaseStations:
    """The base stations; ``anchor`` columns of paths and detections count its rows.

    Attributes
    ----------
    position : (A, 3) m, world frame
    yaw : (A,) rad, azimuth of the x axis of each station's own frame, in which its departures are given
    """

    position: np.ndarray
    yaw: np.ndarray

    def __post_init__(self):
        _check_columns(self, ("position", "yaw"), len(self.position))

    def __len__(self) -> int:
        return len(self.position)


@dataclass(frozen=True)
class Landmarks:
    """Ground-truth landmarks of a scene.

    Attributes
    ----------
    name : (L,) str, e.g. ``"BS"``, ``"VA wall_east"``, ``"VA wall_east > wall_north"``, ``"SP east"``
    kind : (L,) int8, :class:`Kind`
    position : (L, 3) m; a VA is the BS mirrored successively at the walls of its name
    order : (L,) int, bounces: 0 for the BS, the number of reflections for a VA, 1 for an SP
    """

    name: np.ndarray
    kind: np.ndarray
    position: np.ndarray
    order: np.ndarray

    def __post_init__(self):
        _check_columns(self, ("kind", "position", "order"), len(self.name))

    def __len__(self) -> int:
        return len(self.name)


@dataclass(frozen=True)
class FloorPlan:
    """Outlines of a scene's objects seen from above, for drawing.

    Attributes
    ----------
    name : (W,) str
    offsets : (W + 1,), points : (·, 2) m, polyline of each object
    """

    name: np.ndarray
    offsets: np.ndarray
    points: np.ndarray

    def __post_init__(self):
        check_offsets("FloorPlan", self.offsets, len(self.points))


@dataclass(frozen=True)
class Mesh:
    """Triangles of a scene, for drawing it.

    Attributes
    ----------
    triangles : (T, 3, 3) float32 m, corners of each triangle, world frame
    """

    triangles: np.ndarray

    def __post_init__(self):
        _check_columns(self, ("triangles",), len(self.triangles))


@dataclass(frozen=True)
class Paths(Ragged):
    """Ray-traced propagation paths of K steps, ragged.

    Attributes
    ----------
    offsets : (K + 1,) rows of each step
    landmark : (N,) index into :class:`Landmarks`
    a : (N,) complex amplitude in Sionna's convention (without e^{−j2πf_cτ}), isotropic vertical elements
    tau : (N,) s, geometric (no clock bias)
    theta_t, phi_t, theta_r, phi_r : (N,) rad, zenith and azimuth in the world frame; ``r`` points from the receiver to
        the last interaction
    doppler : (N,) Hz, positive when approaching
    vertex_offsets : (N + 1,), vertices : (·, 3) m, interaction points of each path
    anchor : (N,) int, base station that each path leaves; 0 where it is not said
    """

    NESTED = (("vertex_offsets", "vertices"),)

    offsets: np.ndarray
    landmark: np.ndarray
    a: np.ndarray
    tau: np.ndarray
    theta_t: np.ndarray
    phi_t: np.ndarray
    theta_r: np.ndarray
    phi_r: np.ndarray
    doppler: np.ndarray
    vertex_offsets: np.ndarray
    vertices: np.ndarray
    anchor: np.ndarray = field(default_factory=lambda: ABSENT)

    def __post_init__(self):
        fill_absent(self, ("anchor",), len(self.landmark))
        _check_columns(
            self, ("a", "tau", "theta_t", "phi_t", "theta_r", "phi_r", "doppler", "anchor"), len(self.landmark)
        )
        check_offsets("Paths", self.offsets, len(self.landmark))
        check_offsets("Paths.vertices", self.vertex_offsets, len(self.vertices))


@dataclass(frozen=True)
class DetectionSeries(Ragged):
    """Channel estimates of K snapshots, ragged: what an estimator hands to the filters.

    Attributes
    ----------
    offsets : (K + 1,) rows of each step
    delay : (N,) s, clock bias included
    aoa : (N, 2) rad [azimuth, elevation] in the receiver's frame (azimuth counted from the heading)
    aod : (N, 2) rad [azimuth, elevation] in the base station's frame
    radial_velocity : (N,) m/s, positive when approaching
    gain : (N,) complex path amplitude
    covariance : (N, 6, 6) of (delay, aoa_az, aoa_el, aod_az, aod_el, radial_velocity), SI units
    snr : (N,) post-integration SNR ρ, linear
    noise_variance : (K,) estimated noise variance per sample
    threshold : detection threshold on ρ (linear)
    false_alarm_rate : expected false paths per snapshot
    search_volume : volume of the searched region in (c·delay m) × rad⁴ × (m/s)
    anchor : (N,) int, base station of each detection; 0 where it is not said
    flags : (N,) int, bits of ``estimation.Flag``: what to mind about a detection; 0 where nothing is said
    time : (K,) s of every snapshot, rising; None: one period of the scenario apart
    delay_range : s, delays are known modulo this (the inverse of the pilots' spacing); inf: they are as they are
    """

    PER_STEP = ("noise_variance", "time")

    offsets: np.ndarray
    delay: np.ndarray
    aoa: np.ndarray
    aod: np.ndarray
    radial_velocity: np.ndarray
    gain: np.ndarray
    covariance: np.ndarray
    snr: np.ndarray
    noise_variance: np.ndarray
    threshold: float
    false_alarm_rate: float
    search_volume: float
    anchor: np.ndarray = field(default_factory=lambda: ABSENT)
    flags: np.ndarray = field(default_factory=lambda: ABSENT)
    time: np.ndarray | None = None
    delay_range: float = np.inf

    def __post_init__(self):
        if not self.delay_range > 0:
            raise DopslamError(f"DetectionSeries.delay_range is {self.delay_range} s; give a positive time, or inf")
        rows = len(self.delay)
        fill_absent(self, ("anchor", "flags"), rows)
        columns = ("delay", "aoa", "aod", "radial_velocity", "gain", "covariance", "snr", "anchor", "flags")
        _check_columns(self, columns, rows)
        check_offsets("DetectionSeries", self.offsets, rows)
        _check_columns(self, ("noise_variance",) if self.time is None else ("noise_variance", "time"), self.steps)
        if self.time is not None and np.any(np.diff(self.time) <= 0):
            at = int(np.argmax(np.diff(self.time) <= 0))
            raise DopslamError(
                f"DetectionSeries.time must rise, but snapshot {at + 1} is at {self.time[at + 1]:g} s "
                f"after {self.time[at]:g} s"
            )


def same(left, right) -> bool:
    """Whether two records hold exactly the same arrays."""
    return type(left) is type(right) and all(
        np.array_equal(getattr(left, f.name), getattr(right, f.name)) for f in fields(left)
    )
