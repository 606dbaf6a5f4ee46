"""A map that remembers and detections that lie: sight, second reflections, distorted and outlying detections."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from dopslam.compute.linalg import factorize
from dopslam.evaluate.metrics import nees, state_errors
from dopslam.models.detection import ConstantDetection
from dopslam.models.measurement import BS, SR, VA, measure
from dopslam.models.scans import from_detections
from dopslam.records import DetectionSeries
from dopslam.simulate.world import FixedNoise, draw_scans, nominal_track, simulate
from dopslam.slam.pmb import ek_pmb
from dopslam.slam.pmb.density import PMB, compile_model, initial_density
from dopslam.slam.pmb.ek_pmb import FilterParameters, filter_scans
from dopslam.slam.pmb.hypotheses import log_again

pytestmark = pytest.mark.mc


def one_landmark(world, weight=0.9, spread=0.3, detections=5.0):
    """The receiver and one virtual anchor that exists with some probability."""
    start = initial_density(world.prior_mean, world.prior_covariance)
    covariance = np.zeros((7, 7))
    covariance[:4, :4], covariance[4:, 4:] = world.prior_covariance, spread**2 * np.eye(3)
    return PMB(
        mean=np.concatenate([world.prior_mean, world.landmarks(VA)[0]]),
        covariance=covariance,
        kind=np.array([BS, VA], dtype=np.int64),
        weight=np.array([1.0, weight]),
        track=np.array([-1, 0], dtype=np.int64),
        reference=np.zeros(2),
        detections=np.array([5.0, detections]),
        visible=np.ones(2),
        unseen=np.zeros(2),
        idle=np.zeros(2),
        origin=np.zeros(2, dtype=np.int64),
        trail=start.trail,
    )


def filtered(density, model, z=(), noise=None, snr=0.0):
    """The density after scans, each a list of measurements."""
    rows = np.array([row for scan in z for row in scan], dtype=float).reshape(-1, 6)
    offsets = np.concatenate([[0], np.cumsum([len(scan) for scan in z])]).astype(np.int64)
    covariance = np.broadcast_to(np.eye(6) if noise is None else noise, (len(rows), 6, 6)).copy()
    log_snr = np.full(len(rows), float(snr))
    return filter_scans(
        rows, covariance, log_snr, offsets, 1e-9, np.ones(len(offsets) - 1), density, model, np.zeros(1, dtype=np.int64)
    )


def test_misses_against_all_histories_of_sight(world):
    """Existence and P(in sight) after misses: sums over every sequence of hidden and visible steps."""
    p_d, hide, back, misses, prior = 0.9, 0.05, 0.1, 7, 0.9
    parameters = FilterParameters(hide=hide, reappear=back, detection=ConstantDetection(p_d, None))
    model = compile_model(parameters, world.motion, world.bs)
    density = filtered(one_landmark(world, prior), model, [[]] * misses)[0]
    alive, in_sight = 0.0, 0.0
    for sequence in product((True, False), repeat=misses):
        weight, before = 1.0, True
        for k, sight in enumerate(sequence):
            returning = back / (1 + back * p_d * k)
            appear = 1 - hide if before else returning
            weight *= (appear * (1 - p_d)) if sight else 1 - appear
            before = sight
        alive += weight
        in_sight += weight * sequence[-1]
    assert density.weight[1] == pytest.approx(prior * alive / (1 - prior + prior * alive), rel=1e-12)
    assert density.visible[1] == pytest.approx(in_sight / alive, rel=1e-12)
    forgetful = compile_model(replace(parameters, hide=0.0), world.motion, world.bs)
    gone = filtered(one_landmark(world, prior), forgetful, [[]] * misses)[0]
    assert gone.kind.size == 1
    young = filtered(one_landmark(world, prior, detections=1.0), model, [[]] * misses)[0]
    assert young.kind.size == 1  # a single detection may have been a false alarm


def test_a_landmark_behind_something_keeps_its_track(world):
    """A virtual anchor out of sight for twenty steps is in the map all the time, and its return is no birth."""
    _, scans = simulate(world, 3, 2)
    step = np.repeat(np.arange(40), np.diff(scans.offsets))
    keep = ~((scans.label == 1) & (step >= 12) & (step < 32))
    hidden = replace(
        scans, z=scans.z[keep], covariance=scans.covariance[keep], label=scans.label[keep], anchor=scans.anchor[keep],
        offsets=np.concatenate([[0], np.cumsum(np.bincount(step[keep], minlength=40))]),
    )  # fmt: skip
    arguments = (hidden, (world.prior_mean, world.prior_covariance), world.motion, world.bs)
    history, _ = ek_pmb.run(*arguments)
    tracks = []
    for k in (11, 31, 39):
        rows = history.rows(k)
        off = np.linalg.norm(history.position[rows] - world.position[1], axis=1)
        near = rows.start + np.flatnonzero((off < 6.0) & (history.kind[rows] == VA) & (history.existence[rows] > 0.5))
        assert near.size == 1, f"step {k}"
        tracks.append(history.track[near[0]])
    assert len(set(tracks)) == 1
    forgetful, _ = ek_pmb.run(*arguments, FilterParameters(hide=0.0))
    rows = forgetful.rows(31)
    assert tracks[0] not in forgetful.track[rows][forgetful.existence[rows] > 0.5]


def with_second_reflections(world):
    """The walls and two second reflections, whose departures are anything; no scatter points, no clutter."""
    return replace(
        world,
        kind=np.array([BS, VA, VA, VA, VA, SR, SR]),
        position=np.vstack([world.position[:5], [[200.0, 200, 40], [-200.0, 200, 40]]]),
        noise=FixedNoise(world.noise.std, 0.9, None),
        clutter_count=0.1,
    )


def test_second_reflections_are_mapped_and_inform(world):
    double = with_second_reflections(world)
    values, mapped = [], 0
    for run in range(6):
        rng = np.random.default_rng([5, run])
        states, scans = simulate(double, 7, run)
        z = scans.z.copy()
        second = scans.label >= 5
        z[second, 3] = rng.uniform(-np.pi, np.pi, second.sum())
        z[second, 4] = rng.uniform(-1, 1, second.sum())
        history, _ = ek_pmb.run(
            replace(scans, z=z), (double.prior_mean, double.prior_covariance), double.motion, double.bs
        )
        values.append(nees(state_errors(history.mean, states), history.covariance).mean())
        found = history.reported(39, SR)
        mapped += sum(np.linalg.norm(found - x, axis=1).min(initial=np.inf) < 10.0 for x in double.position[5:])
        assert len(found) <= 3
    assert mapped >= 11 and 2.5 < np.mean(values) < 6.5


def test_one_wrong_detection_among_good_ones_moves_little(world):
    """Forty standard deviations of length in one of five detections, with a receiver much less certain than they are."""
    density = one_landmark(world)
    count = 5
    mean = np.concatenate([world.prior_mean, world.position[1:5].ravel()])
    covariance = np.zeros((16, 16))
    covariance[:4, :4] = world.prior_covariance
    covariance[4:, 4:] = 1e-4 * np.eye(12)
    density = PMB(
        mean, covariance, np.array([BS, VA, VA, VA, VA]), np.array([1.0, *[0.999] * 4]), np.array([-1, 0, 1, 2, 3]),
        np.zeros(count), np.full(count, 5.0), np.ones(count), np.zeros(count),
        np.zeros(count), np.zeros(count, dtype=np.int64), density.trail,
    )  # fmt: skip
    state = nominal_track(world)[0]
    noise = np.diag((0.1 * world.noise.std) ** 2)
    z = measure(state, world.position[:5], world.kind[:5], world.bs, speed=world.motion.speed)
    wrong = z.copy()
    wrong[2, 0] += 40 * np.sqrt(noise[0, 0])
    moved = {}
    for robust in (10.0, np.inf):
        parameters = FilterParameters(robust=robust, iterations=8, gate=4000.0)
        model = compile_model(parameters, world.motion, world.bs)
        means = [filtered(density, model, [list(scan)], noise)[0].mean[:4] for scan in (z, wrong)]
        moved[robust] = np.linalg.norm(means[1] - means[0])
    assert moved[10.0] < 0.35 * moved[np.inf]


def test_a_distorted_detection_is_no_landmark_beside_the_one_it_stems_from(world):
    """Off by many standard deviations in all rows but within a resolution cell (30 dB): no birth, and nothing moves."""
    density = one_landmark(world, spread=0.01)
    state = nominal_track(world)[0]
    noise = np.diag((0.05 * world.noise.std) ** 2)
    z = measure(state, world.position[1], VA, world.bs, speed=world.motion.speed)
    z = z + 20.0 * np.sqrt(np.diag(noise)) * np.array([1, 1, -1, -1, 1, 0.2])
    results = {}
    for outlier in (20.0, 0.0):
        model = compile_model(
            FilterParameters(outlier=outlier, detection=ConstantDetection(0.9, None)), world.motion, world.bs
        )
        results[outlier] = filtered(density, model, [[z]], noise, snr=np.log(1000.0))[0]
    assert results[20.0].weight[2:].sum() < 0.1 and results[20.0].weight[1] > 0.89
    np.testing.assert_allclose(results[20.0].mean[4:7], world.position[1], atol=0.02)
    if results[0.0].weight.size > 2:
        assert results[0.0].weight[2:].sum() > results[20.0].weight[2:].sum()


def test_of_two_tracks_of_one_path_the_one_that_is_seen_is_left(world):
    """A duplicate within the resolution cell of a landmark that is detected cannot be out of sight; one elsewhere can, and so
    can one in the same cell that has been seen too often for a duplicate."""
    noise = np.diag((0.05 * world.noise.std) ** 2)
    start = one_landmark(world, weight=0.99, spread=0.01)
    left = {}
    for name, shift, seen in (("beside", 0.8, 3.0), ("elsewhere", 60.0, 3.0), ("a house behind", 0.8, 5.0)):
        covariance = np.zeros((10, 10))
        covariance[:7, :7], covariance[7:, 7:] = start.covariance, 1e-4 * np.eye(3)
        other = start.mean[4:7] + shift * np.array([0.6, 0.8, 0.0])
        density = PMB(
            np.concatenate([start.mean, other]), covariance, np.array([BS, VA, VA]), np.array([1.0, 0.99, 0.9]),
            np.array([-1, 0, 1]), np.zeros(3), np.array([5.0, 5.0, seen]), np.ones(3), np.zeros(3), np.zeros(3),
            np.zeros(3, dtype=np.int64), start.trail,
        )  # fmt: skip
        states = nominal_track(world)[:12]
        z = [
            [measure(s, x, k, world.bs, speed=world.motion.speed) for x, k in ((world.bs, BS), (world.position[1], VA))]
            for s in states
        ]
        model = compile_model(FilterParameters(detection=ConstantDetection(0.9, None)), world.motion, world.bs)
        posterior = filtered(density, model, z, noise, snr=np.log(1000.0))[0]
        left[name] = posterior.weight[posterior.track == 1].sum()
        assert posterior.weight[posterior.track == 0].sum() > 0.99
    assert left["beside"] < 0.05 and left["elsewhere"] > 0.15 and left["a house behind"] > 0.15


def test_factorize_mends_rounding_and_nothing_else():
    root = np.array([[1.0, 1.0], [1.0, 1.0 - 1e-13]])
    factor = root.copy()
    assert factorize(factor, 2)
    np.testing.assert_allclose(np.tril(factor) @ np.tril(factor).T, root, atol=1e-10)
    assert not factorize(np.array([[1.0, 2.0], [2.0, 1.0]]), 2)
    assert not factorize(np.full((2, 2), np.nan), 2)


def test_a_second_reflection_leaves_where_it_left_before():
    """Its departure is as likely as that of one that wanders by 0.2 rad, once it is established; others explain theirs."""
    noise = np.diag([1e-4, 1e-4, 1e-4, 0.01, 0.04, 1e-4])
    density = 1.0 / (2.0 * np.pi * np.sqrt((0.01 + 0.2**2) * (0.04 + 0.2**2)))
    assert np.exp(log_again(noise, SR, 5.0)) == pytest.approx(density * 2.0 * np.pi**2)
    assert log_again(noise, SR, 1.0) == log_again(noise, VA, 5.0) == 0.0
    assert log_again(np.diag([1e-4, 1e-4, 1e-4, 1e4, 1e4, 1e-4]), SR, 5.0) == 0.0  # no departure measured


def flagged(flags, snr, apart=0.0):
    """Detections of one scan whose R falls with their ρ, `apart` [s] in delay."""
    count = len(flags)
    variance = np.array([1e-18, 1e-6, 1e-6, 1e-6, 1e-6, 1e-4]) * 1e4 / np.asarray(snr)[:, None]
    return DetectionSeries(
        offsets=np.array([0, count]), delay=1e-7 + apart * np.arange(count), aoa=np.zeros((count, 2)),
        aod=np.zeros((count, 2)), radial_velocity=np.zeros(count), gain=np.ones(count, complex),
        covariance=np.einsum("ni,ij->nij", variance, np.eye(6)), snr=np.asarray(snr, float), noise_variance=np.ones(1),
        threshold=1.0, false_alarm_rate=0.01, search_volume=1.0, flags=np.array(flags),
    )  # fmt: skip


def widened(series):
    """By what the variance of each delay grows."""
    scale = 299792458.0**2 * series.covariance[:, 0, 0]
    return from_detections(series, doppler_span=1.0).covariance[:, 0, 0] / scale


def test_flags_of_the_estimator_widen_what_the_filters_believe():
    """A close pair by two, the edge of view by four, what is no single path by ten; a weak detection is what it is."""
    np.testing.assert_allclose(widened(flagged([0, 1, 4, 2, 32, 33], [1e4] * 6)), [1, 2, 1, 4, 10, 10])


def test_a_crowd_within_a_resolution_cell_is_doubted():
    """Four close detections in one cell, R falling with ρ; not where the fourth is further off, nor where no cell is known."""
    snr = [1e4, 2e4, 4e4, 8e4]
    np.testing.assert_allclose(widened(flagged([1] * 4, snr, 1e-9)), 10.0)
    np.testing.assert_allclose(widened(flagged([1] * 4, snr, 1e-6)), 2.0)
    np.testing.assert_allclose(widened(flagged([1, 1, 1, 0], snr, 1e-9)), [2, 2, 2, 1])
    np.testing.assert_allclose(widened(flagged([1] * 4, [1e4] * 4, 1e-9)), 2.0)


def test_sharp_detections_neither_fail_nor_diverge(world):
    """Millimetres and hundredths of a degree against process noise of decimetres."""
    sharp = replace(world, noise=FixedNoise(world.noise.std * [0.01, 0.004, 0.004, 0.004, 0.004, 0.02], 0.95, None))
    values = []
    for run in range(4):
        states = nominal_track(sharp)
        rng = np.random.default_rng([9, run])
        scans = draw_scans(sharp, states, rng, rng)
        history, _ = ek_pmb.run(scans, (sharp.prior_mean, sharp.prior_covariance), sharp.motion, sharp.bs)
        values.append(nees(state_errors(history.mean, states), history.covariance).mean())
    assert np.median(values) < 8.0
