"""The fixed-lag smoother against batch least squares; elimination against the inverse."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from dopslam.errors import FilterError
from dopslam.evaluate.bounds import situation_bound
from dopslam.evaluate.metrics import nees, state_errors
from dopslam.models.measurement import BS, VA, measure, residual
from dopslam.models.motion import propagate
from dopslam.simulate.world import FixedNoise, simulate
from dopslam.slam.pmb import ek_pmb, smoother
from dopslam.slam.pmb.smoother import SmootherParameters
from dopslam.slam.pmb.window import eliminate

pytestmark = pytest.mark.mc


def test_elimination_is_marginalization():
    rng = np.random.default_rng(1)
    root = rng.normal(size=(9, 9))
    information, vector = root @ root.T, rng.normal(size=9)
    drop, keep = np.array([1, 5, 6]), np.array([0, 2, 3, 4, 7, 8])
    left, right, valid = eliminate(information, vector, keep, drop)
    covariance, mean = np.linalg.inv(information), np.linalg.solve(information, vector)
    assert valid
    np.testing.assert_allclose(np.linalg.inv(left), covariance[np.ix_(keep, keep)], rtol=1e-6)
    np.testing.assert_allclose(np.linalg.solve(left, right), mean[keep], rtol=1e-6)
    information[:, 5] = information[5] = 0.0
    assert eliminate(information, np.where(np.arange(9) == 5, 0, vector), keep, drop)[2]


def test_a_long_lag_is_the_batch_estimate(world):
    """Sure associations, VAs and BS only: scipy's least squares over all states and landmarks."""
    sure = replace(
        world,
        kind=world.kind[:5],
        position=world.position[:5],
        noise=FixedNoise(world.noise.std, 1.0, None),
        clutter_count=0.0,
        steps=12,
    )
    _, scans = simulate(sure, 2, 0)
    filter_parameters = ek_pmb.FilterParameters(intensity=(1e-7, 1e-25), robust=np.inf)
    arguments = (
        scans,
        (sure.prior_mean, sure.prior_covariance),
        sure.motion,
        sure.bs,
        filter_parameters,
        0.0,
    )
    history, _ = smoother.run(*arguments, SmootherParameters(lag=20, iterations=20))
    step = np.repeat(np.arange(12), np.diff(scans.offsets))
    prior_root = 1 / np.sqrt(np.diag(sure.prior_covariance))
    noise_root = 1 / np.sqrt(np.diag(sure.motion.process_noise))

    def residuals(x):
        states, landmarks = x[:52].reshape(13, 4), np.vstack([sure.bs, x[52:].reshape(4, 3)])
        predicted = measure(
            states[step + 1], landmarks[scans.label], np.array([BS] + 4 * [VA])[scans.label], sure.bs,
            speed=sure.motion.speed,
        )  # fmt: skip
        return np.concatenate(
            [
                (states[0] - sure.prior_mean) * prior_root,
                ((states[1:] - propagate(states[:-1], sure.motion)) * noise_root).ravel(),
                (residual(scans.z, predicted) / sure.noise.std).ravel(),
            ]
        )

    start = [sure.prior_mean]
    for _ in range(12):
        start.append(propagate(start[-1], sure.motion))
    x0 = np.concatenate([np.ravel(start), sure.position[1:].ravel()])
    batch = least_squares(residuals, x0, xtol=1e-12, ftol=1e-12, gtol=1e-12, x_scale="jac")
    np.testing.assert_allclose(history.mean[-1], batch.x[48:52], atol=2e-3)
    covariance = np.linalg.inv(batch.jac.T @ batch.jac)[48:52, 48:52]
    np.testing.assert_allclose(history.covariance[-1], covariance, rtol=2e-2, atol=1e-7)


def test_smoother_beats_the_filter_and_stays_consistent(world):
    """Forty runs: NEES within its 99.9 % band around 4 (spread over runs measured), error not above."""
    values, errors = [], {"filter": [], "smoother": []}
    for run in range(40):
        states, scans = simulate(world, 11, run)
        arguments = (scans, (world.prior_mean, world.prior_covariance), world.motion, world.bs)
        for name, module in (("filter", ek_pmb), ("smoother", smoother)):
            history, _ = module.run(*arguments)
            error = state_errors(history.mean, states)
            errors[name].append((error[:, :2] ** 2).sum(1).mean())
        values.append(nees(error, history.covariance).mean())
    spread = np.std(values) / np.sqrt(len(values))
    assert abs(np.mean(values) - 4) < 3.3 * spread + 0.3
    assert np.mean(errors["smoother"]) < 1.02 * np.mean(errors["filter"])


def test_what_is_told_later_is_at_the_bound_of_that_time(world):
    """Thirty runs: above the fixed-lag bound, far below the filter's error, consistent; the last step is the smoother's."""
    lag, values, late, now = 5, [], [], []
    bound = situation_bound(world, smoothed=True, lag=lag).peb
    for run in range(30):
        states, scans = simulate(world, 12, run)
        arguments = (scans, (world.prior_mean, world.prior_covariance), world.motion, world.bs)
        own, _ = smoother.run(*arguments)
        history, _ = smoother.run(*arguments, smoothing=SmootherParameters(lag=lag, delayed=True))
        np.testing.assert_allclose(history.mean[-1], own.mean[-1])
        np.testing.assert_allclose(history.covariance[-1], own.covariance[-1])
        assert history.map_offsets[1] == own.map_offsets[lag + 1] - own.map_offsets[lag]
        error = state_errors(history.mean, states)
        late.append((error[:, :2] ** 2).sum(axis=1))
        now.append((state_errors(own.mean, states)[:, :2] ** 2).sum(axis=1))
        values.append(nees(error, history.covariance).mean())
    assert abs(np.mean(values) - 4) < 3.3 * np.std(values) / np.sqrt(len(values)) + 0.3
    ratio = np.sqrt(np.mean(late) / np.mean(bound**2))
    assert 0.9 < ratio < 1.25
    assert np.mean(np.array(late)[:, :-1]) < 0.8 * np.mean(np.array(now)[:, :-1])


def test_impossible_parameters_are_refused():
    with pytest.raises(FilterError, match="lag"):
        SmootherParameters(lag=0)
