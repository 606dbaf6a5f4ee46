"""What measured detections show of a drive that nobody described: how fast the receiver can be, how far off what it hears.

Only their spread counts, never a single value: a false detection has any delay and any Doppler.
"""

from __future__ import annotations

import numpy as np

from dopslam.config.measured import Shown
from dopslam.records import SPEED_OF_LIGHT, DetectionSeries

MOST = 0.9  # quantile that counts as the largest
MARGIN = 1.5
SLOWEST = 1.0  # m/s
FASTEST = 100.0  # m/s


def shown_by(found: DetectionSeries, period: float | None, doppler: bool) -> Shown:
    """Speed and reach.

    Parameters
    ----------
    found : the detections
    period : s, between the snapshots; None where they are only counted
    doppler : whether radial velocities were measured; without them the first arrivals' delays, whose change a walk of the
        clock is part of, show how fast the receiver is
    """
    scans = [found.delay[found.rows(k)] * SPEED_OF_LIGHT for k in range(found.steps)]
    full = [scan for scan in scans if len(scan)]
    spread = np.quantile([np.ptp(scan) for scan in full], MOST) if full else 0.0
    if doppler:
        fast = np.quantile(np.abs(found.radial_velocity), MOST) if len(found.delay) else 0.0
    else:
        first = np.array([scan.min() if len(scan) else np.nan for scan in scans])
        steps = np.abs(np.diff(first))
        steps = steps[np.isfinite(steps)] / (period or 1.0)
        fast = np.median(steps) if len(steps) else 0.0
    speed = float(np.clip(MARGIN * fast, SLOWEST, FASTEST))
    return Shown(round(speed, 3), round(float(spread), 1))
