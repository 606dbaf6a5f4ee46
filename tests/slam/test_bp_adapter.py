"""Belief propagation on `DetectionSeries`."""

import numpy as np
import pytest

from dopslam.models.measurement import measure
from dopslam.models.scans import from_detections
from dopslam.records import SPEED_OF_LIGHT, DetectionSeries
from dopslam.slam.belief.adapter import Setup, scans_of, slam, synchronized, turning

BS = np.array([0.0, 0.0, 10.0])
WALL, POINT = np.array([0.0, 60.0, 10.0]), np.array([15.0, -6.0, 3.0])


def world(steps=30, bias=5.0, seed=0, spatial=True):
    """A straight drive past one wall and one scatterer, detections without misses or false alarms."""
    rng = np.random.default_rng(seed)
    states = np.column_stack(
        [5 + 0.5 * np.arange(1, steps + 1), np.full(steps, -8.0), np.zeros(steps), np.full(steps, bias)]
    )
    bs = BS if spatial else BS * [1, 1, 0]
    marks = [(bs, 0), (WALL if spatial else WALL * [1, 1, 0], 1), (POINT if spatial else POINT * [1, 1, 0], 2)]
    deviation = np.array([0.05, 0.01, 0.01, 0.01, 0.01, 0.1])
    z = np.array([measure(s, q, kind, bs, speed=5.0) for s in states for q, kind in marks])
    z += deviation * rng.standard_normal(z.shape) * ([1, 1, 1, 1, 1, 1] if spatial else [1, 1, 0, 1, 0, 1])
    deviation[0] /= SPEED_OF_LIGHT
    count = len(z)
    series = DetectionSeries(
        offsets=3 * np.arange(steps + 1), delay=z[:, 0] / SPEED_OF_LIGHT, aoa=z[:, 1:3], aod=z[:, 3:5],
        radial_velocity=z[:, 5], gain=np.ones(count, complex), covariance=np.tile(np.diag(deviation**2), (count, 1, 1)),
        snr=rng.uniform(300, 500, count), noise_variance=np.ones(steps), threshold=20.0, false_alarm_rate=0.1,
        search_volume=1.0,
    )  # fmt: skip
    setup = Setup(
        anchor=bs, height=0.0, mean=np.array([5.0, -8.0, 0.0, bias]), covariance=np.diag([0.1, 0.1, 0.01, 0.1]) ** 2,
        motion=turning(0.1, 0.0, np.array([0.01, 0.01, 0.001, 0.01])), speed=5.0, spatial=spatial,
    )  # fmt: skip
    return states, from_detections(series, doppler_span=50.0), setup


@pytest.mark.parametrize("spatial", [True, False])
def test_tracks_and_maps(spatial):
    states, scans, setup = world(spatial=spatial)
    history = slam(scans, setup, particles=300, rng=np.random.default_rng(1))
    error = history.mean - states
    assert np.sqrt(np.mean(np.sum(error[5:, :2] ** 2, axis=1))) < 0.15
    assert np.abs(error[:, 2]).max() < 0.05
    assert history.covariance.shape == (30, 4, 4)
    axes = 3 if spatial else 2
    final = history.position[history.rows(29)][:, :axes]
    for q in (WALL, POINT):
        assert np.linalg.norm(final - q[:axes], axis=1).min() < 1.5


def test_bias_is_carried_or_known():
    _, scans, setup = world(bias=5.0)
    free = slam(scans, setup, particles=300, rng=np.random.default_rng(2))
    known = slam(scans, synchronized(setup), particles=300, rng=np.random.default_rng(2))
    assert np.abs(free.mean[:, 3] - 5.0).max() < 0.5
    np.testing.assert_allclose(known.mean[:, 3], 5.0, atol=1e-6)
    assert np.ptp(free.mean[:, 3]) > 1e-4


def test_scans_carry_lengths_and_unit_vectors():
    _, scans, setup = world(steps=2)
    scan = scans_of(scans, setup)[1]
    np.testing.assert_allclose(scan.distance, scans.z[3:6, 0])
    np.testing.assert_allclose(np.linalg.norm(scan.aoa, axis=1), 1.0)
    np.testing.assert_allclose(np.sqrt(scan.covariance[:, 0, 0]), 0.05)
    flat = scans_of(scans, Setup(**{**{f: getattr(setup, f) for f in setup.__slots__}, "spatial": False}))[1]
    assert flat.covariance.shape[1:] == (4, 4)  # distance, two azimuths, radial velocity
    assert flat.without_doppler.covariance.shape[1:] == (3, 3)
    level = np.abs(scans.z[3:6, 2]) <= setup.largest_elevation
    np.testing.assert_array_equal(flat.radial_velocity, scans.z[3:6, 5][level])
    assert len(flat) < len(scan)  # steep arrivals are left out in the plane
