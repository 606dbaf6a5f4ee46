"""Detection probability and the conversion of an estimator's detections."""

import numpy as np
import pytest

from dopslam.errors import FilterError
from dopslam.models.detection import (
    TABLE_START_DB,
    TABLE_STEP_DB,
    ConstantDetection,
    SnrDetection,
    detection_table,
    probability_from_snr,
    soft_range,
)
from dopslam.models.paths import spreading_loss
from dopslam.models.scans import Scans, from_detections
from dopslam.records import SPEED_OF_LIGHT, DetectionSeries
from dopslam.slam.pmb.density import look_up


def test_probability_from_snr_against_sampling():
    rng = np.random.default_rng(1)
    threshold, snr = 14.0, 20.0
    mean = np.zeros(8)
    mean[0] = np.sqrt(2 * snr)
    statistic = ((rng.normal(size=(200_000, 8)) + mean) ** 2).sum(1)
    assert probability_from_snr(snr, threshold) == pytest.approx((statistic > 2 * threshold).mean(), abs=0.005)


def test_table_is_monotonic_capped_and_looked_up():
    model = SnrDetection(14.0, fading_std_db=0.0, ceiling=0.97)
    table = detection_table(model)
    assert (np.diff(table) >= 0).all() and table.max() == 0.97
    decibel = TABLE_START_DB + TABLE_STEP_DB * 80
    assert look_up(table, np.log(10 ** (decibel / 10))) == pytest.approx(
        probability_from_snr(10 ** (decibel / 10), 14.0), rel=1e-9
    )
    assert look_up(table, -100.0) == table[0] and look_up(table, 100.0) == table[-1]
    np.testing.assert_array_equal(detection_table(ConstantDetection(0.8)), np.full(len(table), 0.8))


def test_spreading_and_range():
    bs = np.array([0.0, 0.0, 40.0])
    ue, x = np.array([70.0, 0.0, 0.0]), np.array([100.0, 0.0, 40.0])
    assert spreading_loss(1, x, ue, bs) == pytest.approx(2500.0)
    assert spreading_loss(2, x, ue, bs) == pytest.approx(2500.0 * 10000.0)
    np.testing.assert_allclose(soft_range([49.0, 50.0, 51.0], 50.0, 1.0), [0.8413, 0.5, 0.1587], atol=1e-4)
    np.testing.assert_array_equal(soft_range([49.0, 51.0], 50.0), [1.0, 0.0])
    assert soft_range(1e9, None) == 1.0


def series(n=3):
    rng = np.random.default_rng(2)
    return DetectionSeries(
        offsets=np.array([0, 1, n]),
        delay=np.full(n, 1e-6),
        aoa=rng.normal(size=(n, 2)),
        aod=np.column_stack([np.full(n, 3.0), np.zeros(n)]),
        radial_velocity=np.ones(n),
        gain=np.ones(n, dtype=complex),
        covariance=np.tile(np.diag([1e-20, 1e-4, 1e-4, 1e-4, 1e-4, 1e-2]), (n, 1, 1)),
        snr=np.full(n, 100.0),
        noise_variance=np.ones(2),
        threshold=14.0,
        false_alarm_rate=0.02,
        search_volume=1e6,
    )


def test_delays_become_lengths_once():
    scans = from_detections(series(), bs_yaw=0.3, doppler_span=50.0)
    assert scans.z[0, 0] == pytest.approx(299.792458)
    assert scans.covariance[0, 0, 0] == pytest.approx(1e-20 * SPEED_OF_LIGHT**2)
    assert scans.z[0, 3] == pytest.approx(3.3 - 2 * np.pi)
    assert scans.clutter_intensity(True) == pytest.approx(0.02 / 1e6)
    assert scans.clutter_intensity(False) == pytest.approx(0.02 / (1e6 / 50))


def test_impossible_models_and_scans_are_refused():
    with pytest.raises(FilterError, match="probability"):
        ConstantDetection(0.0)
    with pytest.raises(FilterError, match="threshold"):
        SnrDetection(-1.0)
    with pytest.raises(FilterError, match="shape"):
        Scans(np.zeros((2, 5)), np.zeros((2, 6, 6)), np.array([0, 2]), 1.0, 1.0, 1.0)
    with pytest.raises(FilterError, match="offsets"):
        Scans(np.zeros((2, 6)), np.tile(np.eye(6), (2, 1, 1)), np.array([0, 1]), 1.0, 1.0, 1.0)
    with pytest.raises(FilterError, match="non-finite"):
        Scans(np.full((1, 6), np.nan), np.eye(6)[None], np.array([0, 1]), 1.0, 1.0, 1.0)


def test_probability_at_the_ends_of_floating_point():
    snr = np.array([1e-300, 1.0, 9.99e4, 1.001e5, 1e30, 1e300])
    for threshold in (1e-320, 14.0, 1e5, 1e300):
        found = probability_from_snr(snr, threshold)
        assert np.all((found >= 0) & (found <= 1)) and np.all(np.diff(found) >= -1e-5)
    assert probability_from_snr(1e5 * (1 + 1e-9), 1e5) == pytest.approx(float(probability_from_snr(1e5, 1e5)), abs=1e-5)
