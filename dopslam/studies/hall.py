"""Filters on `measured_hall` from no prior, beside the bound of the generator's true noise.

The bound knows the scale and the tails of the errors (the Fisher information of a Student-t), which detection stems from
which landmark, and how far the receiver may walk; the base station's yaw is an unknown of it with the deviation that it
is off by, since nothing in the detections tells a turned world from a turned base station.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dopslam.errors import DopslamError
from dopslam.evaluate import metrics
from dopslam.evaluate.recursion import LinearizedRun, smoothing
from dopslam.models.measurement import BS, SR, jacobians
from dopslam.models.motion import CoordinatedTurn
from dopslam.models.scans import from_detections
from dopslam.simulate.hall import DOPPLER, HEIGHT, TAIL, YAW_OFF, Hall, measured_hall
from dopslam.slam.filter import Filter, Problem, run

Array = NDArray[np.float64]

WALK = np.array([0.6, 0.6, 0.6, 0.5])  # m, m, rad, m per position: what a filter is told of the walk
LOST = 2.0  # m, RMSE from which a run counts as lost
PLANE = [0, 1, 3]  # rows that are measured


@dataclass(frozen=True, slots=True)
class Run:
    """Errors of one run, per position.

    Attributes
    ----------
    squared, bound : (K,) m²; squared error of the position and its squared bound
    nees : (K,)
    failure : str; empty unless the filter raised
    said : str; why the receiver counts as lost without the truth, empty if nothing speaks for it
    restarted : str; from where the filter was started anew
    """

    squared: Array
    bound: Array
    nees: Array
    failure: str = ""
    said: str = ""
    restarted: str = ""

    @property
    def lost(self) -> bool:
        """Whether the track is of no use."""
        return bool(self.failure) or not float(np.sqrt(np.mean(self.squared))) < LOST


def problem_of(hall: Hall) -> Problem:
    """What a filter is told: the base station, its orientation to 1.5°, and that the receiver walks."""
    motion = CoordinatedTurn(1.0, np.diag(WALK**2))
    wide = np.diag([1e3, 1e3, 10.0, 1e3]) ** 2
    return Problem(
        hall.stations, np.zeros(4), wide, motion, height=HEIGHT, doppler_limit=DOPPLER, snapshot=True, yaw_std=YAW_OFF,
        restart=True,
    )  # fmt: skip


def bound_of(hall: Hall) -> Array:
    """(K, 2, 2) smoothing bound of the position under the generator's true noise, yaw and walk unknown."""
    steps, landmarks = hall.track.steps, hall.landmarks
    scans = from_detections(hall.detections, doppler_span=1.0)
    station, state = hall.stations.position[0], hall.track.state
    kind = np.where(landmarks.order == 2, SR, landmarks.kind.astype(np.int64))
    rows = np.flatnonzero(hall.label >= 0)
    step, which = scans.step_of_row[rows], hall.label[rows]
    by_state, by_point = jacobians(state[step], landmarks.position[which], kind[which], station, height=HEIGHT)
    by_yaw = np.zeros((len(rows), 6, 1))
    by_yaw[:, 3] = 1.0
    true = np.einsum("nii->ni", scans.covariance[rows]) / hall.information[rows, None]
    weight = 1 / true
    weight[:, [1, 3]] *= (TAIL + 1) / (TAIL + 3)
    weight[kind[which] == SR, 3] = 0.0
    a, b = np.concatenate([by_state, by_yaw], axis=2)[:, PLANE], by_point[:, PLANE, :2]
    left = np.swapaxes(a * weight[:, PLANE, None], 1, 2)
    free = np.flatnonzero(landmarks.kind != BS)
    number = np.full(len(landmarks), -1)
    number[free] = np.arange(len(free))
    own = number[which] >= 0
    at = step[own], number[which[own]]
    total = np.zeros((steps, 5, 5))
    np.add.at(total, step, left @ a)
    cross, landmark = np.zeros((steps, len(free), 5, 2)), np.zeros((steps, len(free), 2, 2))
    seen = np.zeros((steps, len(free)), bool)
    cross[at] = (left @ b)[own]
    landmark[at] = (np.swapaxes(b * weight[:, PLANE, None], 1, 2) @ b)[own]
    seen[at] = True
    prior = np.diag([1e3, 1e3, 10.0, 1e3, YAW_OFF]) ** 2
    noise = np.diag([*WALK, 0.0]) ** 2
    run_ = LinearizedRun(
        prior, np.tile(np.eye(5), (steps, 1, 1)), np.tile(noise, (steps, 1, 1)), total, cross, landmark, seen
    )
    return smoothing(run_)[0][:, :2, :2]


def judged(seed: int, chosen: Filter, steps: int = 45) -> Run:
    """One drawn campaign through a filter."""
    hall = measured_hall(seed, steps)
    bound = np.trace(bound_of(hall), axis1=1, axis2=2)
    try:
        history, _ = run(problem_of(hall), hall.detections, chosen, seed)
    except DopslamError as error:
        nothing = np.full(steps, np.nan)
        return Run(nothing, bound, nothing, f"seed {seed}: {error}")
    error = metrics.state_errors(history.mean[:, :4], hall.track.state)
    return Run(
        np.sum(error[:, :2] ** 2, axis=1),
        bound,
        metrics.nees(error, history.covariance[:, :4, :4]),
        "",
        history.lost,
        history.restarted,
    )


def summarize(runs: list[Run]) -> dict[str, Any]:
    """Lost runs, and root mean squares over the others and all positions."""
    good = [r for r in runs if not r.lost]
    return {
        "runs": len(runs),
        "lost": len(runs) - len(good),
        "of_these_named": sum(r.lost and bool(r.said or r.failure) for r in runs),
        "good_ones_suspected": sum(bool(r.said) for r in good),
        "restarted": sum(bool(r.restarted) for r in runs),
        "position_rmse_m": float(np.sqrt(np.mean([r.squared for r in good]))) if good else None,
        "rmse_over_bound": float(np.sqrt(np.mean([r.squared for r in good]) / np.mean([r.bound for r in good])))
        if good
        else None,
        "nees": float(np.mean([r.nees for r in good])) if good else None,
        "failures": [r.failure for r in runs if r.failure],
    }
