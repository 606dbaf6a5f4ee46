"""A direction that the estimator could not tell is filtered as one that says nothing, not refused."""

from dataclasses import replace

import numpy as np

import dopslam as ds


def test_a_direction_of_any_number_of_turns_says_nothing():
    scenario = ds.load("ring_road", set=["source.kind=model", "track.steps=4"])
    _, detections = ds.simulate(scenario, seed=4)
    problem = ds.problem(scenario)
    told = {}
    for deviation in (50.0, 2e3, 1e6):
        covariance = detections.covariance.copy()
        covariance[3, 3, :] = covariance[3, :, 3] = 0.0
        covariance[3, 3, 3] = deviation**2
        told[deviation] = ds.slam(problem, replace(detections, covariance=covariance), "joint").mean
    np.testing.assert_allclose(told[2e3], told[50.0], atol=1e-4)
    np.testing.assert_array_equal(told[1e6], told[2e3])
