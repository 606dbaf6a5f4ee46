"""Scans at irregular times: every filter and the bound step by the time stamps, or are refused by name."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.errors import FilterError
from dopslam.evaluate import metrics
from dopslam.evaluate.bounds import pcrb
from dopslam.filters import FILTERS
from dopslam.models.motion import paced, propagate, transition_jacobian
from dopslam.pipeline import problem as build
from dopslam.simulate.world import draw_scans, section_v
from dopslam.slam.filter import Capabilities, run
from dopslam.slam.snapshot.start import start

PACE = np.array([1, 0.4, 0.4, 3.0, 1, 0.2, 2.5, 1, 1, 0.7, 0.3, 4.0, 1, 0.5, 2.0, 1, 1, 0.6, 1.4, 1])


@pytest.fixture(scope="module")
def drive():
    """Twenty scans of the ring road at irregular times."""
    situation, rng = section_v(steps=len(PACE)), np.random.default_rng(7)
    state, states = situation.prior_mean + rng.normal(size=4) * np.sqrt(np.diag(situation.prior_covariance)), []
    for pace in PACE:
        step = paced(situation.motion, pace)
        state = propagate(state, step) + rng.normal(size=4) * np.sqrt(np.diag(step.process_noise))
        states.append(state)
    scans = draw_scans(situation, np.array(states), rng, rng)
    return situation, np.array(states), replace(scans, interval=PACE * situation.motion.interval)


def off(history, states):
    return np.linalg.norm(history.mean[:, :2] - states[:, :2], axis=1)


@pytest.mark.parametrize("name", ["joint", "marginal", "smoother", "mixture", "bp", "batch", "interval"])
def test_filters_step_by_the_time_stamps(drive, name):
    situation, states, scans = drive
    problem, chosen = build.told(situation), FILTERS[name]()
    if name == "bp":
        chosen = replace(chosen, particles=300)
    found, _ = run(problem, scans, chosen)
    assert off(found, states).max() < 2.5
    if name == "joint":  # told nothing of them it is lost at the first long one
        blind, _ = run(problem, replace(scans, interval=None), chosen)
        assert off(blind, states).max() > 10


@pytest.mark.parametrize("name", ["joint", "smoother"])
def test_a_regular_drive_stays_the_same_to_the_last_bit(drive, name):
    situation, _, scans = drive
    problem, chosen = build.told(situation), FILTERS[name]()
    even = replace(scans, interval=np.full(scans.steps, situation.motion.interval))
    alike, _ = run(problem, even, chosen)
    plain, _ = run(problem, replace(scans, interval=None), chosen)
    assert np.array_equal(alike.mean, plain.mean) and np.array_equal(alike.covariance, plain.covariance)


def test_one_scan_at_a_time_is_the_same(drive):
    situation, _, scans = drive
    problem, chosen = build.told(situation), FILTERS["joint"]()
    whole, _ = run(problem, scans, chosen)
    state, rng = chosen.init(problem, np.random.default_rng(0)), np.random.default_rng(0)
    for k in range(6):
        state, info = chosen.step(state, scans.take([k]), rng)
        assert np.allclose(info.estimate.mean, whole.mean[k], atol=1e-9)


def test_without_detections_the_covariance_is_that_of_dead_reckoning(drive):
    situation, _, scans = drive
    none = replace(scans.take([0]).take(slice(0, 0)), offsets=np.zeros(len(PACE) + 1, int), interval=scans.interval)
    history, _ = run(build.told(situation), none, FILTERS["joint"]())
    mean, covariance = situation.prior_mean, situation.prior_covariance
    for k, pace in enumerate(PACE):
        step = paced(situation.motion, pace)
        jacobian = transition_jacobian(mean, step)
        mean, covariance = propagate(mean, step), jacobian @ covariance @ jacobian.T + step.process_noise
        assert np.allclose(history.mean[k], mean) and np.allclose(history.covariance[k], covariance)


def test_the_bound_is_that_of_the_same_steps_under_another_period(drive):
    situation, states, _ = drive
    arguments = (
        situation.position,
        situation.kind,
        np.diag(situation.noise.std**2),
        np.ones((len(states), 9)),
        situation.bs,
    )
    prior = situation.prior_mean, situation.prior_covariance
    double = pcrb(states, *prior, situation.motion, *arguments, pace=np.full(len(states), 2.0))
    assert np.allclose(double.covariance, pcrb(states, *prior, paced(situation.motion, 2.0), *arguments).covariance)
    irregular = pcrb(states, *prior, situation.motion, *arguments, pace=PACE)
    assert not np.allclose(irregular.peb, pcrb(states, *prior, situation.motion, *arguments).peb)


def test_a_filter_that_knows_one_period_only_is_refused_by_name(drive):
    class Mine:
        capabilities = Capabilities()

        def init(self, problem, rng): ...

        def step(self, state, scan, rng): ...

    situation, _, scans = drive
    with pytest.raises(
        FilterError, match=r"Mine steps by the period .* 0.5 s, but the scans are 0.1 to 2 s apart; choose"
    ):
        run(build.told(situation), scans, Mine())


def test_the_start_is_found_from_irregular_scans(drive):
    situation, states, scans = drive
    told = replace(build.told(situation), snapshot=True)
    found = start(scans, told.motion, told.anchor, told.height)
    assert np.linalg.norm(found.chain.mean[:, :2] - states[:, :2], axis=1).max() < 8.0
    error = metrics.state_errors(found.mean[None], situation.prior_mean[None])[0]
    assert error @ np.linalg.solve(found.covariance + situation.prior_covariance, error) < 30.0
    for name in ("joint", "batch"):
        history, _ = run(told, scans, FILTERS[name]())
        assert off(history, states)[8:].max() < 2.5
