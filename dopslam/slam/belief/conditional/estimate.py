"""Estimates (16)–(18) of the conditional filter's belief."""

from __future__ import annotations

import numpy as np

from dopslam.models.measurement import wrap
from dopslam.slam.belief.conditional.amplitude import log_losses
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
    chart, types = belief.map, [int(form) for form in parameters.types]
    exists, first = chart.existence, chart.first
    declared = 1 + np.flatnonzero(exists[1:] > parameters.detection_threshold)
    type_belief, best = np.zeros((len(declared), len(types))), np.zeros(len(declared), int)
    feature_covariance = np.zeros((len(declared), 3, 3))
    for i, k in enumerate(declared):
        low, high = first[k], first[k + 1]
        for r in range(low, high):
            type_belief[i, types.index(chart.form[r])] = chart.weight[r] / exists[k]
        best[i] = r = low + int(chart.weight[low:high].argmax())
        at = slice(3 * r, 3 * r + 3)
        feature_covariance[i] = chart.spread[at, at] + chart.gain[at] @ belief.covariance @ chart.gain[at].T
    loss = log_losses(chart.form[best], pose, chart.center[best], np.asarray(parameters.anchor, float))
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
