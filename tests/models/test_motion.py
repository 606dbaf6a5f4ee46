"""Coordinated turn: integration oracle, straight-line limit, Jacobian, compiled twin."""

import numpy as np
import pytest

from dopslam.errors import ConfigError
from dopslam.models import kernels
from dopslam.models.motion import CoordinatedTurn, Motion, propagate, transition_jacobian, velocity


@pytest.mark.parametrize("rate", [0.0, 1e-9, 1e-3, np.pi / 10, -1.3])
def test_follows_the_integrated_turn(rate):
    motion = CoordinatedTurn(0.5, np.eye(4), 22.22, rate)
    state = np.array([70.0, -3.0, 1.1, 300.0])
    t = (np.arange(20000) + 0.5) / 20000 * motion.interval
    heading = state[2] + rate * t
    step = [np.cos(heading).mean(), np.sin(heading).mean()]
    moved = motion.speed * motion.interval * np.array(step)
    expected = state + np.array([*moved, rate * motion.interval, 0.0])
    np.testing.assert_allclose(propagate(state, motion), expected, atol=1e-7)


@pytest.mark.parametrize("n", [4, 6])
@pytest.mark.parametrize("rate", [0.0, 0.03, np.pi / 10, -2.0])
def test_jacobian_and_twin(n, rate):
    rng = np.random.default_rng(8)
    motion = CoordinatedTurn(0.5, np.eye(n), 22.22, rate)
    state = np.concatenate([rng.normal(size=4), [22.22, rate]])[:n]
    jacobian = transition_jacobian(state, motion)
    h = 1e-6
    numeric = np.stack(
        [(propagate(state + h * e, motion) - propagate(state - h * e, motion)) / (2 * h) for e in np.eye(n)],
        axis=-1,
    )
    np.testing.assert_allclose(jacobian, numeric, atol=2e-8)
    twin = np.empty((n, n))
    np.testing.assert_allclose(
        kernels.propagate_state(state, motion.interval, motion.speed, rate, twin),
        propagate(state, motion),
        rtol=1e-13,
    )
    np.testing.assert_allclose(twin, jacobian, rtol=1e-9, atol=1e-12)


def test_velocity_has_the_speed_of_the_state():
    motion = CoordinatedTurn(0.5, np.eye(6))
    np.testing.assert_allclose(velocity(np.array([0, 0, np.pi / 2, 0, 3.0, 0.1]), motion), [0, 3, 0], atol=1e-12)


def test_wrong_noise_is_refused():
    with pytest.raises(ValueError, match="process_noise"):
        CoordinatedTurn(0.5, np.eye(5))


@pytest.mark.parametrize("method", ["step", "velocity"])
def test_a_model_of_ones_own_that_lacks_something_is_told_what(method):
    with pytest.raises(ConfigError, match=rf"Half has no {method}\(state\)"):
        getattr(type("Half", (Motion,), {})(), method)(np.zeros(4))
