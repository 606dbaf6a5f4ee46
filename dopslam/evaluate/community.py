"""Figures that people know from elsewhere, of one run: ATE and RPE as evo states them, OSPA and T-GOSPA of the map.

They stand in ``summary.json`` beside ours. The map's truth exists at every step, so that T-GOSPA charges a landmark for the
steps before it was found, and a track that takes over a landmark from another one for the change.
"""

from __future__ import annotations

import numpy as np

from dopslam.evaluate.sets import ospa, trajectory_gospa
from dopslam.evaluate.trajectory import absolute_errors, poses, relative_errors, statistics
from dopslam.records import Kind, Landmarks, Track
from dopslam.slam.history import History

LARGEST = 40_000  # pairs times steps of the linear program of T-GOSPA, some seconds; beyond it the figure is left out


def figures(
    track: Track,
    landmarks: Landmarks,
    history: History,
    threshold: float,
    cutoff: float,
    order: float,
    largest_order: int = 1,
) -> dict:
    """The figures by their keys; None where there is none.

    Parameters
    ----------
    threshold : least existence of a landmark that is reported
    cutoff, order : of OSPA and T-GOSPA, whose switching penalty is a tenth of the cutoff
    largest_order : reflections up to which a virtual anchor is looked for
    """
    truth, estimate = poses(track.position[:, :2], track.heading), poses(history.mean[:, :2], history.mean[:, 2])
    found: dict[str, float | None] = {"ate_m": statistics(absolute_errors(truth, estimate)).rmse}
    if track.steps > 1:
        translation, angle = relative_errors(truth, estimate)
        found |= {"rpe_m": statistics(translation).rmse, "rpe_deg": float(np.degrees(statistics(angle).rmse))}
    for name, kind in (("va", Kind.VA), ("sp", Kind.SP)):
        true = landmarks.position[(landmarks.kind == kind) & (landmarks.order <= largest_order)]
        last = history.reported(history.steps - 1, kind, threshold)
        found[f"ospa_{name}_m"] = ospa(true, last, cutoff, order)
        tracks = trajectories(history, kind, threshold)
        small = (len(true) + 1) * (len(tracks) + 1) * track.steps <= LARGEST
        fixed = np.repeat(true[:, None], track.steps, axis=1)
        whole = trajectory_gospa(fixed, tracks, cutoff, order, 0.1 * cutoff) if small else None
        found[f"t_gospa_{name}_m"] = None if whole is None else whole.distance
    return found


def trajectories(history: History, kind: int, threshold: float) -> np.ndarray:
    """(E, K, 3) m, where every track of the map lay at every step; NaN at steps that do not report it as this kind."""
    shown = (history.kind == kind) & (history.existence > threshold)
    numbers, row = np.unique(history.track[shown], return_inverse=True)
    out = np.full((len(numbers), history.steps, 3), np.nan)
    out[row, history.step_of_row[shown]] = history.position[shown]
    return out
