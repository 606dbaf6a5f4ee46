"""The nouns that pass between rooms: what was driven, what was traced, what was detected.

Frozen records of flat NumPy arrays. Ragged sets (paths or detections per step) are flat columns plus ``offsets``:
step ``k`` owns rows ``offsets[k]:offsets[k + 1]``. World frame right-handed, z up; SI units, radians.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum

import numpy as np

from dopslam.errors import DopslamError

SPEED_OF_LIGHT = 299_792_458.0  # m/s


class Kind(IntEnum):
    """Landmark types of paper A: base station, virtual anchor, scatter point (paper B: PS)."""

    BS = 0
    VA = 1
    SP = 2


def _check_offsets(record: str, offsets: np.ndarray, rows: int) -> None:
    if offsets.ndim != 1 or offsets.size == 0 or offsets[0] != 0 or offsets[-1] != rows or np.any(np.diff(offsets) < 0):
        raise DopslamError(
            f"{record}: offsets must rise from 0 to the number of rows ({rows}), got {offsets.tolist()[:6]}…"
        )


def _check_columns(record, columns: tuple[str, ...], rows: int) -> None:
    for name in columns:
        column = getattr(record, name)
        if len(column) != rows:
            raise DopslamError(f"{type(record).__name__}.{name} has {len(column)} rows where {rows} are needed")
        if not np.all(np.isfinite(column)):
            raise DopslamError(f"{type(record).__name__}.{name} holds non-finite values; remove those rows first")


@dataclass(frozen=True)
class Track:
    """The receiver's true motion at the K measured steps.

    Attributes
    ----------
    time : (K,) s
    position : (K, 3) m, world frame
    heading : (K,) rad, azimuth of the receiver's array and direction of travel
    velocity : (K, 3) m/s, world frame
    bias : (K,) m, clock bias times c
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
        _check_offsets("FloorPlan", self.offsets, len(self.points))


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
class Paths:
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
    """

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

    def __post_init__(self):
        _check_columns(self, ("a", "tau", "theta_t", "phi_t", "theta_r", "phi_r", "doppler"), len(self.landmark))
        _check_offsets("Paths", self.offsets, len(self.landmark))
        _check_offsets("Paths.vertices", self.vertex_offsets, len(self.vertices))

    @property
    def steps(self) -> int:
        """Number of steps K."""
        return len(self.offsets) - 1

    def rows(self, step: int) -> slice:
        """Rows of one step."""
        return slice(int(self.offsets[step]), int(self.offsets[step + 1]))


@dataclass(frozen=True)
class DetectionSeries:
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
    """

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

    def __post_init__(self):
        _check_columns(self, ("delay", "aoa", "aod", "radial_velocity", "gain", "covariance", "snr"), len(self.delay))
        _check_offsets("DetectionSeries", self.offsets, len(self.delay))

    @property
    def steps(self) -> int:
        """Number of snapshots K."""
        return len(self.offsets) - 1

    def rows(self, step: int) -> slice:
        """Rows of one snapshot."""
        return slice(int(self.offsets[step]), int(self.offsets[step + 1]))


def same(left, right) -> bool:
    """Whether two records hold exactly the same arrays."""
    return type(left) is type(right) and all(
        np.array_equal(getattr(left, f.name), getattr(right, f.name)) for f in fields(left)
    )
