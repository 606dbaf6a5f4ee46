"""Measurements as the filters read them: delays as lengths, one record for a whole run.

The conversion from an estimator's delays in seconds to c·τ in metres happens here and nowhere else: with
variances of 1e-18 s² beside 1e4 m² every covariance form fails.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from dopslam.errors import FilterError
from dopslam.records import ABSENT, SPEED_OF_LIGHT, DetectionSeries, Ragged, fill_absent

Array = NDArray[np.float64]

CLUTTER = -1
LARGEST = np.array([1e9, 1e3, 1e3, 1e3, 1e3, 3e8])  # m, rad, m/s: no measurement or deviation is larger
SAYS_NOTHING = np.array(
    [np.inf, 1e2, 1e2, 1e2, 1e2, np.inf]
)  # rad, a deviation beyond which an angle is not known at all
LARGEST_SCAN = 2000  # measurements of one step
REGULAR = 1e-4  # of a period: smaller differences of time stamps are rounding
CLOSE, EDGE, MERGED = 1, 2, 32  # flags of an estimator that warn of its covariances
SAME_SNR = 1e-3  # nepers, below which all are alike
PAIR = 2.0  # widening of R where errors may be common to two: both together then say what one does
BEYOND = 4.0  # at the edge of view
DOUBTFUL = 10.0  # of a path that is known not to be one, and in a crowd
CROWD = 4  # paths in one resolution cell, from which one more that is too weak to be found shifts them all
CELL = 1.65  # (½ c/B)² over ρ σ² of a delay with a flat band, σ = c √12/(√(8π²) B √ρ)
LONE = 0.1  # quantile of ρ σ² that is taken for that of a path with none beside it


@dataclass(frozen=True, slots=True)
class Scans(Ragged):
    """Measurements of K steps, ragged: step k owns rows `offsets[k]:offsets[k + 1]`.

    Attributes
    ----------
    z : (N, 6) array
        c·τ + bias [m], AOA az, AOA el, AOD az, AOD el [rad], radial velocity [m/s]; AOA azimuth from the
        heading, AOD in world axes.
    covariance : (N, 6, 6) array
        R of every measurement.
    offsets : (K + 1,) int array
    clutter_count : float
        Expected false measurements per scan.
    search_volume : float
        Volume [m·rad⁴·m/s] over which they spread.
    doppler_span : float
        Width of the Doppler part of that volume [m/s], divided out when Doppler is not used.
    snr : (N,) array or None
        Post-integration SNR ρ, linear.
    threshold : float or None
        Detection threshold on ρ, linear; None where p_D does not follow ρ.
    anchor : (N,) int array
        Base station of each measurement; 0 where it is not said.
    interval : (K,) array or None
        Time [s] since the step before, of the first step since the prior; None: the motion model's own period.
    cells : bool
        Whether R falls with ρ, as an estimator's does, so that the two tell the width of a resolution cell.
    label : (N,) int array or None
        True landmark of each measurement, -1 for clutter; only for simulated data, never read by a filter.
    """

    z: Array
    covariance: Array
    offsets: NDArray[np.int64]
    clutter_count: float
    search_volume: float
    doppler_span: float
    snr: Array | None = None
    threshold: float | None = None
    anchor: NDArray[np.int64] = field(default_factory=lambda: ABSENT)
    interval: Array | None = None
    cells: bool = True
    label: NDArray[np.int64] | None = None

    PER_STEP: ClassVar[tuple[str, ...]] = ("interval",)

    def __post_init__(self) -> None:
        n = len(self.z)
        fill_absent(self, ("anchor",), n)
        if self.z.shape != (n, 6) or self.covariance.shape != (n, 6, 6):
            raise FilterError(
                f"Scans: z has shape {self.z.shape} and covariance {self.covariance.shape}; expected (N, 6), (N, 6, 6)"
            )
        if self.offsets[0] != 0 or self.offsets[-1] != n or np.any(np.diff(self.offsets) < 0):
            raise FilterError(f"Scans.offsets must rise from 0 to {n}, got {self.offsets[0]} … {self.offsets[-1]}")
        if not (np.isfinite(self.z).all() and np.isfinite(self.covariance).all()):
            raise FilterError("Scans: z or covariance holds non-finite values; drop those measurements")
        if not (self.clutter_count > 0 and self.search_volume > 0 and self.doppler_span > 0):
            raise FilterError(
                "Scans: clutter_count, search_volume and doppler_span must be positive "
                f"(got {self.clutter_count}, {self.search_volume}, {self.doppler_span})"
            )
        if self.interval is not None and not (len(self.interval) == self.steps and np.all(self.interval > 0)):
            raise FilterError(f"Scans.interval must be {self.steps} positive times [s], got {self.interval[:6]}…")
        variances = np.einsum("nii->ni", self.covariance)
        wrong = (np.abs(self.z) > LARGEST) | (variances > LARGEST**2)
        if wrong.any():  # beyond these compiled code overflows, and indexes by what is no number
            row, column = (int(i) for i in np.argwhere(wrong)[0])
            raise FilterError(
                f"Scans row {row}, component {column}: value {self.z[row, column]:g} or variance "
                f"{variances[row, column]:g} beyond what can be filtered (magnitude or deviation above "
                f"{LARGEST[column]:g}); check its unit or drop the measurement"
            )
        most = int(np.diff(self.offsets).max(initial=0))
        if most > LARGEST_SCAN:
            raise FilterError(
                f"Scans: step {int(np.argmax(np.diff(self.offsets)))} holds {most} measurements, at most {LARGEST_SCAN} can "
                "be associated; lower the false-alarm rate or keep the strongest"
            )
        if n and not (variances > 0).all():
            row = int(np.argmin(variances.min(axis=1)))
            raise FilterError(
                f"Scans.covariance[{row}] has a variance ≤ 0: {variances[row]}; every component needs noise"
            )

    def pace(self, period: float) -> Array:
        """(K,) times since the step before, in periods [s] of a motion model."""
        return np.ones(self.steps) if self.interval is None else np.asarray(self.interval, float) / period

    def clutter_intensity(self, doppler: bool) -> float:
        """c(z), expected false measurements per unit volume, with or without the Doppler dimension."""
        return self.clutter_count / (self.search_volume / (1.0 if doppler else self.doppler_span))


def from_detections(
    detections: DetectionSeries,
    *,
    bs_yaw: float | Array = 0.0,
    doppler_span: float,
    minimum_clutter: float = 1e-3,
    period: float | None = None,
) -> Scans:
    """Channel estimates of a run as measurements of the filters.

    A direction that the estimator could not tell, of two paths that merged for instance, has a deviation of any number
    of turns; it is brought to one that says as little. What the estimator's flags warn of widens R: by a little for a close
    pair, whose errors hang together; by far for a path that is known not to be one, and for one of a crowd within a
    resolution cell. On 35 generated scenes the NEES of pairs lies at 1.0 of what it should be, and 12 to 27 % of the others are
    beyond 99.9 %.

    Parameters
    ----------
    detections : DetectionSeries
        Delays in seconds with the clock bias, covariances in SI units.
    bs_yaw : float or (N,) array
        Azimuth [rad] of the BS frame's x axis in the world, of one BS or of that of each detection; added to the AOD
        azimuth.
    doppler_span : float
        Width of the estimator's search in radial velocity [m/s], twice its maximum.
    minimum_clutter : float
        Least expected number of false paths per scan that is believed.
    period : float or None
        Time [s] from the prior to the first step, and between the steps of the motion model; where it and the
        detections' times are known and differ from it, the scans carry the interval of every step.
    """
    scale = np.array([SPEED_OF_LIGHT, 1.0, 1.0, 1.0, 1.0, 1.0])
    covariance = detections.covariance * scale[:, None] * scale
    deviation = np.sqrt(np.maximum(np.einsum("nii->ni", covariance), 1e-300))
    shrunk = np.minimum(1.0, SAYS_NOTHING / deviation)
    if np.any(shrunk < 1):  # elsewhere not a bit is changed
        covariance = covariance * shrunk[:, :, None] * shrunk[:, None, :]
    z = np.column_stack(
        [detections.delay * SPEED_OF_LIGHT, detections.aoa, detections.aod, detections.radial_velocity]
    ).astype(float)
    z[:, 3] = (z[:, 3] + bs_yaw + np.pi) % (2 * np.pi) - np.pi
    snr, offsets = np.asarray(detections.snr, dtype=float), np.asarray(detections.offsets, dtype=np.int64)
    cells = _tell_cells(covariance[:, 0, 0], snr)
    covariance = covariance * _widening(detections.flags, z, covariance, snr, offsets, cells)[:, None, None]
    return Scans(
        z=z,
        covariance=covariance,
        offsets=offsets,
        clutter_count=max(float(detections.false_alarm_rate), minimum_clutter),
        search_volume=float(detections.search_volume),
        doppler_span=doppler_span,
        snr=snr,
        threshold=float(detections.threshold),
        anchor=np.asarray(detections.anchor, dtype=np.int64),
        interval=_intervals(detections.time, period),
        cells=cells,
    )


def _widening(flags: NDArray, z: Array, covariance: Array, snr: Array, offsets: NDArray, cells: bool) -> Array:
    """(N,) by what the R of detections grow of which the estimator's flags warn."""
    crowded = np.zeros(len(flags), dtype=bool)
    close = np.flatnonzero(flags & CLOSE)
    if cells and len(close) >= CROWD:
        lone = np.quantile(snr[:, None] * np.einsum("nii->ni", covariance), LONE, axis=0)
        step = np.searchsorted(offsets, close, side="right")
        for rows in np.split(close, np.flatnonzero(np.diff(step)) + 1):
            apart = z[rows, None] - z[rows]
            apart[..., [1, 3]] = (apart[..., [1, 3]] + np.pi) % (2 * np.pi) - np.pi
            crowded[rows] = (apart**2 <= CELL * lone).all(axis=-1).sum(axis=1) >= CROWD
    cases = [crowded | (flags & MERGED != 0), flags & EDGE != 0, flags & CLOSE != 0]
    return np.select(cases, [DOUBTFUL, BEYOND, PAIR], 1.0)


def _tell_cells(variance: Array, snr: Array) -> bool:
    """Whether the variances (N,) of delays fall with ρ (N,): R is an estimator's, and ρ R depends on its band alone.

    What a person took for the accuracy of a device, or a covariance from repeated measurements, does not; nor is a ρ that
    is the same everywhere one.
    """
    log_variance, log_snr = np.log(np.maximum(variance, 1e-300)), np.log(np.maximum(snr, 1e-12))
    if len(snr) < 3 or not np.ptp(log_snr) > SAME_SNR:
        return False
    return bool(np.cov(log_snr, log_variance)[0, 1] < -0.5 * np.var(log_snr, ddof=1))


def _intervals(time: Array | None, period: float | None) -> Array | None:
    if time is None or period is None or not len(time):
        return None
    interval = np.diff(time, prepend=time[0] - period)
    return None if np.all(np.abs(interval - period) < REGULAR * period) else interval
