"""Landmarks from nothing: voting, kinds, merging, and the rounds of the whole-run smoother."""

import numpy as np
import pytest

from dopslam.models.measurement import BS, SP, SR, VA
from dopslam.slam.batch.associate import associate
from dopslam.slam.batch.landmarks import believe, decide_kinds, fit, merge, vote
from dopslam.slam.batch.noise import GIVEN
from dopslam.slam.batch.rows import Map, place, predict
from dopslam.slam.batch.smoother import Choices, only_stations, smooth

from .conftest import case


def belief_at_truth(drive):
    return believe(drive.data, drive.truth, 1e-6 * np.tile(np.eye(4), (len(drive.truth), 1, 1)), GIVEN)


def test_places_invert_the_measurement(drive):
    label = drive.scans.label
    rows = np.flatnonzero(label > 0)
    kind = drive.world.kind[label[rows]]
    exact = predict(drive.data, drive.truth[drive.data.step[rows]], kind, drive.world.position[label[rows]],
                    np.zeros(len(rows), int))  # fmt: skip
    noisy = drive.data.z[rows].copy()
    drive.data.z[rows] = exact
    try:
        position, possible = place(drive.data, rows, drive.truth[drive.data.step[rows]], kind)
    finally:
        drive.data.z[rows] = noisy
    assert possible.all()
    np.testing.assert_allclose(position, drive.world.position[label[rows]], atol=1e-6)


def test_landmarks_are_found_by_voting_and_told_apart(drive):
    belief = belief_at_truth(drive)
    owner = associate(drive.data, belief, only_stations(drive.data))
    np.testing.assert_array_equal(owner == 0, drive.scans.label == 0)
    found, owner = vote(drive.data, belief, owner, 1)
    world = drive.world
    for truth in range(1, len(world.kind)):
        rows = drive.scans.label == truth
        if rows.sum() < 4:
            continue
        mine = np.unique(owner[rows & (owner >= 0)])
        assert len(mine) == 1
        assert found.kind[mine[0] - 1] == world.kind[truth]
        assert np.linalg.norm(found.position[mine[0] - 1] - world.position[truth]) < 10
    assert np.mean(owner[drive.scans.label < 0] >= 0) < 0.1


def test_a_kind_is_decided_by_evidence_and_a_departure_may_stay_unexplained(drive):
    belief, label, world = belief_at_truth(drive), drive.scans.label, drive.world
    wall = int(np.flatnonzero(world.kind == VA)[0])
    owner = np.where(label == wall, 1, -1)
    wrong = Map(np.array([BS, SP]), np.array([world.bs, [0.0, 50.0, 10.0]]), np.zeros(2, int), np.zeros((2, 3, 3)))
    right, evidence = decide_kinds(drive.data, belief, wrong, owner)
    assert right.kind[1] == VA
    assert evidence[1] > 50
    rows = np.flatnonzero(owner == 1)
    departures = drive.data.z[rows, 3].copy()
    drive.data.z[rows, 3] += np.linspace(1, 2, len(rows))
    try:
        assert decide_kinds(drive.data, belief, wrong, owner)[0].kind[1] == SR
    finally:
        drive.data.z[rows, 3] = departures


def test_halves_of_one_landmark_are_merged_and_different_ones_are_not(drive):
    belief, label, world = belief_at_truth(drive), drive.scans.label, drive.world
    walls = np.flatnonzero(world.kind == VA)[:2]
    early = drive.data.step < 8
    owner = np.select([(label == walls[0]) & early, label == walls[0], label == walls[1]], [1, 2, 3], -1)
    rows = np.flatnonzero(owner > 0)
    kind = np.full(3, VA)
    fitted = fit(drive.data, belief, rows, owner[rows] - 1, kind, world.position[[walls[0], walls[0], walls[1]]])
    new = Map(kind, fitted.position, np.zeros(3, int), fitted.covariance)
    found, merged = merge(drive.data, belief, only_stations(drive.data).joined(new), owner,
                          np.concatenate([[np.inf], fitted.evidence]))  # fmt: skip
    assert len(found) == 3
    assert len(np.unique(merged[label == walls[0]])) == 1
    assert merged[label == walls[0]][0] != merged[label == walls[1]][0]


@pytest.mark.parametrize("seed", [3, 4])
def test_the_rounds_end_with_a_consistent_track_and_the_true_map(seed):
    drive = case(seed, steps=20)
    result = smooth(drive.data, drive.chain, drive.state, drive.covariance, Choices())
    error = result.estimate.state[1:] - drive.truth
    error[:, 2] = (error[:, 2] + np.pi) % (2 * np.pi) - np.pi
    square = np.einsum("ki,kij,kj->k", error, np.linalg.inv(result.estimate.covariance[1:]), error)
    assert square.mean() < 10
    found = result.estimate.found
    walls = drive.world.position[drive.world.kind == VA]
    distance = np.linalg.norm(walls[:, None] - found.position[found.kind == VA], axis=-1)
    assert distance.min(axis=1).max() < 8
    wrong = (result.owner < 0) & (drive.scans.label >= 0)
    assert wrong.mean() < 0.1


def test_a_start_that_is_astray_comes_home_by_the_prior_and_the_line_of_sight():
    drive = case(5)
    good = smooth(drive.data, drive.chain, drive.state, drive.covariance, Choices())
    moved = drive.state + np.array([15.0, -10.0, 0.3, 5.0])
    home = smooth(drive.data, drive.chain, moved, drive.covariance, Choices())
    assert home.score == pytest.approx(good.score, abs=0.1)
    np.testing.assert_allclose(home.estimate.state, good.estimate.state, atol=0.01)
