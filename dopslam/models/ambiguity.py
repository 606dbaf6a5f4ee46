"""Which turn a delay belongs to: a link with pilots every Δf tells delays modulo 1/Δf only.

A receiver's clock may be off by more than that range, and its paths may lie across the end of it. The prior tells
where delays must begin: no path is shorter than the line of sight, so that with the bias b of the clock every delay is
at least (|bs - p| + b)/c. Dead reckoning takes that from step to step with its uncertainty, and each delay gets the
turn that puts it into the one range that begins a margin below. Where dead reckoning has become too uncertain, the
delays themselves are followed: between two steps they move little, and their median is the middle of the range.

This is decided once, before anything else reads the delays, and without a look at the truth.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from dopslam.errors import FilterError
from dopslam.models.motion import MotionModel, paced, propagate, transition_jacobian
from dopslam.records import SPEED_OF_LIGHT, DetectionSeries

SIGMAS = 5.0  # of the beginning: margin below it
LEAST = 1 / 16  # of the range: margin below a beginning that is known exactly; noise and false paths lie there
UNKNOWN = 1e6  # m, standard deviation of what is not known at all
MOST = 1 / 4  # of the range: a larger margin says no longer which turn a delay belongs to


def unwrapped(
    detections: DetectionSeries,
    prior: tuple[np.ndarray, np.ndarray],
    motion: MotionModel,
    station: np.ndarray,
    height: float,
) -> DetectionSeries:
    """The detections with delays of the turn that they belong to; unchanged where their range has no end.

    Parameters
    ----------
    detections : ``delay_range`` says what their delays are known modulo
    prior : mean (n,) and covariance (n, n) of the receiver one period before the first step
    motion : of the receiver, by which dead reckoning goes
    station : (3,) m, of the base station
    height : m, of the receiver's plane

    Raises
    ------
    FilterError
        If neither the prior nor the delays tell where they begin.
    """
    if not np.isfinite(detections.delay_range) or not len(detections.delay):
        return detections
    span = SPEED_OF_LIGHT * detections.delay_range
    length, result = SPEED_OF_LIGHT * detections.delay, np.array(detections.delay)
    middle = None  # of the lengths of the last step that has any
    for step, (first, deviation) in enumerate(_beginnings(detections, prior, motion, station, height)):
        rows = detections.rows(step)
        if rows.start == rows.stop:
            continue
        margin = max(SIGMAS * deviation, LEAST * span)
        if margin <= MOST * span:
            low = first - margin
        elif middle is not None:
            low = middle - span / 2
        else:
            low = _behind_the_gap(length[rows], span, first, deviation)
        turns = np.ceil((low - length[rows]) / span)
        middle = float(np.median(length[rows] + turns * span))
        result[rows] += turns * detections.delay_range
    return replace(detections, delay=result)


def _beginnings(detections, prior, motion, station, height) -> Iterator[tuple[float, float]]:
    """Of every step: line of sight plus clock bias by dead reckoning, and its standard deviation [m]."""
    mean, covariance = (np.array(part, float) for part in prior)
    gaps = np.full(detections.steps, motion.interval)
    if detections.time is not None and detections.steps > 1:
        gaps[1:] = np.diff(detections.time)
    for gap in gaps:
        step = paced(motion, float(gap) / motion.interval)
        jacobian = transition_jacobian(mean, step)
        mean, covariance = propagate(mean, step), jacobian @ covariance @ jacobian.T + step.process_noise
        sight = float(np.linalg.norm(np.array([*mean[:2], height]) - station))
        yield sight + float(mean[3]), float(np.sqrt(covariance[0, 0] + covariance[1, 1] + covariance[3, 3]))


def _behind_the_gap(length: np.ndarray, span: float, first: float, deviation: float) -> float:
    """Where the range begins if only the delays say it: in the middle of the widest gap between them, in the turn that
    the prior thinks likeliest."""
    place = np.sort(length % span)
    gaps = np.diff(place, append=place[0] + span)
    widest = int(np.argmax(gaps))
    if gaps[widest] < span / 8:
        raise FilterError(
            f"delays are known modulo {span:.4g} m (1/pilot spacing), the prior says where they begin to ±{deviation:.3g} m "
            f"only, and they leave no gap; know the clock better than ±{MOST * span / SIGMAS:.3g} m (track.start_std, "
            "track.process_std), or take a smaller radio.comb"
        )
    beginning = (place[widest] + gaps[widest]) % span  # of the delays, behind the gap
    return beginning + span * np.round((first - beginning) / span) - gaps[widest] / 2
