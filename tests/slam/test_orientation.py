"""A base station turned by a little turns the world about it: the covariances know."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.errors import FilterError
from dopslam.filters import FILTERS
from dopslam.models.measurement import wrap
from dopslam.pipeline.problem import told
from dopslam.simulate.hall import YAW_OFF, measured_hall
from dopslam.simulate.world import section_v, simulate
from dopslam.slam.filter import run
from dopslam.slam.history import History
from dopslam.slam.orientation import turnable, yaw_of_track

STATION = np.array([3.0, -2.0, 40.0])


def test_the_covariance_grows_by_what_a_turn_moves():
    rng = np.random.default_rng(0)
    mean, place, angle = rng.normal(0, 30, (4, 4)), rng.normal(0, 60, (5, 3)), 1e-6
    history = History(
        mean, np.tile(np.eye(4), (4, 1, 1)), np.array([0, 2, 3, 5, 5]), place, np.tile(np.eye(3), (5, 1, 1)),
        np.ones(5), np.tile([0.0, 1, 0, 0], (5, 1)), np.ones(5, int), np.arange(5),
    )  # fmt: skip
    turned = turnable(history, STATION, 0.02)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def moved(points):
        return ((points[:, :2] - STATION[:2]) @ turn.T + STATION[:2] - points[:, :2]) / angle

    state = np.column_stack([moved(mean), np.ones(4), np.zeros(4)])
    point = np.column_stack([moved(place), np.zeros(5)])
    np.testing.assert_allclose(turned.covariance - np.eye(4), 4e-4 * state[:, :, None] * state[:, None, :], atol=1e-4)
    np.testing.assert_allclose(
        turned.position_covariance - np.eye(3), 4e-4 * point[:, :, None] * point[:, None, :], atol=1e-4
    )


def test_it_is_what_a_wrong_yaw_does_to_a_run_from_no_prior():
    """Departures turned by half a degree turn the track about the base station by as much."""
    situation = section_v(steps=8)
    _, scans = simulate(situation, 3, 0)
    problem, off = replace(told(situation), snapshot=True), np.deg2rad(0.5)
    wrong = replace(scans, z=scans.z + np.eye(6)[3] * off)
    right, turned = (run(problem, s, FILTERS["joint"]())[0].mean for s in (scans, wrong))
    turn = np.array([[np.cos(off), -np.sin(off)], [np.sin(off), np.cos(off)]])
    expected = (right[:, :2] - situation.bs[:2]) @ turn.T + situation.bs[:2]
    np.testing.assert_allclose(turned[:, :2], expected, atol=0.02)
    np.testing.assert_allclose(turned[:, 2], right[:, 2] + off, atol=1e-3)


def test_with_a_start_it_is_refused():
    situation = section_v(steps=2)
    _, scans = simulate(situation, 3, 0)
    with pytest.raises(FilterError, match="yaw_std_deg"):
        run(replace(told(situation), yaw_std=0.02), scans, FILTERS["joint"]())


def test_a_known_track_tells_the_yaw():
    """Drawn halls: heavy tails, covariances wrong by two, a fifth and more of the positions without a line of sight."""
    errors, claimed = [], []
    for seed in range(40, 52):
        hall = measured_hall(seed)
        found = yaw_of_track(hall.detections, hall.track.position, hall.stations)
        apart = wrap(found.value - hall.stations.yaw[0] + YAW_OFF * np.array([-1, 1]))
        errors.append(np.min(np.abs(apart)))
        claimed.append(found.std)
    assert np.sqrt(np.mean(np.square(errors))) < np.deg2rad(0.9)
    assert 0.5 < np.sqrt(np.mean(np.square(errors) / np.square(claimed))) < 2.0


def test_a_receiver_that_stands_still_tells_no_yaw():
    """Then a wall, or an object, is as good as the base station itself."""
    hall = measured_hall(40)
    still = replace(hall.detections, time=None).take(np.zeros(20, int))
    assert yaw_of_track(still, hall.track.position[np.zeros(20, int)], hall.stations) is None
