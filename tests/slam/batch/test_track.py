"""The sparse least squares against scipy's dense one on the same residuals, and robust weights."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from dopslam.errors import FilterError
from dopslam.models.measurement import measure, residual
from dopslam.models.motion import propagate
from dopslam.slam.batch.noise import GIVEN, Scales, learned, student
from dopslam.slam.batch.rows import Map
from dopslam.slam.batch.track import optimize

PLAIN = Scales(np.ones(1), np.ones(1))


def true_map(drive):
    world = drive.world
    covariance = np.zeros((len(world.kind), 3, 3))
    return Map(world.kind.copy(), world.position.copy(), np.zeros(len(world.kind), int), covariance)


def owners(drive):
    """The true association, landmarks that are never seen left out."""
    seen = np.unique(drive.scans.label[drive.scans.label >= 0])
    kept = np.union1d([0], seen)
    number = np.full(len(drive.world.kind), -1)
    number[kept] = np.arange(len(kept))
    label = drive.scans.label
    return true_map(drive).take(kept), np.where(label >= 0, number[label], -1)


def test_the_optimum_and_its_covariance_are_scipys(drive):
    found, owner = owners(drive)
    rows, world, chain = np.flatnonzero(owner >= 0), drive.world, drive.chain
    root = np.linalg.inv(np.linalg.cholesky(drive.scans.covariance[rows]))
    prior = np.linalg.cholesky(chain.information).T
    motion = np.linalg.inv(np.linalg.cholesky(world.motion.process_noise))
    poses = len(drive.state)

    def split(v):
        position = found.position.copy()
        position[1:] = v[4 * poses :].reshape(-1, 3)
        return v[: 4 * poses].reshape(poses, 4), position

    def residuals(v):
        state, position = split(v)
        h = measure(state[drive.data.step[rows] + 1], position[owner[rows]], found.kind[owner[rows]], world.bs,
                    speed=world.motion.speed, height=world.height)  # fmt: skip
        error = np.einsum("nij,nj->ni", root, residual(drive.scans.z[rows], h))
        moved = (state[1:] - propagate(state[:-1], world.motion)) @ motion.T
        held = 1e-3 * (position[1:] - found.position[1:]) * 0  # the hold of landmarks pulls nowhere
        return np.concatenate([error.ravel(), moved.ravel(), prior @ (state[0] - chain.mean), held.ravel()])

    start = np.concatenate([drive.state.ravel(), found.position[1:].ravel()])
    dense = least_squares(residuals, start, xtol=1e-14, ftol=1e-14, gtol=1e-12, x_scale="jac")
    sparse = optimize(drive.data, chain, PLAIN, owner, drive.state, found)
    state, position = split(dense.x)
    np.testing.assert_allclose(sparse.state, state, atol=2e-3)
    np.testing.assert_allclose(sparse.found.position, position, atol=1e-2)
    assert sparse.cost <= dense.cost + 1e-3
    covariance = np.linalg.inv(dense.jac.T @ dense.jac)
    blocks = np.array([covariance[4 * k : 4 * k + 4, 4 * k : 4 * k + 4] for k in range(poses)])
    deviation = np.sqrt(np.einsum("kii->ki", blocks))
    scale = deviation[:, :, None] * deviation[:, None, :]
    np.testing.assert_allclose(sparse.covariance / scale, blocks / scale, atol=5e-3)


def test_an_outlier_moves_a_plain_fit_and_not_a_robust_one(drive):
    found, owner = owners(drive)
    clean = optimize(drive.data, drive.chain, GIVEN, owner, drive.state, found)
    row = np.flatnonzero(owner > 0)[5]
    drive.data.z[row, 0] += 5.0  # 50 deviations
    try:
        plain, robust = (optimize(drive.data, drive.chain, s, owner, drive.state, found) for s in (PLAIN, GIVEN))
    finally:
        drive.data.z[row, 0] -= 5.0
    step = drive.data.step[row] + 1
    moved = [np.linalg.norm(e.state[step, :2] - clean.state[step, :2]) for e in (plain, robust)]
    assert moved[1] < 0.25 * moved[0]
    assert robust.weight[row] < 0.05
    assert np.median(robust.weight[owner >= 0]) > 0.9


def test_a_landmark_without_a_detection_is_named(drive):
    found, owner = owners(drive)
    with pytest.raises(FilterError, match="landmark 1 has no detection"):
        optimize(drive.data, drive.chain, PLAIN, np.where(owner == 2, -1, owner), drive.state, found)


@pytest.mark.parametrize(("freedom", "factor"), [(3.0, 2.0), (6.0, 0.5), (48.0, 4.0)])
def test_factor_and_tail_are_learned_from_residuals(freedom, factor):
    rng = np.random.default_rng(1)
    rows = rng.integers(3, 6, 4000)
    square = rng.choice(student(freedom, factor).scale, 4000) * rng.chisquare(rows)
    found = learned(square, rows)
    assert any(
        np.array_equal(found.scale, student(freedom, f).scale) for f in factor * 2.0 ** np.arange(-0.25, 0.3, 0.25)
    )


def test_information_is_the_curvature_of_the_cost():
    """Observed information against differences of the score, averaged over directions."""
    scales, rows, step = student(3.0, 2.0), 3, 1e-4
    for square in (0.5, 4.0, 9.0):
        at = np.sqrt(square)

        def cost(x):
            return -scales.weigh(np.array([x]), np.array([rows]))[0][0]

        along = (cost((at + step) ** 2) - 2 * cost(square) + cost((at - step) ** 2)) / step**2
        across = 2 * (cost(square + step**2) - cost(square)) / step**2
        expected = (along + (rows - 1) * across) / rows
        assert scales.information(np.array([square]), np.array([rows]))[0] == pytest.approx(expected, rel=1e-3)


def test_what_the_noise_is_known_to_be():
    density, weight = GIVEN.weigh(np.array([5.0, 500.0]), np.array([6, 6]))
    assert weight[0] == pytest.approx(1, abs=0.02)
    assert weight[1] < 0.02
    direct = np.log(sum(p * s**-3.0 * np.exp(-0.5 * 500 / s) for p, s in zip(GIVEN.share, GIVEN.scale, strict=True)))
    assert density[1] == pytest.approx(direct)
