"""Whether angles count the way that is thought: flipped signs scored by what single scans make of them.

The azimuths of arrival and departure and the elevations may each count the other way round: eight readings. Each is
given to the search for poses; the right one explains paths as single bounces and lines of sight that the others have to
call clutter. What this cannot see: a world that is mirrored as a whole (both azimuths flipped), so that readings that
differ by that are one; exchanged ends with angles in the same frames; a base station turned by a constant.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dopslam.models import unmeasured
from dopslam.models.scans import from_detections
from dopslam.records import BaseStations, DetectionSeries
from dopslam.slam.snapshot.locate import Search, find_modes
from dopslam.slam.snapshot.start import rays_of

CLEAR = 10.0  # log evidence from which another reading is clearly better
READINGS = {
    "as told": (1.0, 1.0),
    "AOA azimuth (or AOD azimuth) flipped": (-1.0, 1.0),
    "elevations flipped": (1.0, -1.0),
    "AOA azimuth (or AOD azimuth) and elevations flipped": (-1.0, -1.0),
}
"""Factors on the arrival azimuth and on the elevations; each with its mirrored world makes eight readings."""


@dataclass(frozen=True, slots=True)
class Conventions:
    """How well each reading of the angles explains the scans.

    Attributes
    ----------
    evidence : dict; log evidence of every reading, summed over the scans looked at
    scans : int
    """

    evidence: dict[str, float]
    scans: int

    @property
    def best(self) -> str:
        """The reading with most evidence."""
        return max(self.evidence, key=lambda name: self.evidence[name])

    @property
    def doubt(self) -> str | None:
        """What to look at, in one sentence; None where the angles as told are as good as any."""
        gain = self.evidence[self.best] - self.evidence["as told"]
        if gain < CLEAR:
            return None
        return (
            f"angles: {self.best} explains {self.scans} scans better by {gain:.0f} of log evidence than as told; "
            "check how your angles count"
        )


def check_conventions(
    detections: DetectionSeries,
    stations: BaseStations,
    height: float = 0.0,
    *,
    most_scans: int = 6,
    search: Search | None = None,
) -> Conventions:
    """Score the readings of the angles on some scans, those with most detections.

    Parameters
    ----------
    detections : DetectionSeries
    stations : BaseStations
        What their `anchor` column counts.
    height : float
        Of the receiver [m].
    most_scans : int
    search : Search or None
    """
    search = search or Search(heading_step=np.deg2rad(4.0), refined=60)
    scans = from_detections(detections, bs_yaw=stations.yaw[detections.anchor], doppler_span=1.0)
    planar = unmeasured.planar(np.einsum("nii->ni", scans.covariance))
    counts = np.diff(scans.offsets)
    chosen = np.sort(np.argsort(-counts, kind="stable")[:most_scans])
    chosen = chosen[counts[chosen] > 0]
    names = [name for name, (_, elevation) in READINGS.items() if elevation > 0 or not planar]
    evidence = dict.fromkeys(names, 0.0)
    for name in names:
        azimuth, elevation = READINGS[name]
        factor = np.array([1.0, azimuth, elevation, 1.0, elevation, 1.0])
        read = replace(scans, z=scans.z * factor, covariance=scans.covariance * factor[:, None] * factor)
        for step in chosen:
            rays = rays_of(read, int(step), stations.position[read.anchor], height, planar, doppler=False)
            evidence[name] += _evidence(rays, search)
    return Conventions(evidence, len(chosen))


def _evidence(rays, search: Search) -> float:
    """Of the best mode, but no less than of all paths being clutter."""
    beliefs = search.beliefs
    clutter = len(rays.z) * np.log(beliefs.clutter) + np.log1p(-beliefs.sight)
    modes = find_modes(rays, None, search)
    return float(max(clutter, modes.evidence.max(initial=-np.inf)))
