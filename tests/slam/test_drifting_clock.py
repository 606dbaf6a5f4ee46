"""A clock whose rate is off: bias and drift in the state of any motion model, through filter and bound."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.config.scenario import load
from dopslam.errors import FilterError
from dopslam.evaluate.bounds import detection_mask, pcrb
from dopslam.filters import FILTERS
from dopslam.models.clocks import DriftingClock
from dopslam.models.motion import differences, unknown
from dopslam.pipeline import problem as build
from dopslam.simulate.world import noise_of, section_v, simulate
from dopslam.slam.filter import run

SPREAD, WALK = 20.0, 0.05  # m/s


@pytest.fixture(scope="module")
def drifting():
    """Section V of paper A, with a clock that drifts."""
    world = section_v(steps=30)
    motion = DriftingClock(world.motion, SPREAD, WALK)
    mean, covariance = motion.prior(world.prior_mean, world.prior_covariance)
    return replace(world, motion=motion, prior_mean=mean, prior_covariance=covariance)


def test_jacobians_and_noise(drifting):
    turning = unknown(0.5, drifting.motion.motion.process_noise, 22.0, 0.3, 2.0, 0.03, 0.1, 0.002)
    for motion in (drifting.motion, DriftingClock(turning, SPREAD, WALK)):
        n = motion.dimension
        states = np.random.default_rng(1).normal(size=(4, n)) + 3.0
        assert motion.names[-1] == "clock_drift" and motion.process_noise.shape == (n, n)
        np.testing.assert_allclose(motion.jacobian(states), differences(motion.step, states), atol=1e-6)
        inner = motion.motion.pose_jacobian(states[:, :-1])
        np.testing.assert_array_equal(motion.pose_jacobian(states), np.pad(inner, ((0, 0), (0, 0), (0, 1))))
        # Two steps are one of twice the time: exactly in the mean of the clock, and in the noise of clock and drift.
        twice, step = motion.paced(2.0), motion.jacobian(states[0])
        both = motion.process_noise + step @ motion.process_noise @ step.T
        clock = np.ix_([3, n - 1], [3, n - 1])
        np.testing.assert_allclose(twice.process_noise[clock], both[clock], rtol=1e-12)
        np.testing.assert_allclose(twice.step(states)[:, [3, -1]], motion.step(motion.step(states))[:, [3, -1]])


@pytest.mark.mc  # what is compiled is compiled once more for its states
def test_the_filter_follows_a_drift_that_a_walk_does_not_explain(drifting):
    told = build.told(drifting)
    walking = replace(told, motion=drifting.motion.motion, mean=told.mean[:4], covariance=told.covariance[:4, :4])
    error, squared, naive = [], [], []
    for seed in range(4):
        states, scans = simulate(drifting, seed, 0)
        history, _ = run(told, scans, FILTERS["joint"]())
        off = history.mean - states
        error.append(off[-1, 4] / np.sqrt(history.covariance[-1, 4, 4]))
        whole = np.linalg.solve(history.covariance, off[..., None])[..., 0]
        squared.append(np.mean(np.sum(off * whole, axis=1)))
        assert np.abs(off[5:, 3]).max() < 2.0
        alone, _ = run(walking, scans, FILTERS["joint"]())
        naive.append(np.sqrt(np.mean((alone.mean[5:, 3] - states[5:, 3]) ** 2)))
    assert np.abs(error).max() < 4 and 2.5 < np.mean(squared) < 9  # five states
    assert np.max(naive) > 0.5


def test_bound_of_the_drift(drifting):
    states, scans = simulate(drifting, 0, 0)
    mask, noise = detection_mask(scans.label, scans.offsets, len(drifting.kind)), noise_of(drifting, states)[0]

    def bound(motion, states, covariance):
        start = np.append(drifting.prior_mean[:4], states[0, 4:])
        args = drifting.position, drifting.kind, noise, mask, drifting.bs
        return pcrb(states, start, covariance, motion, *args).squared(motion.names)

    told = bound(drifting.motion, states, drifting.prior_covariance)
    known = bound(drifting.motion.motion, states[:, :4], drifting.prior_covariance[:4, :4])
    assert np.all(told["clock"] >= known["clock"] * (1 - 1e-9))
    assert told["clock_drift"][0] < SPREAD**2 and told["clock_drift"][-1] < 0.1 * told["clock_drift"][0]


def test_filters_that_carry_turns_only_say_so():
    scenario = load("ring_road", ["filter.clock=drift", "source.kind=model", "track.steps=5"])
    assert build.motion(scenario).names[-1] == "clock_drift"
    problem = build.problem(scenario)
    _, scans = simulate(build.situation(scenario), 1, 0)
    with pytest.raises(FilterError, match="filter.clock"):
        run(problem, scans, FILTERS["bp"]())
