"""Detections of a run as rows of a least-squares problem: whitened residuals and Jacobians of `models.measurement`.

A row that was not measured leaves; so do the two rows of departure of a second
reflection. Steps are counted from 0 and poses from the prior's, so that
step k is seen from pose k + 1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dopslam.models import paths, unmeasured
from dopslam.models.measurement import SP, SR, VA, directions, measure
from dopslam.models.pose import positions
from dopslam.models.scans import Scans
from dopslam.slam.batch.kernels import linearize_rows

Array = NDArray[np.float64]
Index = NDArray[np.int64]

KINDS = (VA, SP, SR)
DEPARTURE = [3, 4]
THOUGHT_FALSE = 0.5  # false detections per scan that are thought possible, whatever is promised


@dataclass(frozen=True, slots=True)
class Map:
    """Landmarks; the first ones are the base stations themselves.

    Attributes
    ----------
    kind : (J,) int array; a number of Kind
    position : (J, 3) array [m]
    station : (J,) int array; base station whose paths go over the landmark
    covariance : (J, 3, 3) array [m²]; zero for base stations
    """

    kind: Index
    position: Array
    station: Index
    covariance: Array

    def __len__(self) -> int:
        return len(self.kind)

    def take(self, chosen) -> Map:
        """Some landmarks."""
        return Map(self.kind[chosen], self.position[chosen], self.station[chosen], self.covariance[chosen])

    def joined(self, other: Map) -> Map:
        """These landmarks and others after them."""
        return Map(
            np.concatenate([self.kind, other.kind]),
            np.concatenate([self.position, other.position]),
            np.concatenate([self.station, other.station]),
            np.concatenate([self.covariance, other.covariance]),
        )


@dataclass(frozen=True, slots=True)
class Rows:
    """All detections of a run.

    Attributes
    ----------
    z : (N, 6), covariance : (N, 6, 6); as `Scans`, unmeasured rows with unit variance and nothing beside it
    used : (N, 6) bool; rows that were measured
    step : (N,) int, offsets : (K + 1,) int
    station : (N,) int; base station of each detection
    stations : (A, 3) array [m]
    height, speed : the receiver's plane [m], and its speed [m/s] where it is not in the state
    spans : (6,) array; width of what each row can take [m, rad ×4, m/s]
    false : (N,) log intensity of false detections at each of them
    flat : whether no elevation was measured at all
    """

    z: Array
    covariance: Array
    used: NDArray[np.bool_]
    step: Index
    offsets: Index
    station: Index
    stations: Array
    height: float
    speed: float
    spans: Array
    false: Array
    flat: bool

    @property
    def steps(self) -> int:
        """Number of scans K."""
        return len(self.offsets) - 1

    def used_by(self, rows: Index, kind: Index) -> NDArray[np.bool_]:
        """(M, 6) rows that say something about a landmark of a kind."""
        used = self.used[rows].copy()
        used[:, DEPARTURE] &= (kind != SR)[:, None]
        return used


def uniform(spans: Array, used: NDArray[np.bool_]) -> Array:
    """log of the density of rows (M, 6) that nothing explains: uniform over what each can take."""
    return -np.where(used, np.log(spans), 0.0).sum(axis=1)


def rows_of(scans: Scans, stations: Array, height: float, speed: float, *, doppler: bool = True) -> Rows:
    """Scans as rows; without `doppler` the radial velocities stay out.

    A quantity whose deviation is as wide as what is searched was not measured (:mod:`dopslam.models.unmeasured`). Without
    any elevation walls are taken to stand upright and objects to be as high as the receiver.
    """
    variance = np.einsum("nii->ni", scans.covariance)
    spans = unmeasured.SPANS.copy()
    spans[5] = scans.doppler_span
    spans[0] = np.inf  # a delay is measured, always
    used = ~unmeasured.missing(variance, spans)
    spans[0] = unmeasured.delay_width(scans.search_volume, scans.doppler_span, used.any(axis=0))
    used[:, 5] &= doppler
    both = used[:, :, None] & used[:, None, :]
    flat = unmeasured.planar(variance)
    stations = np.array(np.atleast_2d(stations), float)
    return Rows(
        z=np.where(used, scans.z, 0.0),
        covariance=np.where(both, scans.covariance, np.eye(6)),
        used=used,
        step=scans.step_of_row,
        offsets=scans.offsets,
        station=np.asarray(scans.anchor),
        stations=stations,
        height=height,
        speed=speed,
        spans=spans,
        false=np.log(max(scans.clutter_count, THOUGHT_FALSE)) + uniform(spans, used),
        flat=flat,
    )


def part(data: Rows, low: int, high: int) -> Rows:
    """Scans low … high − 1 alone."""
    rows = slice(int(data.offsets[low]), int(data.offsets[high]))
    return replace(
        data,
        z=data.z[rows],
        covariance=data.covariance[rows],
        used=data.used[rows],
        step=data.step[rows] - low,
        offsets=data.offsets[low : high + 1] - data.offsets[low],
        station=data.station[rows],
        false=data.false[rows],
    )


def masked(matrix: Array, used: NDArray[np.bool_]) -> Array:
    """Matrices (M, 6, 6) with unit rows in place of those not used."""
    both = used[:, :, None] & used[:, None, :]
    return np.where(both, matrix, np.eye(6))


def predict(data: Rows, state: Array, kind: Index, position: Array, station: Index) -> Array:
    """h(s, x) (…, 6) of states (…, n) and landmarks."""
    return measure(state, position, kind, data.stations[station], speed=data.speed, height=data.height)


class Linear(NamedTuple):
    """Residuals (M, 6) and Jacobians (M, 6, n), (M, 6, 3), zero in rows that are not used."""

    error: Array
    by_state: Array
    by_point: Array


def linearize(data: Rows, rows: Index, state: Array, kind: Index, position: Array) -> Linear:
    """Residuals and Jacobians of detections `rows` (M,) seen from states (M, n) over landmarks (M, 3) of kinds (M,)."""
    station = data.stations[data.station[rows]]
    return Linear(
        *linearize_rows(data.z[rows], data.used[rows], state, kind, position, station, data.height, data.speed)
    )


def whitened(covariance: Array, *columns: Array) -> tuple[Array, ...]:
    """L⁻¹ times each of the columns, LLᵀ = covariance (M, 6, 6), and log |covariance| last."""
    factor = np.linalg.cholesky(covariance)
    inverse = np.linalg.inv(factor)
    logs = 2 * np.log(np.einsum("nii->ni", factor)).sum(axis=1)
    return *(inverse @ c if c.ndim == 3 else np.einsum("nij,nj->ni", inverse, c) for c in columns), logs


def place(data: Rows, rows: Index, state: Array, kind: Index) -> tuple[Array, NDArray[np.bool_]]:
    """Landmarks (M, 3) that single detections stand for, and whether they can exist.

    In the plane where no elevation was measured.
    """
    z, bs = data.z[rows], data.stations[data.station[rows]]
    ue, used = positions(state, data.height), data.used[rows]
    flat = ~used[:, 2]
    level = bs.copy()
    level[flat, 2] = ue[flat, 2]
    arrival = directions(z[:, 1] + state[:, 2], np.where(flat, 0.0, z[:, 2]))
    departure = np.where(used[:, 3:4], directions(z[:, 3], np.where(flat, 0.0, z[:, 4])), 0.0)
    length, direct = z[:, 0] - state[:, 3], np.linalg.norm(level - ue, axis=1)
    drop = bs[:, 2] - level[:, 2]  # of which azimuths know nothing
    length = np.where(length > 0, np.sqrt(np.maximum(length**2 - drop**2, 0.0)), length)
    found = paths.place(ue, level, length, arrival, departure, kind)
    found[flat, 2] = np.where(kind[flat] == SP, data.height, bs[flat, 2])
    return found, (length > direct * (1 - 1e-6)) & (length > 0)
