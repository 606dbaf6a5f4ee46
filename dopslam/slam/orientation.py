"""A base station whose orientation is not exactly known: how far the whole world may be turned about it.

Where nothing is told of the start, detections fix track and map only relative to the base station: turning it, the track
and the map together about its vertical axis changes no detection but the departures, and by the same angle as a wrong
yaw does. What is known of the yaw is then all that can be known of the turn, and adds to every covariance. This is exact
to first order for motion models that know no direction, as all of :mod:`dopslam.models.motion` are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dopslam.slam.history import History

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
