"""The equations of single bounces and lines of sight, against the measurement model and its Fisher information."""

import numpy as np
import pytest

from dopslam.models.measurement import BS, SP, VA, jacobians, measure
from dopslam.slam.snapshot.rays import Rays, bounce, sight

ROUGH = np.diag([0.04, 3e-4, 2e-4, 5e-4, 1e-4, 0.01])


def scene(seed, planar, kinds):
    """A pose, and the exact rays of one landmark of each kind."""
    rng = np.random.default_rng(seed)
    height = float(rng.uniform(0, 2))
    station = np.array([*rng.uniform(-20, 20, 2), height if planar else height + rng.uniform(1, 10)])
    state = np.array([*rng.uniform(-20, 20, 2), rng.uniform(-np.pi, np.pi), rng.uniform(-100, 100)])
    place = np.column_stack([rng.uniform(-40, 40, (len(kinds), 2)), rng.uniform(-5, 15, len(kinds))])
    if planar:
        place[:, 2] = height
    z = measure(state, place, np.array(kinds), station, height=height, speed=1.0)
    count = len(kinds)
    return state, place, station, Rays(z, np.tile(ROUGH, (count, 1, 1)), np.tile(station, (count, 1)), height, planar)


@pytest.mark.parametrize("planar", [True, False])
@pytest.mark.parametrize("kind", [VA, SP])
def test_a_single_bounce_satisfies_its_equations(planar, kind):
    checked = 0
    for seed in range(40):
        state, place, station, rays = scene(seed, planar, [kind] * 5)
        found = bounce(state[None], rays)
        real = found.possible[0]
        if kind == VA:  # the wall must lie between the anchor and the receiver
            position = np.array([*state[:2], rays.height])
            real &= np.einsum("li,li->l", position - 0.5 * (place + station), station - place) > 0
        assert np.abs(found.error[0][real]).max(initial=0.0) < 1e-9
        legs = found.arrival[0] + found.departure[0]
        np.testing.assert_allclose(legs, rays.z[:, 0] - state[3])
        if kind == SP:
            position = np.array([*state[:2], rays.height])
            np.testing.assert_allclose(
                found.arrival[0][real], np.linalg.norm(place - position, axis=1)[real], rtol=1e-7
            )
        checked += int(real.sum())
    assert checked > 100


@pytest.mark.parametrize("planar", [True, False])
def test_jacobians_against_differences(planar):
    """Of both equations, at the true pose; the basis of the normals turns with the pose, |e| does not care."""
    for seed in range(10):
        state, _, _, rays = scene(seed, planar, [SP] * 6)
        found, step = bounce(state[None], rays), 1e-6
        _, slope = sight(state[None], rays)
        for i in range(4):
            moved = state[None] + step * np.eye(4)[i]
            change = np.linalg.norm(bounce(moved, rays).error, axis=-1)[0] / step
            wanted = np.linalg.norm(found.jacobian[0][..., i], axis=-1)
            np.testing.assert_allclose(change[found.possible[0]], wanted[found.possible[0]], rtol=2e-3, atol=1e-4)
            difference = (sight(state[None] - step * np.eye(4)[i], rays)[0] - sight(moved, rays)[0])[0] / (2 * step)
            np.testing.assert_allclose(slope[0][..., i], difference, rtol=1e-5, atol=1e-6)


def test_a_line_of_sight_has_no_residual():
    for planar in (True, False):
        state, _, _, rays = scene(3, planar, [BS])
        assert np.abs(sight(state[None], rays)[0]).max() < 1e-9


@pytest.mark.parametrize("kind", [VA, SP])
def test_the_equations_hold_all_that_a_free_landmark_leaves(kind):
    """Information on the pose = Fisher information of delay and angles with the landmark eliminated."""
    for seed in range(20):
        state, place, station, rays = scene(seed, False, [SP])
        if kind == VA:  # the twin: the anchor whose incidence point is the scatter point
            position = np.array([*state[:2], rays.height])
            way = place[0] - position
            place = position + way / np.linalg.norm(way) * (rays.z[0, 0] - state[3])[None, None]
        found = bounce(state[None], rays)
        if not found.possible.all():
            continue
        jacobian, covariance = found.jacobian[0, 0], found.covariance[0, 0]
        ours = jacobian.T @ np.linalg.solve(covariance, jacobian)
        by_pose, by_place = jacobians(state, place, np.array([kind]), station, height=rays.height)
        by_pose, by_place, weight = by_pose[0, :5], by_place[0, :5], np.linalg.inv(ROUGH[:5, :5])
        cross = by_pose.T @ weight @ by_place
        wanted = by_pose.T @ weight @ by_pose - cross @ np.linalg.solve(by_place.T @ weight @ by_place, cross.T)
        scale = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
        np.testing.assert_allclose(ours / scale, wanted / scale, atol=1e-6)
