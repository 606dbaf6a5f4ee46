"""The elimination along the pose chain against one dense Cholesky of the whole run."""

import numpy as np
import pytest

from dopslam.slam.batch.front import Normal, plan, solve


def random_normal(rng, poses, n, landmarks, sightings, loop=False):
    """Normal equations of random Jacobians, and the dense matrix and right side they stand for."""
    size = n * poses + 3 * landmarks
    dense, vector = np.zeros((size, size)), np.zeros(size)
    owner, step = rng.integers(-1, landmarks, sightings), np.sort(rng.integers(0, poses, sightings))
    if loop:
        owner[[0, -1]] = 0
    owner[rng.permutation(sightings)[:landmarks]] = np.arange(landmarks)
    pose, tie = np.zeros((poses, n, n)), np.zeros((poses - 1, n, n))
    point, cross = np.tile(1e-3 * np.eye(3), (landmarks, 1, 1)), np.zeros((sightings, n, 3))
    for j in range(landmarks):
        at = slice(n * poses + 3 * j, n * poses + 3 * j + 3)
        dense[at, at] += point[j]
    for k in range(poses):
        a, b = rng.normal(size=(n, n)), rng.normal(size=(n, n))
        pose[k] += a.T @ a
        rows = slice(n * k, n * k + n)
        if k + 1 < poses:
            pose[k] += b.T @ b
            pose[k + 1] += np.eye(n)
            tie[k] = b.T
    for k in range(poses):
        dense[n * k : n * k + n, n * k : n * k + n] += pose[k]
        if k + 1 < poses:
            dense[n * k : n * k + n, n * k + n : n * k + 2 * n] += tie[k]
            dense[n * k + n : n * k + 2 * n, n * k : n * k + n] += tie[k].T
    for i, (k, j) in enumerate(zip(step, owner, strict=True)):
        a, b = rng.normal(size=(5, n)), rng.normal(size=(5, 3))
        rows = slice(n * k, n * k + n)
        pose[k] += a.T @ a
        dense[rows, rows] += a.T @ a
        if j >= 0:
            at = slice(n * poses + 3 * j, n * poses + 3 * j + 3)
            cross[i], point[j] = a.T @ b, point[j] + b.T @ b
            dense[rows, at] += cross[i]
            dense[at, rows] += cross[i].T
            dense[at, at] += b.T @ b
    vector = rng.normal(size=size)
    offsets = np.searchsorted(step, np.arange(poses + 1))
    normal = Normal(pose, tie, point, cross, owner, offsets, vector[: n * poses].reshape(poses, n).copy(),
                    vector[n * poses :].reshape(landmarks, 3).copy())  # fmt: skip
    first = np.array([step[owner == j].min() for j in range(landmarks)], dtype=np.int64)
    last = np.array([step[owner == j].max() for j in range(landmarks)], dtype=np.int64)
    return plan(poses, n, first, last), normal, dense, vector


@pytest.mark.parametrize(("poses", "n", "landmarks", "sightings"), [(2, 4, 1, 3), (7, 4, 3, 30), (12, 6, 9, 25)])
def test_solution_covariance_and_determinant_are_the_dense_ones(poses, n, landmarks, sightings):
    rng = np.random.default_rng(poses)
    order, normal, dense, vector = random_normal(rng, poses, n, landmarks, sightings, loop=True)
    found = solve(order, normal, spread=True)
    covariance = np.linalg.inv(dense)
    exact = covariance @ vector
    np.testing.assert_allclose(np.concatenate([found.pose.ravel(), found.point.ravel()]), exact, rtol=1e-7, atol=1e-9)
    assert found.log_determinant == pytest.approx(np.linalg.slogdet(dense)[1])
    blocks = [covariance[n * k : n * k + n, n * k : n * k + n] for k in range(poses)]
    np.testing.assert_allclose(found.pose_covariance, blocks, rtol=1e-7, atol=1e-10)
    base = n * poses
    blocks = [covariance[base + 3 * j : base + 3 * j + 3, base + 3 * j : base + 3 * j + 3] for j in range(landmarks)]
    np.testing.assert_allclose(found.point_covariance, blocks, rtol=1e-7, atol=1e-10)
    damped = solve(order, normal, damping=0.5)
    exact = np.linalg.solve(dense + 0.5 * np.diag(np.diag(dense)), vector)
    np.testing.assert_allclose(np.concatenate([damped.pose.ravel(), damped.point.ravel()]), exact, rtol=1e-7, atol=1e-9)


def test_a_matrix_that_is_not_definite_is_none():
    order, normal, _, _ = random_normal(np.random.default_rng(0), 4, 4, 2, 8)
    assert solve(order, normal._replace(pose=-normal.pose)) is None


def test_the_front_stays_small_when_landmarks_are_passed_by():
    first = np.arange(0, 1000, 5)
    order = plan(1000, 4, first, np.minimum(first + 20, 999))
    assert order.size <= 8 + 3 * 6
    assert len(order.column) < 1000 * 60
