"""Modes of successive scans joined: by enumeration, over gaps, and the smoother against the dense inverse."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from dopslam.errors import FilterError
from dopslam.models.motion import CoordinatedTurn, propagate
from dopslam.models.unmeasured import UNSEEN
from dopslam.pipeline.problem import told
from dopslam.simulate.world import section_v, simulate
from dopslam.slam.filter import run
from dopslam.slam.pmb.filters import Joint
from dopslam.slam.snapshot.chain import _log_normal, chain
from dopslam.slam.snapshot.locate import Modes, no_modes
from dopslam.slam.snapshot.start import start, walk_of

MOTION = CoordinatedTurn(1.0, np.diag([0.1, 0.1, 0.02, 0.1]) ** 2, 1.0, 0.1)
WALK = walk_of(MOTION, np.zeros(4), np.eye(4))


def track(steps, rng):
    states = [np.array([1.0, 2.0, 0.3, 10.0])]
    for _ in range(steps - 1):
        states.append(propagate(states[-1], MOTION) + rng.standard_normal(4) * [0.1, 0.1, 0.02, 0.1])
    return np.array(states)


def modes_at(states, rng, evidence, std=0.2):
    pose = states + std * rng.standard_normal(states.shape) * [1, 1, 0.1, 1]
    covariance = np.tile(np.diag([std, std, 0.1 * std, std]) ** 2, (len(pose), 1, 1))
    return Modes(pose, covariance, np.asarray(evidence, float), np.zeros((len(pose), 0)), np.zeros((len(pose), 0)))


def test_viterbi_against_enumeration():
    rng = np.random.default_rng(4)
    found = [modes_at(rng.normal(size=(3, 4)), rng, 3 * rng.normal(size=3)) for _ in range(4)]
    passing = np.full(4, -2.0)
    best = -np.inf
    for path in itertools.product([-1, 0, 1, 2], repeat=4):
        used = [k for k in range(4) if path[k] >= 0]
        value = sum(found[k].evidence[path[k]] if path[k] >= 0 else passing[k] for k in range(4))
        for early, late in itertools.pairwise(used):
            mean, covariance = found[early].pose[[path[early]]], found[early].covariance[[path[early]]]
            for _ in range(late - early):
                mean, jacobian = WALK.step(mean)
                covariance = jacobian @ covariance @ np.swapaxes(jacobian, 1, 2) + WALK.noise
            other = found[late].pose[[path[late]]]
            value += _log_normal(other - mean, covariance + found[late].covariance[[path[late]]])[0]
        if used and value > best:
            best, winner = value, path
    joined = chain(found, passing, [WALK] * len(found))
    assert joined.evidence == pytest.approx(best)
    np.testing.assert_array_equal(joined.chosen, winner)


def test_the_track_wins_over_better_looking_strangers_and_gaps():
    rng = np.random.default_rng(5)
    states = track(12, rng)
    found = []
    for k, state in enumerate(states):
        stranger = rng.uniform(-30, 30, 4)
        found.append(modes_at(np.array([stranger, state]), rng, [4.0, 0.0]) if k not in (3, 4) else no_modes(2))
    found[7] = modes_at(rng.uniform(-30, 30, (1, 4)), rng, [4.0])
    joined = chain(found, np.full(12, -3.0), [WALK] * 12)
    np.testing.assert_array_equal(joined.chosen, [1, 1, 1, -1, -1, 1, 1, -1, 1, 1, 1, 1])
    error = joined.mean - states
    assert np.abs(error).max() < 0.8
    assert joined.margin[0] > 5


def test_smoothing_is_the_dense_least_squares():
    """Straight drive with the heading all but known: linear, so the chain equals one dense Gaussian."""
    motion = CoordinatedTurn(1.0, np.diag([0.1, 0.1, 1e-6, 0.1]) ** 2)
    walk = walk_of(motion, np.zeros(4), np.eye(4))
    rng = np.random.default_rng(6)
    found = [modes_at(rng.normal(size=(1, 4)) * 0.1, rng, [0.0]) for _ in range(5)]
    joined = chain(found, np.full(5, -100.0), [walk] * 5)
    information, vector = np.zeros((20, 20)), np.zeros(20)
    for k in range(5):
        at = slice(4 * k, 4 * k + 4)
        weight = np.linalg.inv(found[k].covariance[0])
        information[at, at] += weight
        vector[at] += weight @ found[k].pose[0]
        if k:
            pair = slice(4 * k - 4, 4 * k + 4)
            tie = np.hstack([-np.eye(4), np.eye(4)])
            information[pair, pair] += tie.T @ np.linalg.inv(motion.process_noise) @ tie
    covariance = np.linalg.inv(information)
    np.testing.assert_allclose(joined.mean.ravel(), covariance @ vector, atol=1e-7)
    for k in range(5):
        np.testing.assert_allclose(
            joined.covariance[k], covariance[4 * k : 4 * k + 4, 4 * k : 4 * k + 4], rtol=1e-5, atol=1e-10
        )


def test_no_mode_anywhere_is_one_clear_sentence():
    with pytest.raises(FilterError, match="no scan has enough paths"):
        chain([no_modes(1), no_modes(0)], np.zeros(2), [WALK] * 2)


def test_paper_a_is_started_from_nothing():
    """Section V with the prior withheld: the start found is consistent with where the run began."""
    world = section_v(0.1, steps=6)
    states, scans = simulate(world, 31, 0)
    found = start(scans, world.motion, world.bs, world.height)
    error = found.chain.mean - states
    error[:, 2] = (error[:, 2] + np.pi) % (2 * np.pi) - np.pi
    square = np.einsum("ki,kij,kj->k", error, np.linalg.inv(found.chain.covariance), error)
    assert square.mean() < 20
    assert found.chain.chosen[found.best] >= 0


def without(scans, column):
    """The same without a quantity."""
    covariance = scans.covariance.copy()
    covariance[:, column, :] = covariance[:, :, column] = 0.0
    covariance[:, column, column] = 4 * UNSEEN[column]
    return replace(scans, covariance=covariance)


@pytest.mark.parametrize(("column", "end"), [(1, "arrival"), (3, "departure")])
def test_a_start_from_the_scans_needs_the_azimuths_of_both_ends(column, end):
    world = section_v(steps=4)
    _, scans = simulate(world, 1, 0)
    with pytest.raises(FilterError, match=f"no azimuth of {end} was measured.*track.start"):
        start(without(scans, column), world.motion, world.bs, world.height)


def test_without_departures_a_turned_start_gives_the_turned_track():
    """Why that is so: from delays and arrivals alone every turn about the base station is as likely."""
    world, turn = section_v(steps=12), 0.7
    _, scans = simulate(world, 1, 0)
    scans, about = without(scans, 3), np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    mean = np.array(world.prior_mean)
    turned = np.concatenate([world.bs[:2] + about @ (mean[:2] - world.bs[:2]), [mean[2] + turn, mean[3]]])
    problem = replace(told(world), covariance=np.diag([0.3, 0.3, 0.01, 0.3]) ** 2)
    one, other = (run(replace(problem, mean=m), scans, Joint())[0].mean[:, :2] - world.bs[:2] for m in (mean, turned))
    np.testing.assert_allclose(other, one @ about.T, atol=0.05)
