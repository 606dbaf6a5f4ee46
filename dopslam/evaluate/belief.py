"""Posterior Cramér-Rao bounds of the belief-propagation experiments, map unknown: the recursion of
:mod:`dopslam.evaluate.recursion` over [p, v] and all features, with the near-constant-velocity models of their filters.
Features have no prior information where nothing else is said.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dopslam.evaluate.recursion import LinearizedRun, filtering
from dopslam.slam.belief import geometry
from dopslam.slam.belief.distance_only.filter import RangeParameters
from dopslam.slam.belief.distance_only.scene import RangeScenario
from dopslam.slam.belief.experiment import Experiment, Truth, true_amplitudes
from dopslam.slam.belief.motion import ConstantVelocity
from dopslam.slam.belief.records import Form

ROOM = 10.0  # m, prior standard deviation of a feature that is in the same room


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
    transition = np.eye(2 * axes)
    transition[:axes, axes:] = motion.interval * np.eye(axes)
    gain = np.vstack([0.5 * motion.interval * np.eye(axes), np.eye(axes)])
    increments = np.array([motion.speed_increment, motion.speed_increment, motion.vertical_increment])[:axes]
    variances = np.repeat([box[0] ** 2 / 3, box[1] ** 2 / 3], axes)
    if experiment.spatial:
        variances[[2, 5]] = vertical_box[0] ** 2 / 3, vertical_box[1] ** 2 / 3
    deviations = np.repeat(experiment.radio.unit_deviations, [1, count, count])
    forms = (Form.LOS, *(f if aod_for_va or f == Form.PS else Form.VA for f in experiment.forms))
    places = np.vstack([experiment.anchor, experiment.features])
    state = np.zeros((experiment.steps, 2 * axes, 2 * axes))
    cross = np.zeros((experiment.steps, features, 2 * axes, axes))
    landmark = np.zeros((experiment.steps, features, axes, axes))
    turns = np.empty((experiment.steps, axes))
    for k in range(experiment.steps):
        p, heading, velocity = truth.position[k], float(truth.heading[k]), truth.velocity[k]
        turns[k] = np.array([-np.sin(heading), np.cos(heading), 0.0])[:axes] / np.hypot(velocity[0], velocity[1])
        amplitude = true_amplitudes(experiment, p)
        hidden = experiment.blocked is not None and experiment.blocked[0] <= k < experiment.blocked[1]
        for index, (form, q) in enumerate(zip(forms, places, strict=True)):
            if hidden and form == Form.LOS:
                continue
            by_p, by_q, by_heading = tangent_jacobian(form, p, heading, q, experiment.anchor, count)
            used = 1 + count if form == Form.VA else 1 + 2 * count
            white = (amplitude[index] / deviations[:used])[:, None]
            by_state = white * np.hstack([by_p[:used, :axes], by_heading[:used, None] * turns[k]])
            by_feature = white * by_q[:used, :axes]
            state[k] += by_state.T @ by_state
            if index:
                cross[k, index - 1] = by_state.T @ by_feature
                landmark[k, index - 1] = by_feature.T @ by_feature
    run = LinearizedRun(
        prior=np.diag(variances),
        transition=np.broadcast_to(transition, state.shape),
        noise=np.broadcast_to(gain * increments**2 @ gain.T, state.shape),
        state=state,
        cross=cross,
        landmark=landmark,
        seen=np.full((experiment.steps, features), True),
    )
    own, feature = filtering(run)
    return Bound(
        np.sqrt(np.trace(own[:, :axes, :axes], axis1=1, axis2=2)),
        np.sqrt(np.einsum("ki,kij,kj->k", turns, own[:, axes:, axes:], turns)),
        np.sqrt(np.trace(feature, axis1=2, axis2=3)),
    )


def distance_bound(
    scenario: RangeScenario, parameters: RangeParameters, radius: float = 0.5, speed: float = 0.05
) -> np.ndarray:
    """(K,) PCRB of the position [m] from distances alone, with the association known and the map unknown.

    With p_D of every distance's information and the filter's motion model; ``radius`` [m] and ``speed`` [m/s] of the start.
    A feature is known to be within :data:`ROOM`.
    """
    p, steps = parameters, len(scenario.track)
    unknown = np.concatenate([f[1:] for f in scenario.features])
    transition, gain = np.eye(4), np.vstack([0.5 * p.interval**2 * np.eye(2), p.interval * np.eye(2)])
    transition[:2, 2:] = p.interval * np.eye(2)
    weight = p.detection / p.deviation**2
    state, cross = np.zeros((steps, 4, 4)), np.zeros((steps, len(unknown), 4, 2))
    landmark = np.zeros((steps, len(unknown), 2, 2))
    for k, place in enumerate(scenario.track):
        e = np.concatenate([place - scenario.anchors, place - unknown])
        e /= np.linalg.norm(e, axis=1, keepdims=True)
        state[k, :2, :2] = weight * e.T @ e
        landmark[k] = weight * e[len(scenario.anchors) :, :, None] * e[len(scenario.anchors) :, None, :]
        cross[k, :, :2] = -landmark[k]
    landmark[0] += np.eye(2) / ROOM**2
    run = LinearizedRun(
        prior=np.diag([radius**2 / 4] * 2 + [speed**2 / 3] * 2),
        transition=np.broadcast_to(transition, state.shape),
        noise=np.broadcast_to(p.acceleration**2 * gain @ gain.T, state.shape),
        state=state,
        cross=cross,
        landmark=landmark,
        seen=np.full((steps, len(unknown)), True),
    )
    return np.sqrt(np.trace(filtering(run)[0][:, :2, :2], axis1=1, axis2=2))
