"""Simulated tracks and detections: reproducible, and statistically what they claim."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.errors import FilterError
from dopslam.evaluate.metrics import state_errors
from dopslam.models.amplitude import AmplitudeModel, Radio, flat_rms_bandwidth
from dopslam.models.measurement import SP, measure, residual
from dopslam.models.motion import propagate
from dopslam.simulate.world import (
    AmplitudeNoise,
    SnrNoise,
    draw_scans,
    draw_track,
    generators,
    noise_of,
    nominal_track,
    section_v,
    simulate,
    unknown_motion,
)


def test_a_run_depends_on_seed_and_number_only():
    world = section_v()
    first, scans = simulate(world, 5, 3)
    simulate(world, 5, 2)
    again, same = simulate(world, 5, 3)
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(scans.z, same.z)
    other, _ = simulate(world, 5, 4)
    assert np.abs(first - other).max() > 0


def test_doppler_noise_alone_changes_doppler_alone():
    """Paired studies: the same run with another σ_d keeps everything else."""
    _, one = simulate(section_v(0.1), 0, 0)
    _, two = simulate(section_v(1.0), 0, 0)
    np.testing.assert_array_equal(one.z[:, :5], two.z[:, :5])
    real = one.label >= 0
    assert (one.z[real, 5] != two.z[real, 5]).all()


def test_track_noise_has_the_stated_covariance():
    world = section_v()
    steps = []
    for run in range(300):
        states = draw_track(world, generators(1, run)[0])
        steps.append(state_errors(states[1:], propagate(states[:-1], world.motion)))
    covariance = np.cov(np.concatenate(steps).T)
    np.testing.assert_allclose(np.diag(covariance), np.diag(world.motion.process_noise), rtol=0.06)


def test_detections_have_the_stated_statistics():
    world = section_v()
    errors, detections, visible, clutter = [], 0, 0, 0
    for run in range(200):
        states, scans = simulate(world, 2, run)
        step = np.repeat(np.arange(40), np.diff(scans.offsets))
        real = scans.label >= 0
        exact = measure(
            states[step[real]],
            world.position[scans.label[real]],
            world.kind[scans.label[real]],
            world.bs,
            speed=22.22,
        )
        errors.append(residual(scans.z[real], exact))
        clutter += (~real).sum()
        near = np.linalg.norm(world.position - np.column_stack([states[:, :2], np.zeros(40)])[:, None], axis=-1) < 50
        visible += (near | (world.kind != SP)).sum()
        detections += real.sum()
        assert near[step[real], scans.label[real]][world.kind[scans.label[real]] == SP].all()
    np.testing.assert_allclose(np.concatenate(errors).std(0), world.noise.std, rtol=0.02)
    assert detections / visible == pytest.approx(0.9, abs=0.006)
    assert clutter / (200 * 40) == pytest.approx(1.0, abs=0.04)


def test_noise_follows_the_link_budget():
    base = section_v()
    noise = SnrNoise(np.array([0.6, 0.3, 0.4, 0.1, 0.3, 0.9]), np.array([86.0] + 4 * [77.5] + 4 * [94.5]), 14.0)
    _, scans = simulate(replace(base, noise=noise), 0, 0)
    np.testing.assert_allclose(scans.covariance[:, 0, 0], 0.36 / scans.snr, rtol=1e-9)
    real = scans.label >= 0
    assert 10 * np.log10(scans.snr[scans.label == 0].mean()) == pytest.approx(48, abs=1)
    assert scans.snr[real].min() > 1


def test_nominal_track_is_the_circle():
    states = nominal_track(section_v())
    np.testing.assert_allclose(np.hypot(states[:, 0], states[:, 1]), 70.7285, atol=0.01)
    np.testing.assert_allclose(states[-1, :2], [70.7285, 0], atol=1e-6)


def test_mismatched_worlds_are_refused():
    with pytest.raises(FilterError, match="prior_mean"):
        replace(section_v(), motion=unknown_motion(section_v()).motion)
    with pytest.raises(FilterError, match="prior"):
        section_v(prior="both")


def test_noise_over_the_pole_is_another_direction():
    """Angles that are drawn are angles that can be measured, whatever their deviation."""
    world = section_v(steps=5)
    wide = replace(world, noise=replace(world.noise, std=np.array([0.1, 3.0, 3.0, 3.0, 3.0, 0.1])))
    _, scans = simulate(wide, 1, 0)
    assert np.abs(scans.z[:, [2, 4]]).max() <= np.pi / 2
    assert np.abs(scans.z[:, [1, 3]]).max() <= np.pi


def test_amplitudes_decide_what_is_seen_and_how_exactly():
    """Paper B's noise in the same world: detections as often as Marcum's Q says, errors of Fisher's size, R as observed."""
    detector = AmplitudeModel(threshold=10**0.45, samples=1e6)
    radio = Radio(28e9, flat_rms_bandwidth(400e6), 0.01, 0.02)
    noise = AmplitudeNoise(np.full(9, 4.0), np.full(9, 200.0), radio, detector, doppler_unit=0.5)
    steady = replace(section_v(), noise=noise, steps=60, clutter_count=2.0)
    states = nominal_track(steady)
    told = noise_of(steady, states)
    seen = np.zeros(told.probability.shape)
    squares, reported = [], []
    for seed in range(40):
        scans = draw_scans(steady, states, *(np.random.default_rng([seed, i]) for i in range(2)))
        step, label = scans.step_of_row, scans.label
        assert np.all(scans.snr > scans.threshold)
        np.testing.assert_allclose(scans.covariance[:, 0, 0], radio.unit_deviations[0] ** 2 / scans.snr)
        true = label >= 0
        seen[step[true], label[true]] += 1
        exact = measure(
            steady.motion.pose(states[step[true]]), steady.position[label[true]], steady.kind[label[true]], steady.bs
        )
        squares.append((scans.z[true, 0] - exact[:, 0]) ** 2 / told.covariance[step[true], label[true], 0, 0])
        reported.append(scans.snr[true] / told.snr[step[true], label[true]])
    expected = 40 * told.probability
    assert abs(seen.sum() - expected.sum()) < 5 * np.sqrt((expected * (1 - told.probability)).sum())
    count = sum(map(len, squares))
    assert abs(np.concatenate(squares).mean() - 1) < 5 * np.sqrt(2 / count)
    assert 0.9 < np.median(np.concatenate(reported)) < 1.3  # what passes the threshold looks stronger
    assert told.snr.min() > 0 and noise.detection is None
