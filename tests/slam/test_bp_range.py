"""Distance-only BP-SLAM: the kernels against plain NumPy, exact reductions, determinism, and one run through the office."""

import os
from dataclasses import replace

import numpy as np
import pytest

from dopslam.errors import FilterError
from dopslam.evaluate.belief import distance_bound as bound
from dopslam.slam.belief.distance_only import kernels
from dopslam.slam.belief.distance_only.filter import RangeMap, RangeOnly, RangeParameters, RangeState
from dopslam.slam.belief.distance_only.scene import office
from dopslam.studies import distance_only as range_study


def mixture(rng, particles=700):
    """Two features of one and three components, float32 means about their places."""
    first = np.array([0, 1, 4])
    places = np.array([[2.0, 1.0], [5.0, 4.0], [-3.0, 2.0], [1.0, -6.0]])
    mean = np.float32(places[:, :, None] + 0.1 * rng.standard_normal((4, 2, particles)))
    covariance = np.array([[0.02, 0.003, 0.01], [0.5, 0.1, 0.4], [0.05, 0.0, 0.9], [0.1, -0.05, 0.1]])
    agent = np.float32(0.2 * rng.standard_normal((2, particles)))
    share = np.float32(rng.random((4, particles)) + 0.2)
    share[0], share[1:] = 1, share[1:] / share[1:].sum(axis=0)
    return agent, first, share, mean, covariance


def test_condition_is_the_kalman_update_averaged_over_associations():
    rng = np.random.default_rng(1)
    agent, first, weight, mean, covariance = mixture(rng)
    particles = agent.shape[1]
    z, coefficient = np.array([2.3, 6.2, 3.4]), np.array([[2.0, 0.0, 0.5], [0.0, 1.5, 3.0]])
    missed, variance, prior = 0.05, 0.0144, np.full(particles, 1 / particles)
    before, old, lam = mean.astype(float), weight.astype(float), np.empty((2, particles), np.float32)
    sums = np.zeros((4, 4))
    for a, b in ((0, 300), (300, particles)):
        kernels.condition(
            agent, first, weight, mean, covariance, 0, z, coefficient, np.float32(missed), np.float32(variance),
            np.float32(prior), a, b, lam, sums,
        )  # fmt: skip
    for c, k in enumerate([0, 1, 1, 1]):
        p = np.array([[covariance[c, 0], covariance[c, 1]], [covariance[c, 1], covariance[c, 2]]])
        offset = before[c] - agent
        d = np.linalg.norm(offset, axis=0)
        e = offset / d
        s = variance + np.einsum("ai,ab,bi->i", e, p, e)
        likelihood = coefficient[k][:, None] * np.exp(-0.5 * (z[:, None] - d) ** 2 / s) / np.sqrt(2 * np.pi * s)
        total = missed + likelihood.sum(axis=0)
        share = likelihood / total
        gain = p @ e / s
        shift = (share * (z[:, None] - d)).sum(axis=0)
        np.testing.assert_allclose(weight[c], old[c] * total, rtol=2e-3)
        np.testing.assert_allclose(mean[c], before[c] + gain * shift, atol=2e-4)
        second = (share * (z[:, None] - d - shift) ** 2).sum(axis=0) - share.sum(axis=0) * s
        change = np.einsum("ai,bi,i->abi", gain, gain, second) @ (old[c] * total) / (old[c] @ total)
        np.testing.assert_allclose(sums[c, 1:] / sums[c, 0], change[[0, 0, 1], [0, 1, 1]], rtol=2e-2, atol=2e-4)
    np.testing.assert_allclose(lam, np.add.reduceat(weight, first[:-1], axis=0), rtol=1e-4)


def test_predicted_moments_are_those_of_the_sample():
    rng = np.random.default_rng(2)
    agent, _, share, mean, covariance = mixture(rng)
    chosen = np.arange(0, agent.shape[1], 7)
    weight = rng.random(chosen.size)
    weight /= weight.sum()
    mass, center, spread = kernels.predicted(agent, weight, chosen, share, mean, 1e-12 * covariance)
    joint = weight * share[:, chosen]
    d = np.linalg.norm(mean[:, :, chosen] - agent[:, chosen], axis=1)
    np.testing.assert_allclose(mass, joint.sum(axis=1), rtol=1e-5)
    np.testing.assert_allclose(center, (joint * d).sum(axis=1) / mass, rtol=1e-5)
    np.testing.assert_allclose(spread, (joint * (d - center[:, None]) ** 2).sum(axis=1) / mass, rtol=1e-3)


def test_merging_keeps_mean_and_covariance_and_follows_the_ancestors():
    rng = np.random.default_rng(3)
    _, _, share, mean, covariance = mixture(rng, 50)
    mean[1:] = mean[1:2] + 0.01 * np.arange(3)[:, None, None]
    lam = np.float32(rng.uniform(0.5, 2, 50))
    mass, center = share[1:].mean(axis=1), mean[1:].mean(axis=2)
    spread = covariance[1:2].repeat(3, axis=0)
    group, count = kernels.groups(mass, center, spread, 1e-6, 0.1)
    assert count == 1 and (group == 0).all()
    ancestors = rng.integers(0, 50, 50)
    out, out_share = np.empty((1, 2, 50), np.float32), np.empty((1, 50), np.float32)
    result = kernels.merged(
        mass, center, spread, group, count, share[1:] * lam, mean[1:], lam, ancestors, out_share, out
    )
    np.testing.assert_allclose(out_share, 1, rtol=1e-6)
    np.testing.assert_allclose(out[0], np.einsum("cn,can->an", share[1:], mean[1:])[:, ancestors], rtol=1e-4)
    between = np.cov(center.T, aweights=mass, ddof=0)
    np.testing.assert_allclose(result[0], covariance[1] + between[[0, 0, 1], [0, 1, 1]], rtol=1e-4)
    far, count = kernels.groups(np.array([0.5, 0.3, 0.2]), center * 100, spread, 0.25, 0.1)
    assert count == 2 and far[2] == -1  # the lightest lies below the floor


def test_known_agent_and_certain_association_is_the_kalman_filter():
    p = RangeParameters(clutter=1e-12, undetected=1e-12, births=1e-12, position_walk=0.0, acceleration=0.0)
    place, mean, covariance = np.array([1.0, 2.0]), np.array([4.0, 6.0]), np.array([0.03, 0.01, 0.02])
    agent = np.zeros((4, 30))
    agent[:2] = place[:, None]
    means = np.repeat(np.float32([[0.0, 0.0], mean])[:, :, None], 30, axis=2)
    known = np.array([1e-6, 0.0, 1e-6])
    start = RangeMap(
        np.array([1.0, 1.0]),
        np.array([0, 1, 2]),
        np.ones((2, 30), np.float32),
        means,
        np.array([known, covariance]),
        0.0,
        np.zeros((0, 3)),
    )
    state, info = RangeOnly(p).step(
        np.random.default_rng(0), RangeState(agent, np.zeros(30), (start,)), [np.array([5.1, np.sqrt(5.0)])]
    )
    e, prior = np.array([0.6, 0.8]), np.array([[0.03, 0.01], [0.01, 0.02]])
    gain = prior @ e / (e @ prior @ e + p.filter_deviation**2)
    posterior = prior - np.outer(gain, e @ prior)
    np.testing.assert_allclose(info.features[0][1], mean + gain * 0.1, atol=1e-5)
    np.testing.assert_allclose(state.maps[0].covariance[1], posterior[[0, 0, 1], [0, 1, 1]], rtol=2e-3)


def first_steps(filter_, scans, scene, count, size=200):
    rng = np.random.default_rng(4)
    state = filter_.init(rng, scene.anchors, scene.track[0], size)
    for k in range(count):
        state, info = filter_.step(rng, state, scans[k])
    return state, info


def test_same_seed_same_result_for_any_number_of_threads(monkeypatch):
    scene, p = office(8), RangeParameters()
    scans = scene.draw(np.random.default_rng(0), p)
    results = []
    for cores in ({0}, {0, 1, 2}):
        monkeypatch.setattr(os, "sched_getaffinity", lambda _, cores=cores: cores)
        results.append(first_steps(RangeOnly(p), scans, scene, 8))
    np.testing.assert_array_equal(results[0][0].maps[0].mean, results[1][0].maps[0].mean)
    np.testing.assert_array_equal(results[0][1].position, results[1][1].position)


def test_a_new_distance_waits_until_it_is_seen_again():
    p = replace(RangeParameters(), undetected=1e-6, births=1e-3)
    filter_, rng = RangeOnly(p), np.random.default_rng(5)
    anchors = np.array([[0.0, 0.0]])
    state = filter_.init(rng, anchors, np.array([3.0, 0.0]), 200, radius=0.1)
    sizes, waits = [], []
    for _ in range(8):
        state, _ = filter_.step(rng, state, [np.array([3.0, 7.0])])
        sizes.append(len(state.maps[0].existence))
        waits.append(len(state.maps[0].waiting))
    assert sizes[0] == 1 and waits[0] == 1  # one distance could be anything
    assert sizes[-1] == 2 and waits[-1] == 0  # the same one eight times could not
    assert state.maps[0].existence[1] > 0.9
    for _ in range(8):
        state, _ = filter_.step(rng, state, [np.array([3.0])])
    assert len(state.maps[0].existence) == 1  # never seen again, forgotten


def test_bound_is_below_the_single_step_error_of_two_anchors():
    scene, p = office(60), RangeParameters()
    limit = bound(scene, p)
    e = scene.track[-1] - scene.anchors
    e /= np.linalg.norm(e, axis=1, keepdims=True)
    alone = np.sqrt(np.trace(np.linalg.inv(e.T @ e * p.detection / p.deviation**2)))
    assert (limit > 0).all() and limit[-1] < 0.7 * alone
    assert limit[-1] < limit[0]


def test_study_depends_on_seed_and_run_only():
    scene = office(6)
    first, second = (range_study.study(2, 3, 60, scenario=scene, jobs=jobs) for jobs in (1, 1))
    np.testing.assert_array_equal(first[1].position_error, second[1].position_error)
    alone = range_study.one_run(scene, RangeParameters(), 60, (3, 1))
    np.testing.assert_array_equal(alone.position_error, first[1].position_error)
    table = range_study.summary(first, scenario=scene)
    assert table["features"] == 11 and table["runs"] == 2
    assert table["position_rmse_m"] == pytest.approx(
        np.sqrt(np.mean([first[0].position_error ** 2, first[1].position_error ** 2]))
    )
    with pytest.raises(FilterError, match="runs"):
        range_study.study(0)


@pytest.mark.mc
def test_office_is_mapped_from_distances_alone():
    """One run with 1000 particles (about 10 s); the study has 10,000."""
    result = range_study.one_run(office(), RangeParameters(), 1000, (1, 0))
    assert result.position_rmse < 0.09
    assert sum(result.found) >= 10 and sum(result.false) <= 1
