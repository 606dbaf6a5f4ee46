"""Estimates (16)–(18) of the conditional filter's belief."""

from __future__ import annotations

import numpy as np

from dopslam.models.measurement import wrap
from dopslam.slam.belief.conditional.amplitude import log_loss
from dopslam.slam.belief.conditional.belief import Belief
from dopslam.slam.belief.motion import BIAS, HEADING, POSITION, VELOCITY
from dopslam.slam.belief.records import Estimate, Parameters


def estimate_of(parameters: Parameters, belief: Belief, pose: np.ndarray, by_coordinate: np.ndarray) -> Estimate:
    """MMSE estimates of the agent and of the declared features, each under its likeliest type.

    pose (8,), by_coordinate (8, c) : of the belief's mean
    """
    slope = by_coordinate[:, belief.active]
    covariance = slope @ belief.covariance @ slope.T
    state = [0, 1, HEADING, BIAS]
    chart, types = belief.map, list(parameters.types)
    exists = chart.existence
    declared = [k for k in range(1, len(exists)) if exists[k] > parameters.detection_threshold]
    type_belief, best = np.zeros((len(declared), len(types))), np.zeros(len(declared), int)
    for i, k in enumerate(declared):
        rows = np.arange(chart.first[k], chart.first[k + 1])
        for r in rows:
            type_belief[i, types.index(chart.form[r])] = chart.weight[r] / exists[k]
        best[i] = rows[np.argmax(chart.weight[rows])]
    feature_covariance = np.zeros((len(declared), 3, 3))
    for i, r in enumerate(best):
        at = slice(3 * r, 3 * r + 3)
        gain = chart.gain[at]
        feature_covariance[i] = chart.spread[at, at] + gain @ belief.covariance @ gain.T
    anchor = np.asarray(parameters.anchor, float)
    loss = np.array([log_loss(chart.form[r], pose, *chart.center[r], anchor) for r in best])
    return Estimate(
        position=pose[POSITION].copy(),
        covariance=covariance[POSITION, POSITION],
        velocity=pose[VELOCITY].copy(),
        heading=float(wrap(pose[HEADING])),
        heading_deviation=float(np.sqrt(max(covariance[HEADING, HEADING], 0.0))),
        bias=float(pose[BIAS]),
        state_covariance=covariance[np.ix_(state, state)],
        label=chart.label[declared],
        existence=exists[declared],
        type_belief=type_belief,
        feature=chart.center[best],
        feature_covariance=feature_covariance,
        amplitude=chart.reference[best, 0] * np.exp(-0.5 * loss),
    )
