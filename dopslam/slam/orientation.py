"""A base station whose orientation is not exactly known: how far the whole world may be turned about it.

Where nothing is told of the start, detections fix track and map only relative to the base station: turning it, the track
and the map together about its vertical axis changes no detection but the departures, and by the same angle as a wrong
yaw does. What is known of the yaw is then all that can be known of the turn, and adds to every covariance. This is exact
to first order for motion models that know no direction, as all of :mod:`dopslam.models.motion` are.

Where the true track is known the detections tell the yaw themselves (:func:`yaw_of_track`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dopslam.models import unmeasured
from dopslam.models.measurement import wrap
from dopslam.records import BaseStations, DetectionSeries
from dopslam.slam.history import History

SIGHTED = 0.6  # share of the scans that have a line of sight
CLEAR = 10.0  # log evidence above all others from which a yaw is told

Array = NDArray[np.float64]


def turnable(history: History, station: Array, yaw_std: float) -> History:
    """The history with the covariances of a world that may be turned.

    Parameters
    ----------
    history : of a run that was told nothing of its start
    station : (3,) m
    yaw_std : rad, standard deviation of the base station's yaw
    """
    state = np.zeros_like(history.mean)
    state[:, 0], state[:, 1] = -(history.mean[:, 1] - station[1]), history.mean[:, 0] - station[0]
    state[:, 2] = 1.0
    place = np.zeros_like(history.position)
    place[:, 0], place[:, 1] = -(history.position[:, 1] - station[1]), history.position[:, 0] - station[0]
    return replace(
        history,
        covariance=history.covariance + yaw_std**2 * state[:, :, None] * state[:, None, :],
        position_covariance=history.position_covariance + yaw_std**2 * place[:, :, None] * place[:, None, :],
    )


@dataclass(frozen=True, slots=True)
class Yaw:
    """Orientation of a base station as departures along a known track tell it.

    Attributes
    ----------
    value, std : rad
    """

    value: float
    std: float


def yaw_of_track(detections: DetectionSeries, position: Array, stations: BaseStations, station: int = 0) -> Yaw | None:
    """The yaw of a base station from a track that is known, a surveyed one for instance.

    Of every scan one path may be the line of sight, whichever: then its departure points at the receiver. A yaw that is right
    is so for all scans; what a wall or an object does looks like a turned base station only while the receiver stands still.

    Parameters
    ----------
    detections : departures in the base station's frame
    position : (K, 2) or (K, 3) m, of the receiver at every scan, in the frame of the base station's position
    stations : which stand where
    station : the one that is asked for

    Returns
    -------
    Yaw or None
        None where no yaw, or more than one, explains the scans clearly.
    """
    step = np.repeat(np.arange(detections.steps), np.diff(detections.offsets))
    variance = detections.covariance[:, 3, 3]
    rows = np.flatnonzero((detections.anchor == station) & (variance < unmeasured.UNSEEN[3]))
    if not len(rows):
        return None
    way = np.asarray(position, float)[step[rows], :2] - stations.position[station, :2]
    turned, spread = np.arctan2(way[:, 1], way[:, 0]) - detections.aod[rows, 0], np.sqrt(variance[rows])
    _, scan, count = np.unique(step[rows], return_inverse=True, return_counts=True)

    def evidence(yaw: Array) -> Array:
        """log likelihood of yaws (Y,) over departures that may be anything."""
        square = (wrap(turned - yaw[:, None]) / spread) ** 2
        density = sum(
            share * np.exp(-0.5 * square / scale**2) / (scale * spread) for share, scale in ((0.8, 1.0), (0.2, 4.0))
        )
        ratio = np.zeros((len(yaw), len(count)))
        np.add.at(ratio.T, scan, (np.sqrt(2 * np.pi) * density / count[scan]).T)
        return np.log((1 - SIGHTED) + SIGHTED * ratio).sum(axis=1)

    fine = max(0.5 * float(np.median(spread)), np.deg2rad(0.02))
    grid = np.arange(-np.pi, np.pi, fine)
    score = np.concatenate(
        [evidence(part) for part in np.array_split(grid, max(1, len(grid) * len(rows) // 1_000_000))]
    )
    best = grid[np.argmax(score)]
    other = np.abs(wrap(grid - best)) > 10 * fine
    if score.max() < max(CLEAR, score[other].max(initial=0.0) + CLEAR):
        return None
    near = best + fine * np.linspace(-6, 6, 601)
    weight = np.exp(evidence(near) - score.max())
    value = float(np.sum(weight * near) / weight.sum())
    std = float(np.sqrt(np.sum(weight * (near - value) ** 2) / weight.sum()))
    return Yaw(float(wrap(value)), std)
