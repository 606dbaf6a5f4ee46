"""The drawn measurement campaign, and the whole-run smoother on it from no prior: in the plane, without Doppler."""

import numpy as np
import pytest

from dopslam.models import unmeasured
from dopslam.models.measurement import BS, VA, measure, wrap
from dopslam.models.scans import Scans, from_detections
from dopslam.records import SPEED_OF_LIGHT, same
from dopslam.simulate.hall import HEIGHT, YAW_OFF, measured_hall
from dopslam.slam.batch.filter import Batch
from dopslam.slam.batch.rows import place, rows_of
from dopslam.slam.snapshot.rays import Rays, bounce, sight
from dopslam.studies.hall import bound_of, judged, summarize


@pytest.fixture(scope="module")
def hall():
    return measured_hall(4)


def test_everything_is_wrong_that_is_said_to_be_and_comes_from_the_seed(hall):
    assert same(hall.detections, measured_hall(4).detections)
    assert not same(hall.detections, measured_hall(5).detections)
    steps = hall.track.steps
    without = np.mean([not np.any(hall.label[hall.detections.rows(k)] == 0) for k in range(steps)])
    assert 0.2 <= without <= 0.3
    # Errors of true single bounces and lines of sight: deviations of the delay are off by the square root of two.
    rows = np.flatnonzero((hall.label >= 0) & (hall.landmarks.order[hall.label] < 2))
    state = hall.track.state[hall.detections.step_of_row[rows]]
    own = hall.label[rows]
    exact = measure(
        state, hall.landmarks.position[own], hall.landmarks.kind[own], hall.stations.position[0], height=HEIGHT
    )
    error = hall.detections.delay[rows] * SPEED_OF_LIGHT - exact[:, 0]
    told = np.sqrt(hall.detections.covariance[rows, 0, 0]) * SPEED_OF_LIGHT
    ratio = np.std(error / told) ** 2 * hall.information[0]
    assert ratio == pytest.approx(1, abs=0.2)
    assert hall.information[0] in (0.5, 2.0)
    turned = wrap(hall.detections.aod[rows, 0] + hall.stations.yaw[0] - exact[:, 3])
    assert abs(np.median(turned)) == pytest.approx(YAW_OFF, abs=0.008)


def test_no_elevation_and_no_doppler_are_missing_rows_in_the_plane(hall):
    scans = from_detections(hall.detections, doppler_span=4.0)
    data = rows_of(scans, hall.stations.position + np.array([0, 0, 5.0]), HEIGHT, 0.0)
    np.testing.assert_array_equal(data.used.all(axis=0), [True, True, False, True, False, False])
    np.testing.assert_array_equal(data.used.any(axis=0), data.used.all(axis=0))
    assert data.flat
    assert data.stations[0, 2] == HEIGHT + 5.0  # a height that is known counts, elevations or not
    assert data.spans[0] == pytest.approx(100.0)
    assert unmeasured.planar(np.einsum("nii->ni", scans.covariance))
    assert not unmeasured.planar(np.full((3, 6), 0.01))


@pytest.mark.mc
def test_batch_finds_the_walk_and_the_hall_from_nothing(hall):
    result = judged(4, Batch(), 16)
    assert not result.lost
    assert np.sqrt(np.mean(result.squared) / np.mean(result.bound)) < 1.6
    summary = summarize([result])
    assert summary["lost"] == 0
    bound = bound_of(hall)
    assert np.all(np.linalg.eigvalsh(bound) > 0)
    assert bound.shape == (hall.track.steps, 2, 2)


def test_a_base_station_above_the_receiver_counts_without_elevations():
    """Walls that stand upright: the equations of the plane hold for the length on the ground, and landmarks are found."""
    bs, height = np.array([2.0, -3.0, 9.0]), 1.5
    state = np.array([12.0, 5.0, 0.4, 30.0])
    points = np.array([bs, [40.0, -3.0, 9.0], [2.0, 51.0, 9.0], [-30.0, 20.0, 9.0]])
    kind = np.array([BS, VA, VA, VA])
    z = measure(state[None], points, kind, bs, height=height)
    covariance = np.broadcast_to(np.diag([0.01, 1e-6, 1e5, 1e-6, 1e5, 1e5]), (4, 6, 6)).copy()
    flat = z * np.array([1, 1, 0, 1, 0, 0])
    seen = Rays(flat, covariance, np.broadcast_to(bs, (4, 3)), height, planar=True, doppler=False)
    found, (residual, slope) = bounce(state[None], seen), sight(state[None], seen)
    assert np.abs(found.error[0, 1:]).max() < 1e-9 and np.abs(residual[0, 0, [0, 1, 3]]).max() < 1e-9
    for i in range(4):  # derivatives of the residuals, by central differences
        move = np.zeros(4)
        move[i] = 1e-5
        after, before = bounce(state[None] + move, seen).error, bounce(state[None] - move, seen).error
        assert np.allclose((after - before)[0, 1:, 0] / 2e-5, found.jacobian[0, 1:, 0, i], atol=1e-6)
        after, before = sight(state[None] + move, seen)[0], sight(state[None] - move, seen)[0]
        assert np.allclose(-(after - before)[0, 0, [0, 1, 3]] / 2e-5, slope[0, 0, [0, 1, 3], i], atol=1e-6)
    scans = Scans(
        z=flat, covariance=covariance, offsets=np.array([0, 4]), clutter_count=0.1, search_volume=1e9, doppler_span=10.0
    )
    data = rows_of(scans, bs, height, 0.0, doppler=False)
    placed, real = place(data, np.arange(1, 4), np.broadcast_to(state, (3, 4)), kind[1:])
    assert real.all() and np.allclose(placed, points[1:], atol=1e-9)
