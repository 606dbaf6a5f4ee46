"""ATE and RPE against hand computation, against invariances, and against evo where it is installed."""

import numpy as np
import pytest

from dopslam.errors import DopslamError
from dopslam.evaluate.trajectory import absolute_errors, alignment, poses, relative_errors, statistics


def drawn(seed, steps=30):
    rng = np.random.default_rng(seed)
    position = np.cumsum(rng.normal(size=(steps, 3)), axis=0)
    return poses(position, rng.uniform(-3, 3, steps)), rng


def moved(pose, rng, size=0.3):
    steps = len(pose)
    return pose @ poses(size * rng.normal(size=(steps, 3)), 0.1 * rng.normal(size=steps))


def test_two_poses_by_hand():
    truth = poses(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]), np.array([0.0, np.pi / 2, np.pi / 2]))
    estimate = poses(np.array([[0.0, 1.0], [2.0, 1.0], [2.0, 1.0]]), np.array([0.0, np.pi / 2, np.pi]))
    np.testing.assert_allclose(absolute_errors(truth, estimate), [1, np.sqrt(2), 1])
    # First: two ahead instead of one, no turn too many. Then: nothing instead of one ahead, a quarter turn too many.
    translation, angle = relative_errors(truth, estimate)
    np.testing.assert_allclose(translation, [1, 1], atol=1e-12)
    np.testing.assert_allclose(angle, [0, np.pi / 2], atol=1e-12)
    found = statistics(np.array([3.0, 4.0]))
    assert (found.rmse, found.mean, found.min, found.max) == (np.sqrt(12.5), 3.5, 3.0, 4.0)


def test_relative_errors_and_aligned_ones_do_not_mind_a_rigid_motion():
    truth, rng = drawn(0)
    estimate = moved(truth, rng)
    away = poses(np.array([[40.0, -7.0, 2.0]]), np.array([1.2]))[0]
    for delta in (1, 4):
        for one, other in zip(*(relative_errors(truth, p, delta) for p in (estimate, away @ estimate)), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-9)
    one, other = (absolute_errors(truth, p, align=True) for p in (estimate, away @ estimate))
    np.testing.assert_allclose(one, other, atol=1e-9)
    np.testing.assert_allclose(absolute_errors(truth, away @ truth, align=True), 0, atol=1e-9)
    assert absolute_errors(truth, away @ truth).min() > 10


def test_no_small_motion_of_the_aligned_estimate_is_better():
    truth, rng = drawn(1)
    estimate = moved(truth, rng)
    best = alignment(truth, estimate) @ estimate
    least = np.sum(absolute_errors(truth, best) ** 2)
    for _ in range(50):
        nudge = poses(1e-3 * rng.normal(size=(1, 3)), 1e-3 * rng.normal(size=1))[0]
        assert np.sum(absolute_errors(truth, nudge @ best) ** 2) >= least - 1e-12


def test_what_cannot_be_compared_is_refused():
    truth, _ = drawn(2)
    with pytest.raises(DopslamError, match="30 true and 29 estimated"):
        absolute_errors(truth, truth[:-1])
    with pytest.raises(DopslamError, match="one line"):
        alignment(truth[:1].repeat(5, axis=0), truth[:5])
    with pytest.raises(DopslamError, match="delta is 0"):
        relative_errors(truth, truth, 0)
    with pytest.raises(DopslamError, match="no error"):
        statistics(relative_errors(truth[:1], truth[:1])[0])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_evo_says_the_same(seed):
    metrics = pytest.importorskip("evo.core.metrics", reason="evo is not installed (pip install evo)")
    from evo.core.trajectory import PosePath3D

    truth, rng = drawn(seed)
    estimate = poses([[9.0, -2, 1]], [0.4])[0] @ moved(truth, rng)
    for align in (False, True):
        reference, other = (PosePath3D(poses_se3=list(p)) for p in (truth, estimate))
        if align:
            other.align(reference)
        judge = metrics.APE(metrics.PoseRelation.translation_part)
        judge.process_data((reference, other))
        mine = absolute_errors(truth, estimate, align)
        np.testing.assert_allclose(mine, judge.error, atol=1e-9)
        told = judge.get_all_statistics()
        for name, value in ((n, getattr(statistics(mine), n)) for n in ("rmse", "mean", "median", "std", "min", "max")):
            assert value == pytest.approx(told[name], abs=1e-9)
    for delta in (1, 3):
        relations = (metrics.PoseRelation.translation_part, metrics.PoseRelation.rotation_angle_rad)
        for mine, relation in zip(relative_errors(truth, estimate, delta), relations, strict=True):
            judge = metrics.RPE(relation, delta=delta, delta_unit=metrics.Unit.frames)
            judge.process_data((PosePath3D(poses_se3=list(truth)), PosePath3D(poses_se3=list(estimate))))
            np.testing.assert_allclose(mine, judge.error, atol=1e-7)
