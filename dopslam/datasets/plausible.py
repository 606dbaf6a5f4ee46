"""What numbers of a record can be: covariances symmetric and positive, probabilities between 0 and 1, angles on the circle."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from dopslam.evaluate.bounds import Bound
from dopslam.evaluate.walls import Walls
from dopslam.records import SPEED_OF_LIGHT, DetectionSeries, Kind, Paths, Track
from dopslam.slam.history import History

Faults = Iterator[tuple[str, str]]
FARTHEST = 1e7  # m, of anything on earth; delays count as c·τ
FASTEST = 1e6  # m/s
SKEW = 1e-6  # of the deviations: what rounding leaves between an entry and its mirror
NEGATIVE = -1e-9  # of a correlation matrix: least eigenvalue that rounding leaves


def faults(record: Any) -> Faults:
    """What cannot be in a record, each as (array, what)."""
    rule = RULES.get(type(record))
    if rule is not None:
        yield from rule(record)


def of_covariance(name: str, matrix: np.ndarray, known: bool = False) -> Faults:
    """A stack (N, n, n) must be symmetric and positive definite; with ``known`` zero variances are allowed.

    Compared in the scale of its own deviations, so that s² and rad² count alike.
    """
    variance = np.einsum("nii->ni", matrix)
    bad = (variance < 0) | ((variance == 0) & (not known))
    if bad.any():
        row = int(np.argmax(bad.any(axis=1)))
        yield name, f"has variances that are not positive, the first in row {row}: {variance[row].min():g}"
        return
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = np.where(variance > 0, 1 / np.sqrt(variance), 1.0)
    correlation = matrix * scale[:, :, None] * scale[:, None, :]
    skew = np.abs(correlation - correlation.swapaxes(1, 2)).max(axis=(1, 2), initial=0.0) > SKEW
    if skew.any():
        yield name, f"is not symmetric, the first in row {int(np.argmax(skew))}"
        return
    least = np.linalg.eigvalsh(correlation)[:, 0] if len(matrix) else np.zeros(0)
    negative = least < NEGATIVE
    if negative.any():
        row = int(np.argmax(negative))
        yield (
            name,
            f"is not positive definite, the first in row {row} (least eigenvalue of its correlations {least[row]:.2g})",
        )


def beyond(name: str, values: np.ndarray, low: float, high: float, unit: str) -> Faults:
    """Values must lie in a range."""
    bad = (values < low) | (values > high)
    if bad.any():
        row = int(np.argmax(bad.reshape(len(values), -1).any(axis=1)))
        yield name, f"holds {int(bad.sum())} values outside {low:g} to {high:g} {unit}, the first in row {row}"


def _detections(record: DetectionSeries) -> Faults:
    yield from beyond("delay", record.delay * SPEED_OF_LIGHT, -FARTHEST, FARTHEST, "m (times c)")
    for name in ("aoa", "aod"):
        angles = getattr(record, name)
        yield from beyond(name, angles[:, 0], -4 * np.pi, 4 * np.pi, "rad")
        yield from beyond(name, angles[:, 1], -np.pi / 2 - 1e-9, np.pi / 2 + 1e-9, "rad of elevation")
    yield from beyond("radial_velocity", record.radial_velocity, -FASTEST, FASTEST, "m/s")
    yield from of_covariance("covariance", record.covariance)
    for name in ("snr", "noise_variance"):
        values = getattr(record, name)
        if np.any(values <= 0):
            yield name, f"holds values that are not positive, the first in row {int(np.argmax(values <= 0))}"
    yield from beyond("snr", record.snr, -np.inf, 1e30, "(linear; dB were not meant?)")
    for name in ("threshold", "search_volume"):
        value = getattr(record, name)
        if not (np.isfinite(value) and value > 0):
            yield name, f"is {value}, no positive number"
    if not (np.isfinite(record.false_alarm_rate) and record.false_alarm_rate >= 0):
        yield "false_alarm_rate", f"is {record.false_alarm_rate}, no number of false paths"


def _track(record: Track) -> Faults:
    yield from beyond("position", record.position, -FARTHEST, FARTHEST, "m")
    known = np.isfinite(record.bias)  # of a measured drive it may not be
    yield from beyond("bias", record.bias[known], -FARTHEST, FARTHEST, "m")
    yield from beyond("velocity", record.velocity, -FASTEST, FASTEST, "m/s")


def _paths(record: Paths) -> Faults:
    yield from beyond("tau", record.tau, 0.0, FARTHEST / SPEED_OF_LIGHT, "s")
    for name in ("theta_t", "theta_r"):
        yield from beyond(name, getattr(record, name), -1e-9, np.pi + 1e-9, "rad of zenith angle")
    for name in ("phi_t", "phi_r"):
        yield from beyond(name, getattr(record, name), -2 * np.pi, 2 * np.pi, "rad")


def _history(record: History) -> Faults:
    yield from of_covariance("covariance", record.covariance, known=True)
    yield from of_covariance("position_covariance", record.position_covariance, known=True)
    yield from beyond("existence", record.existence, 0.0, 1 + 1e-9, "(a probability)")
    yield from beyond("type_probability", record.type_probability, 0.0, 1 + 1e-9, "(a probability)")
    if not np.all(np.isin(record.kind, list(Kind))):
        yield "kind", "holds an unknown kind; known are 0 BS, 1 VA, 2 SP"


def _bound(record: Bound) -> Faults:
    yield from of_covariance("covariance", record.covariance, known=True)
    marks = record.landmark.reshape(-1, 3, 3)
    yield from of_covariance("landmark", marks[np.isfinite(marks).all(axis=(1, 2))], known=True)


def _walls(record: Walls) -> Faults:
    yield from beyond(
        "normal", np.linalg.norm(record.normal, axis=1), 1 - 1e-6, 1 + 1e-6, "(the length of a unit vector)"
    )
    yield from of_covariance("covariance", record.covariance, known=True)
    yield from beyond("existence", record.existence, 0.0, 1 + 1e-9, "(a probability)")


RULES: dict[type, Callable[[Any], Faults]] = {
    DetectionSeries: _detections, Track: _track, Paths: _paths, History: _history, Bound: _bound, Walls: _walls,
}  # fmt: skip
