"""Posterior Cramér–Rao bound of a synthetic experiment, map unknown.

The covariance recursion of the Kalman filter linearized at the true trajectory over [p, v, all features] with
the near-constant-velocity model of paper B: the recursion (17) of paper A for singular process noise.
Features enter with a prior so wide that it carries no information.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dopslam.slam.belief import geometry
from dopslam.slam.belief.experiment import Experiment, Truth, true_amplitudes
from dopslam.slam.belief.motion import ConstantVelocity
from dopslam.slam.belief.records import Form

_UNKNOWN = 1e4  # m, prior standard deviation of a feature


@dataclass(frozen=True)
class Bound:
    """Per step: position (K,) m, heading (K,) rad, features (K, L) m — square roots of the bounds' traces."""

    position: np.ndarray
    heading: np.ndarray
    features: np.ndarray


def tangent_jacobian(form: Form, p, heading: float, q, anchor, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gradients of (length, AOA tangents, AOD tangents) of one path.

    Returns
    -------
    by_p (n, 3), by_q (n, 3), by_heading (n,), n = 1 + 2·count; the AOA in the receiver's frame
    """
    _, arrival, departure = geometry.predict(form, p, q, anchor)
    by_q, by_p = geometry.gradients(form, p, q, anchor)
    basis_a, basis_t = geometry.tangents(arrival, count), geometry.tangents(departure, count)
    rows = [np.vstack([g[:1], basis_a @ g[1:4], basis_t @ g[4:7]]) for g in (by_p, by_q)]
    spin = np.cross([0.0, 0.0, -1.0], arrival)  # d(arrival in the receiver's frame)/d heading
    by_heading = np.concatenate([[0.0], basis_a @ spin, np.zeros(count)])
    return rows[0], rows[1], by_heading


def bound(
    experiment: Experiment,
    truth: Truth,
    motion: ConstantVelocity,
    *,
    aod_for_va: bool = False,
    box: tuple[float, float] = (0.5, 1.0),
    vertical_box: tuple[float, float] = (0.5, 0.1),
) -> Bound:
    """PCRB at the true track for detection with certainty (line of sight as visible).

    Parameters
    ----------
    motion : the filter's motion model
    aod_for_va : whether virtual anchors' AODs are used
    box : half widths of the uniform prior of position [m] and velocity [m/s], entering by its variances
    vertical_box : the same for the vertical axis of spatial experiments
    """
    count, axes = (2, 3) if experiment.spatial else (1, 2)
    features = len(experiment.features)
    size = axes * (2 + features)
    transition = np.eye(size)
    transition[:axes, axes : 2 * axes] = motion.interval * np.eye(axes)
    gain = np.zeros((size, axes))
    gain[:axes], gain[axes : 2 * axes] = 0.5 * motion.interval * np.eye(axes), np.eye(axes)
    increments = np.array([motion.speed_increment, motion.speed_increment, motion.vertical_increment])[:axes]
    noise = gain * increments**2 @ gain.T
    variances = np.full(size, _UNKNOWN**2)
    variances[:axes], variances[axes : 2 * axes] = box[0] ** 2 / 3, box[1] ** 2 / 3
    if experiment.spatial:
        variances[2], variances[5] = vertical_box[0] ** 2 / 3, vertical_box[1] ** 2 / 3
    covariance = np.diag(variances)
    unit = experiment.radio.unit_deviations
    deviations = np.repeat(unit, [1, count, count])
    forms = (Form.LOS, *(f if aod_for_va or f == Form.PS else Form.VA for f in experiment.forms))
    places = np.vstack([experiment.anchor, experiment.features])
    out = np.empty((experiment.steps, 2 + features))
    for k in range(experiment.steps):
        covariance = transition @ covariance @ transition.T + noise
        p, heading, velocity = truth.position[k], float(truth.heading[k]), truth.velocity[k]
        speed = np.hypot(velocity[0], velocity[1])
        by_velocity = np.array([-np.sin(heading), np.cos(heading), 0.0])[:axes] / speed
        amplitude = true_amplitudes(experiment, p)
        hidden = experiment.blocked is not None and experiment.blocked[0] <= k < experiment.blocked[1]
        for index, (form, q) in enumerate(zip(forms, places, strict=True)):
            if hidden and form == Form.LOS:
                continue
            by_p, by_q, by_heading = tangent_jacobian(form, p, heading, q, experiment.anchor, count)
            used = 1 + count if form == Form.VA else 1 + 2 * count
            h = np.zeros((used, size))
            h[:, :axes] = by_p[:used, :axes]
            h[:, axes : 2 * axes] = by_heading[:used, None] * by_velocity
            if index:
                start = axes * (1 + index)
                h[:, start : start + axes] = by_q[:used, :axes]
            r = np.diag((deviations[:used] / amplitude[index]) ** 2)
            s = h @ covariance @ h.T + r
            k_gain = np.linalg.solve(s, h @ covariance).T
            keep = np.eye(size) - k_gain @ h
            covariance = keep @ covariance @ keep.T + k_gain @ r @ k_gain.T
        blocks = covariance.reshape(2 + features, axes, 2 + features, axes)
        traces = np.array([np.trace(blocks[i, :, i]) for i in range(2 + features)])
        out[k, 0] = np.sqrt(traces[0])
        out[k, 1] = np.sqrt(by_velocity @ blocks[1, :, 1] @ by_velocity)
        out[k, 2:] = np.sqrt(traces[2:])
    return Bound(out[:, 0], out[:, 1], out[:, 2:])
