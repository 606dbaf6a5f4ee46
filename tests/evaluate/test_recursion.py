"""The one recursion behind every bound: singular priors and noises, unseen directions, the whole run."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.errors import FilterError
from dopslam.evaluate.bounds import pcrb, row_information, situation_bound
from dopslam.evaluate.recursion import LinearizedRun, filtering, inverse, smoothing
from dopslam.simulate.world import section_v, unknown_motion


def drawn(rng, *, steps=7, n=3, landmarks=2, d=2, rank_prior=None, rank_noise=None):
    """A random linear Gaussian run: F, Q, and rows A, B with unit R; and the stacked rows of every step."""

    def spread(rank):
        root = rng.normal(size=(n, n if rank is None else rank))
        return root @ root.T

    rows = rng.normal(size=(steps, landmarks, 4, n + d))
    seen = rng.random((steps, landmarks)) < 0.7
    seen[0] = True
    rows *= seen[..., None, None]
    a, b = rows[..., :n], rows[..., n:]
    run = LinearizedRun(
        prior=spread(rank_prior),
        transition=rng.normal(size=(steps, n, n)),
        noise=np.array([spread(rank_noise) for _ in range(steps)]),
        state=np.einsum("klia,klib->kab", a, a),
        cross=np.einsum("klia,klib->klab", a, b),
        landmark=np.einsum("klia,klib->klab", b, b),
        seen=seen,
    )
    return run, a, b


def kalman(run, a, b, wide=1e5):
    """Filtered and Rauch-Tung-Striebel smoothed covariances over [s; landmarks] with a wide prior of the landmarks."""
    steps, count, m, n = a.shape
    d = b.shape[-1]
    size = n + d * count
    p = np.zeros((size, size))
    p[:n, :n] = run.prior
    p[n:, n:] = wide**2 * np.eye(size - n)
    filtered, predicted, moves = [], [], []
    for k in range(steps):
        f, q = np.eye(size), np.zeros((size, size))
        f[:n, :n], q[:n, :n] = run.transition[k], run.noise[k]
        p = f @ p @ f.T + q
        predicted.append(p)
        moves.append(f)
        h = np.zeros((count, m, size))
        h[:, :, :n] = a[k]
        for i in range(count):
            h[i, :, n + d * i : n + d * i + d] = b[k, i]
        for row in h.reshape(-1, size):
            gain = p @ row / (row @ p @ row + 1)
            rest = np.eye(size) - np.outer(gain, row)
            p = rest @ p @ rest.T + np.outer(gain, gain)
        filtered.append(p)
    smoothed = [filtered[-1]]
    for k in reversed(range(steps - 1)):
        gain = filtered[k] @ moves[k + 1].T @ np.linalg.pinv(predicted[k + 1], rcond=1e-14, hermitian=True)
        smoothed.insert(0, filtered[k] + gain @ (smoothed[0] - predicted[k + 1]) @ gain.T)
    return np.array(filtered), np.array(smoothed)


@pytest.mark.parametrize(
    ("rank_prior", "rank_noise"), [(None, None), (2, None), (None, 1), (1, 1), (0, 1), (0, 0), (2, 0)]
)
def test_filtering_is_the_kalman_covariance_also_where_states_are_known(rank_prior, rank_noise):
    for seed in range(5):
        run, a, b = drawn(np.random.default_rng(seed), rank_prior=rank_prior, rank_noise=rank_noise)
        expected, _ = kalman(run, a, b)
        state, landmark = filtering(run)
        scale = np.abs(expected[:, :3, :3]).max() + 1e-9
        np.testing.assert_allclose(state, expected[:, :3, :3], atol=1e-6 * scale)
        np.testing.assert_allclose(landmark[-1, 0], expected[-1, 3:5, 3:5], rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("rank_noise", [None, 2])
def test_smoothing_is_rauch_tung_striebel(rank_noise):
    for seed in range(5):
        run, a, b = drawn(np.random.default_rng(seed), landmarks=1, rank_noise=rank_noise)
        _, expected = kalman(run, a, b, wide=1e3)
        state, _ = smoothing(run)
        np.testing.assert_allclose(state, expected[:, :3, :3], rtol=1e-3, atol=1e-3 * np.abs(expected[:, :3, :3]).max())


def test_smoothing_is_the_inverse_of_the_information_of_the_whole_run():
    """Block tridiagonal in the states, bordered by the landmarks: inverted densely."""
    for seed in range(5):
        run, _, _ = drawn(np.random.default_rng(seed), steps=6, landmarks=3)
        steps, count, n, d = run.cross.shape
        size = n * (steps + 1) + d * count
        total = np.zeros((size, size))
        total[:n, :n] = np.linalg.inv(run.prior)
        for k in range(steps):
            difference = np.zeros((n, size))
            difference[:, n * k : n * k + n] = -run.transition[k]
            difference[:, n * k + n : n * k + 2 * n] = np.eye(n)
            total += difference.T @ np.linalg.solve(run.noise[k], difference)
            own = np.concatenate([np.arange(n * (k + 1), n * (k + 2)), np.arange(n * (steps + 1), size)])
            total[np.ix_(own, own)] += run.information(k)
        covariance = np.linalg.inv(total)
        state, landmark = smoothing(run)
        for k in range(steps):
            rows = slice(n * (k + 1), n * (k + 2))
            np.testing.assert_allclose(state[k], covariance[rows, rows], rtol=1e-7, atol=1e-9)
            for i in range(count):
                rows = slice(n * (steps + 1) + d * i, n * (steps + 1) + d * i + d)
                np.testing.assert_allclose(landmark[k, i], covariance[rows, rows], rtol=1e-7, atol=1e-9)


def test_the_whole_run_never_knows_less_and_ends_where_the_filter_ends():
    for world in (section_v(0.1), unknown_motion(section_v(0.1))):
        now, whole = situation_bound(world), situation_bound(world, smoothed=True)
        assert (whole.peb <= now.peb * (1 + 1e-9)).all() and (whole.heb <= now.heb * (1 + 1e-9)).all()
        assert whole.peb[:-1].mean() < 0.8 * now.peb[:-1].mean()
        np.testing.assert_allclose(whole.covariance[-1], now.covariance[-1], rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(whole.leb[0, 1:], now.leb[-1, 1:], rtol=1e-5)


def test_a_lag_is_the_whole_of_a_run_that_ends_so_many_steps_later():
    world, lag = section_v(0.1, steps=9), 3
    late = situation_bound(world, smoothed=True, lag=lag)
    for k in range(world.steps):
        ended = situation_bound(replace(world, steps=min(k + lag + 1, world.steps)), smoothed=True)
        np.testing.assert_allclose(late.covariance[k], ended.covariance[k], rtol=1e-8)
        np.testing.assert_allclose(late.landmark[k], ended.landmark[k], rtol=1e-6)
    assert situation_bound(world, smoothed=True, lag=99).peb == pytest.approx(situation_bound(world, smoothed=True).peb)


@pytest.mark.parametrize("states", [(3,), (2,), (0, 1), (2, 3), (0, 1, 2, 3)])
@pytest.mark.parametrize("part", ["prior", "noise", "both"])
@pytest.mark.parametrize("smoothed", [False, True])
def test_a_state_known_exactly_is_the_limit_of_one_known_ever_better(states, part, smoothed):
    def world(deviation):
        base = section_v(0.1, steps=8)
        prior, noise = np.array(base.prior_covariance), np.array(base.motion.process_noise)
        for i in states:
            if part != "noise":
                prior[i, i] = deviation**2
            if part != "prior":
                noise[i, i] = deviation**2
        return replace(base, prior_covariance=prior, motion=replace(base.motion, process_noise=noise))

    exact = situation_bound(world(0.0), smoothed=smoothed)
    nearly = situation_bound(world(1e-6), smoothed=smoothed)
    np.testing.assert_allclose(exact.peb, nearly.peb, rtol=1e-4, atol=3e-4)
    np.testing.assert_allclose(exact.ceb, nearly.ceb, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(exact.leb, nearly.leb, rtol=1e-4, atol=1e-5)
    if part == "both" and 3 in states:
        assert (exact.ceb == 0).all()


def test_no_detection_at_all_is_prediction_alone():
    world = section_v(0.1, steps=5)
    for smoothed in (False, True):
        bound = situation_bound(world, detected=np.zeros((5, 9)), smoothed=smoothed)
        assert np.isnan(bound.leb).all() and np.isfinite(bound.peb).all() and (np.diff(bound.peb) > 0).all()


def test_rows_that_were_not_measured_carry_no_information():
    """An infinite variance is a missing row, whatever stands beside it."""
    r = np.diag([1.0, 2.0, np.inf, 4.0, 5.0, np.inf])
    r[0, 2] = r[2, 0] = 0.3
    expected = np.diag([1.0, 0.5, 0.0, 0.25, 0.2, 0.0])
    np.testing.assert_allclose(row_information(r), expected)
    np.testing.assert_allclose(row_information(np.full((6, 6), np.nan), 0.0), 0.0)
    np.testing.assert_allclose(row_information(np.eye(6) * 1e-18), np.eye(6) * 1e18)


@pytest.mark.parametrize("wrong", [np.zeros((6, 6)), np.ones((6, 6)), np.full((6, 6), np.nan)])
def test_a_detection_with_an_impossible_covariance_is_named(wrong):
    world = section_v(0.1, steps=3)
    covariance = np.broadcast_to(np.eye(6), (3, 9, 6, 6)).copy()
    covariance[1, 4] = wrong
    arguments = (np.tile(world.prior_mean, (3, 1)), world.prior_mean, world.prior_covariance, world.motion)
    with pytest.raises(FilterError, match=r"\[1, 4\]"):
        pcrb(*arguments, world.position, world.kind, covariance, np.ones((3, 9)), world.bs)


def test_a_landmark_seen_from_too_few_rows_has_no_bound_and_harms_nobody():
    """Delays alone at one step: one row for three coordinates of a landmark."""
    world = section_v(0.1, steps=1)
    covariance = np.broadcast_to(np.diag(world.noise.std**2), (1, 9, 6, 6)).copy()
    covariance[0, 5] = np.diag([0.01, *[np.inf] * 5])
    detected = np.zeros((1, 9))
    detected[0, [0, 1]] = 1
    states = world.prior_mean[None]
    arguments = (states, world.prior_mean, world.prior_covariance, world.motion, world.position, world.kind, covariance)
    without = pcrb(*arguments, detected, world.bs)
    detected[0, 5] = 1
    bound = pcrb(*arguments, detected, world.bs)
    assert bound.leb[0, 5] == np.inf
    np.testing.assert_allclose(bound.covariance, without.covariance, rtol=1e-9)
    np.testing.assert_allclose(bound.leb[0, 1], without.leb[0, 1], rtol=1e-9)


def test_inverse_of_what_is_seen_in_part():
    direction = np.array([1.0, 1.0, 0.0, 0.0]) / np.sqrt(2)
    information = np.outer(direction, direction) + np.diag([0.0, 0.0, 4.0, 0.0])
    covariance, free = inverse(information)
    assert free.tolist() == [True, True, False, True]
    assert covariance[2, 2] == pytest.approx(0.25)


def test_nothing_is_computed_from_numbers_that_are_none():
    run, _, _ = drawn(np.random.default_rng(0))
    with pytest.raises(FilterError, match="noise"):
        replace(run, noise=np.full_like(run.noise, np.nan))
    with pytest.raises(FilterError, match="negative"):
        replace(run, prior=-np.eye(3))
    with pytest.raises(FilterError, match="agree"):
        replace(run, prior=np.eye(4))
