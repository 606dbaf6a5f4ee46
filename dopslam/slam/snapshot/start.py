"""From the scans of a run to where it starts, with no prior: what a filter or a smoother is given instead of one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dopslam.errors import FilterError
from dopslam.models import unmeasured
from dopslam.models.motion import MotionModel, paced, propagate, transition_jacobian
from dopslam.models.scans import Scans, from_detections
from dopslam.records import BaseStations, DetectionSeries
from dopslam.slam.snapshot.candidates import Prior
from dopslam.slam.snapshot.chain import Chain, Walk, before, chain
from dopslam.slam.snapshot.locate import Modes, Search, find_modes
from dopslam.slam.snapshot.rays import Rays

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Start:
    """Where a run starts, found from its scans.

    Attributes
    ----------
    mean, covariance : (n,), (n, n) arrays
        State one period before the first scan. The mean is the whole chain's, the covariance that of one scan alone:
        who starts from it reads the same scans again.
    best : int
        Scan whose mode is the surest.
    chain : Chain
    """

    mean: Array
    covariance: Array
    best: int
    chain: Chain


def rays_of(scans: Scans, step: int, anchors: Array, height: float, planar: bool = False, doppler: bool = True) -> Rays:
    """One scan as rays; `anchors` (3,) for one base station, (N, 3) row by row for several."""
    rows = scans.rows(step)
    anchor = np.broadcast_to(anchors, (len(scans.z), 3))[rows]
    return Rays(scans.z[rows], scans.covariance[rows], np.array(anchor), height, planar, doppler)


def locate(
    detections: DetectionSeries,
    stations: BaseStations,
    height: float = 0.0,
    *,
    step: int = 0,
    planar: bool = False,
    doppler: bool = True,
    prior: Prior | None = None,
    search: Search | None = None,
) -> Modes:
    """Where a receiver is from one scan and nothing else: position, heading, clock bias, and with Doppler the velocity.

    Parameters
    ----------
    detections : DetectionSeries
        Delays [s] and angles [rad] of one or more scans.
    stations : BaseStations
        What the detections' `anchor` column counts.
    height : float
        Of the receiver [m].
    step : int
        The scan that is looked at.
    planar : bool
        No elevations were measured: everything lies in the horizontal plane.
    doppler : bool
        Whether the radial velocities were measured.
    prior : Prior or None
        Knowledge of the pose, one more factor.
    search : Search or None

    Returns
    -------
    Modes
        The best first; `pose` (M, 4) [x m, y m, heading rad, bias m] with `covariance` (M, 4, 4) and `probability` (M,).
        None at all if the scan has too few paths.

    Examples
    --------
    >>> modes = locate(detections, stations, height=1.5)  # doctest: +SKIP
    >>> modes.pose[0], modes.covariance[0]  # doctest: +SKIP
    """
    one = detections.take([step])
    if len(one.anchor) and one.anchor.max() >= len(stations):
        raise FilterError(
            f"locate: a detection of step {step} names base station {one.anchor.max()}, but there are {len(stations)}"
        )
    scans = from_detections(one, bs_yaw=stations.yaw[one.anchor], doppler_span=1.0)
    return find_modes(rays_of(scans, 0, stations.position[one.anchor], height, planar, doppler), prior, search)


def walk_of(motion: MotionModel, mean: Array, covariance: Array) -> Walk:
    """Poses' walk under a motion model; states beyond the pose are drawn anew each step from their prior."""
    n = motion.dimension
    extra = np.asarray(mean, float)[4:]
    spread = np.asarray(covariance, float)[4:, 4:]

    def step(pose: Array) -> tuple[Array, Array]:
        state = np.concatenate([pose, np.broadcast_to(extra, (len(pose), n - 4))], axis=1)
        return propagate(state, motion)[:, :4], transition_jacobian(state, motion)[:, :4, :4]

    noise = np.array(motion.process_noise[:4, :4])
    if n > 4:
        # How far an unknown speed and turn rate carry does not depend on where: a heading of zero and of a right angle
        # together bound it in both directions.
        for heading in (0.0, 0.5 * np.pi):
            state = np.concatenate([[0.0, 0.0, heading, 0.0], extra])
            by_extra = transition_jacobian(state, motion)[:4, 4:]
            noise = noise + by_extra @ spread @ by_extra.T
    return Walk(step, noise)


def start(
    scans: Scans,
    motion: MotionModel,
    anchors: Array,
    height: float,
    *,
    prior: tuple[Array, Array] | None = None,
    planar: bool | None = None,
    doppler: bool = True,
    search: Search | None = None,
) -> Start:
    """Where the run starts.

    Parameters
    ----------
    scans : Scans
    motion : CoordinatedTurn
    anchors : (3,) array, or (N, 3) with the base station of every detection
    height : float
    prior : mean (n,) and covariance (n, n), or None
        Of speed and turn rate only, where the motion model has them in its state; the pose is found.
    planar : bool or None
        Elevations were not measured; None: as the variances say.
    search : Search or None

    Raises
    ------
    FilterError
        If no scan tells where the receiver is, or none can.
    """
    search = search or Search()
    _refuse_turnable(scans, anchors)
    planar = unmeasured.planar(np.einsum("nii->ni", scans.covariance)) if planar is None else planar
    n = motion.dimension
    mean, covariance = prior if prior is not None else (np.zeros(n), 100.0 * np.eye(n))
    pace = scans.pace(motion.interval)
    of_pace = {p: walk_of(paced(motion, p), mean, covariance) for p in set(pace.tolist())}
    walks = [of_pace[p] for p in pace.tolist()]
    found = [find_modes(rays_of(scans, k, anchors, height, planar, doppler), None, search) for k in range(scans.steps)]
    joined = chain(found, passing(scans, search), walks)
    first, _ = before(joined.mean[0], joined.covariance[0], walks[0])
    used = np.flatnonzero(joined.chosen >= 0)
    alone = found[used[0]].covariance[joined.chosen[used[0]]]
    for walk in walks[int(used[0]) :: -1]:
        alone = before(first, alone, walk)[1]
    whole_mean, whole = np.array(mean, float), np.array(covariance, float)
    whole_mean[:4] = first
    whole[:4, :], whole[:, :4] = 0.0, 0.0
    whole[:4, :4] = alone
    best = int(used[np.argmax(joined.margin[used])])
    return Start(whole_mean, whole, best, joined)


OPEN = {
    1: ("arrival", "the receiver's heading may be anything"),
    3: ("departure", "the whole world may be turned about the base station"),
}
"""What is left open where no azimuth of an end was measured, by its column."""


def _refuse_turnable(scans: Scans, anchors: Array) -> None:
    """With one base station a start from the scans alone needs the azimuths of both ends."""
    variance = np.einsum("nii->ni", scans.covariance)
    if not len(variance) or len(np.unique(np.atleast_2d(anchors), axis=0)) > 1:
        return
    for column, (end, open_) in OPEN.items():
        if (variance[:, column] > unmeasured.UNSEEN[column]).all():
            raise FilterError(
                f"snapshot start: no azimuth of {end} was measured, and without one {open_}: nothing tells where the receiver "
                'starts; give track.start and track.start_std and set filter.start = "prior" (from a start in a frame of your '
                "own track and map come out in that frame), or measure azimuths at both ends"
            )


def passing(scans: Scans, search: Search) -> Array:
    """(K,) log likelihood of every scan if all its paths are clutter."""
    beliefs = search.beliefs
    return np.diff(scans.offsets) * np.log(beliefs.clutter) + np.log1p(-beliefs.sight)
