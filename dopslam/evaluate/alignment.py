"""Track and map moved rigidly onto a truth that was measured in another frame.

A tachymeter or a camera system has a frame of its own: how it lies to the base station's is seldom known to a degree. The
plane is turned about the vertical and shifted so that the estimated positions come as near to the true ones as they can
(Umeyama 1991, no scale); heights, clock and existence stay. What is left is the shape of the track: an error of the whole
against the base station is not seen any more, and no bound of the position is one of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dopslam.errors import DopslamError
from dopslam.evaluate.trajectory import alignment, poses
from dopslam.models.measurement import wrap
from dopslam.records import Track
from dopslam.slam.history import History


def aligned(history: History, track: Track) -> tuple[History, dict[str, float]]:
    """A history in the frame of the true track, and how it was moved.

    Parameters
    ----------
    history : K steps
    track : the truth of the same steps; its headings are not read

    Returns
    -------
    History
    dict
        ``turned_deg`` [°] and ``moved_m`` [m], the shift of the estimated track's middle.

    Raises
    ------
    DopslamError
        If the steps differ, or all positions lie on one line, which may be turned about.
    """
    flat = np.zeros(track.steps)
    try:
        move = alignment(poses(track.position[:, :2], flat), poses(history.mean[:, :2], flat[: history.steps]))
    except DopslamError as error:
        raise DopslamError(f"--align: {error}") from error
    turn = float(np.arctan2(move[1, 0], move[0, 0]))
    mean, covariance = history.mean.copy(), history.covariance.copy()
    mean[:, :2] = mean[:, :2] @ move[:2, :2].T + move[:2, 3]
    mean[:, 2] = wrap(mean[:, 2] + turn)
    covariance[:, :2] = move[:2, :2] @ covariance[:, :2]
    covariance[:, :, :2] = covariance[:, :, :2] @ move[:2, :2].T
    rotation = move[:3, :3]
    shift = mean[:, :2].mean(axis=0) - history.mean[:, :2].mean(axis=0)
    moved = replace(
        history,
        mean=mean,
        covariance=covariance,
        position=history.position @ rotation.T + move[:3, 3],
        position_covariance=rotation @ history.position_covariance @ rotation.T,
    )
    return moved, {"turned_deg": float(np.degrees(turn)), "moved_m": float(np.linalg.norm(shift))}
