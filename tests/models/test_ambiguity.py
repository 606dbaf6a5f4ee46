"""Delays known modulo the link's range get the turn that the prior says, or one sentence."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.config.scenario import load
from dopslam.errors import FilterError
from dopslam.models.ambiguity import unwrapped
from dopslam.models.motion import CoordinatedTurn
from dopslam.pipeline import file as stages
from dopslam.pipeline import problem as build
from dopslam.pipeline import stages as pipeline
from dopslam.records import SPEED_OF_LIGHT, DetectionSeries, edges_of
from dopslam.slam.history import History
from dopslam.store import file as dataset

RING = 624.6  # m, of the ring road's link


def series(delay, counts, span):
    rows = len(delay)
    return DetectionSeries(
        offsets=edges_of(counts), delay=np.asarray(delay) / SPEED_OF_LIGHT, aoa=np.zeros((rows, 2)), aod=np.zeros((rows, 2)),
        radial_velocity=np.zeros(rows), gain=np.ones(rows, complex), covariance=np.tile(np.eye(6), (rows, 1, 1)),
        snr=np.ones(rows), noise_variance=np.ones(len(counts)), threshold=1.0, false_alarm_rate=1.0, search_volume=1.0,
        delay_range=span / SPEED_OF_LIGHT,
    )  # fmt: skip


def driven(rng, span, walk=0.1, steps=30):
    """A random drive and clock, path lengths within two thirds of the range, and its delays modulo the range."""
    bias = rng.uniform(-20, 20) * span + np.cumsum(rng.normal(size=steps) * walk)
    speed, course = rng.uniform(0, 20), rng.uniform(-np.pi, np.pi)
    start, station = rng.uniform(-span / 6, span / 6, 2), np.array([0, 0, rng.uniform(2, 0.05 * span)])
    place = start + 0.1 * speed * np.arange(1, steps + 1)[:, None] * [np.cos(course), np.sin(course)]
    sight = np.hypot(np.linalg.norm(place, axis=1), station[2])
    counts = rng.integers(0, 8, steps)
    length = np.repeat(sight + bias, counts) + rng.uniform(0, 2 / 3 * span, counts.sum()) * (
        rng.random(counts.sum()) < 0.8
    )
    motion = CoordinatedTurn(0.1, np.diag([0.1, 0.1, 0.01, walk]) ** 2, speed, 0.0)
    return series(length % span, counts, span), length, np.array([*start, course, bias[0]]), motion, station


@pytest.mark.parametrize("seed", range(1000, 1040))
def test_every_delay_of_a_random_drive_gets_its_own_turn(seed):
    rng = np.random.default_rng(seed)
    span = 10 ** rng.uniform(2, 3.5)
    wrapped, length, mean, motion, station = driven(rng, span)
    prior = mean, np.diag([0.3, 0.3, 0.01, 0.3]) ** 2
    found = unwrapped(wrapped, prior, motion, station, 0.0)
    assert np.allclose(found.delay * SPEED_OF_LIGHT, length, atol=1e-6)
    again = unwrapped(found, prior, motion, station, 0.0)
    assert np.allclose(again.delay, found.delay, rtol=1e-12)  # whoever asks twice gets the same


def test_the_delays_are_followed_where_dead_reckoning_is_lost():
    """A clock that walks by 8 m a step over a range of 100 m: after some ten steps nobody knows the turn, but the delays
    move little between steps."""
    rng, span, steps = np.random.default_rng(1001), 100.0, 200
    bias = 7350.0 + np.cumsum(rng.normal(size=steps) * 8.0)
    excess = np.array([0.0, 11.0, 23.0, 30.0])
    length = (50.0 + bias[:, None] + excess).ravel()
    motion = CoordinatedTurn(0.1, np.diag([0.1, 0.1, 0.01, 8.0]) ** 2, 0.0, 0.0)
    prior = np.array([50.0, 0, 0, 7350.0]), np.diag([0.3, 0.3, 0.01, 0.3]) ** 2
    found = unwrapped(series(length % span, [4] * steps, span), prior, motion, np.zeros(3), 0.0)
    assert np.allclose(found.delay * SPEED_OF_LIGHT, length, atol=1e-6)
    assert np.ptp(bias) > span  # or it would show nothing


def test_a_clock_that_is_not_known_at_all_leaves_the_turn_to_the_gap():
    length = np.array([330.0, 380.0, 470.0]) + 9 * 624.0
    motion = CoordinatedTurn(0.1, np.diag([0.1, 0.1, 0.01, 0.1]) ** 2)
    prior = np.array([50.0, 0, 0, 9 * 624.0]), np.diag([0.3, 0.3, 0.01, 300.0]) ** 2
    found = unwrapped(series((length + 200) % 624, [3], 624.0), prior, motion, np.zeros(3), 0.0)
    turns = (found.delay * SPEED_OF_LIGHT - 200 - length) / 624  # cut nowhere between them, in one turn
    assert np.ptp(turns) < 1e-9 and abs(turns[0] - round(turns[0])) < 1e-9
    full = np.arange(0, 624, 20.0)
    with pytest.raises(FilterError, match=r"known modulo 624 m.*±300 m only.*better than ±31.2 m \(track.start_std"):
        unwrapped(series(full, [len(full)], 624.0), prior, motion, np.zeros(3), 0.0)


def test_delays_of_no_range_stay_as_they_are():
    scenario = load("ring_road", ["source.kind=model", "track.steps=3"])
    _, _, detections = pipeline.simulate(scenario, 1)
    assert detections.delay_range == np.inf
    read = build.problem(scenario).scans(detections)
    np.testing.assert_array_equal(read.z[:, 0], SPEED_OF_LIGHT * detections.delay)


def test_a_start_from_nothing_takes_the_turn_of_the_scenario_and_no_more():
    settings = [
        "source.kind=model",
        "track.steps=12",
        "track.start=[70.7285, 0, 1.5707963, 400]",
        "source.model.clutter_rate=0.01",
    ]
    scenario = load("ring_road", settings)
    track, _, absolute = pipeline.simulate(scenario, 4)
    span = RING / SPEED_OF_LIGHT
    wrapped = replace(absolute, delay=absolute.delay % span, delay_range=span)
    assert np.ptp(absolute.delay // span) > 0  # they lie across the end of the range
    blind = load("ring_road", [*settings, 'filter.start="snapshot"'])
    history = pipeline.slam(blind, wrapped)
    assert np.linalg.norm(history.mean[:, :2] - track.position[:, :2], axis=1).max() < 3.0
    assert np.abs(history.mean[:, 3] - track.bias).max() < 3.0


@pytest.mark.parametrize("density", ["joint", "smoother", "bp"])
@pytest.mark.parametrize("bias", [-500.0, 400.0, 5000.0])
def test_filters_do_not_mind_how_late_the_clock_is(bias, density):
    settings = [
        "source.kind=model",
        "track.steps=12",
        "filter.particles=300",
        f"track.start=[70.7285, 0, 1.5707963, {bias}]",
    ]
    scenario = load("ring_road", settings)
    track, _, absolute = pipeline.simulate(scenario, 3)
    span = RING / SPEED_OF_LIGHT
    wrapped = replace(absolute, delay=absolute.delay % span, delay_range=span)
    history = pipeline.slam(scenario, wrapped, density)
    off = np.linalg.norm(history.mean[:, :2] - track.position[:, :2], axis=1)
    assert np.sqrt(np.mean(off**2)) < 1.5
    assert np.abs(history.mean[:, 3] - track.bias).max() < 3.0
    if density == "joint" and bias != 400.0:  # what went wrong before: the line of sight a turn off
        lost = pipeline.slam(scenario, replace(wrapped, delay_range=np.inf), density)
        assert np.linalg.norm(lost.mean[-1, :2] - track.position[-1, :2]) > 0.3


def test_an_estimator_says_the_range_of_its_delays(tmp_path):
    """It is the inverse of the pilots' spacing, and it is kept in the file."""
    from estimation import Detections

    scenario = load("ring_road")
    none = Detections(
        delay=np.zeros(0), aoa=np.zeros((0, 2)), aod=np.zeros((0, 2)), radial_velocity=np.zeros(0), gain=np.zeros(0, complex),
        covariance=np.zeros((0, 6, 6)), tangent_covariance=np.zeros((0, 6, 6)), snr=np.zeros(0), noise_variance=1.0,
        threshold=14.0, false_alarm_rate=0.01, flags=np.zeros(0, np.uint8), active=np.ones(6, bool),
    )  # fmt: skip
    made = pipeline.stack_detections(scenario, [none])
    assert made.delay_range == pytest.approx(1 / (scenario.radio.subcarrier_spacing * scenario.radio.comb))
    dataset.write_record(tmp_path / "d.h5", "detections", made)
    assert dataset.read_record(tmp_path / "d.h5", "detections", DetectionSeries).delay_range == made.delay_range


@pytest.mark.rt
@pytest.mark.parametrize("bias", [-500.0, 700.0])
def test_a_traced_link_with_a_late_clock_is_not_lost(tmp_path, bias):
    """From scene to track: the bound and the matching of detections know the range as well."""
    path = tmp_path / "d.h5"
    stages.trace(path, load("ring_road", [f"track.start=[70.7285, 0, 1.5707963, {bias}]", "track.steps=6"]), 3)
    stages.estimate(path)
    stages.slam(path)
    stages.bound(path)
    summary, _ = stages.evaluate(path)
    assert summary["rmse_over_bound"]["position"] < 3 and not summary["diverged"]
    assert np.abs(dataset.read_record(path, "slam_joint", History).mean[:, 3] - bias).max() < 3
