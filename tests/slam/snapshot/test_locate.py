"""A receiver located from one scan in random rooms; what the modes claim; nothing breaks on poor scans."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.evaluate.metrics import nees, state_errors
from dopslam.slam.snapshot.candidates import Prior
from dopslam.slam.snapshot.locate import find_modes
from dopslam.slam.snapshot.rays import Rays

from .rooms import room

FIRST = 1000  # development used rooms 0 … 99


def located(modes, state):
    """NEES of each mode below the 99.9999 % quantile of four degrees of freedom."""
    return nees(state_errors(modes.pose, state), modes.covariance) < 34.0


@pytest.mark.parametrize("planar", [True, False])
@pytest.mark.parametrize("sight", [True, False])
def test_a_receiver_is_located_from_nothing(planar, sight):
    states, found = zip(*(room(FIRST + i, planar=planar, sight=sight) for i in range(8)), strict=True)
    hits = [located(find_modes(rays), state) for state, rays in zip(states, found, strict=True)]
    assert np.mean([h.any() for h in hits]) >= 7 / 8
    assert np.mean([h[0] for h in hits]) >= 6 / 8


@pytest.mark.mc
@pytest.mark.parametrize(("planar", "angle", "best", "any_mode"), [(False, 0.01, 0.97, 0.98), (False, 5e-4, 0.97, 0.98),
                                                                (True, 0.02, 0.85, 0.95)])  # fmt: skip
def test_share_of_scans_located(planar, angle, best, any_mode):
    hits, square = [], []
    for i in range(100):
        state, rays = room(2 * FIRST + i, planar=planar, sight=i % 2 == 0, angle_std=angle)
        modes = find_modes(rays)
        hits.append((located(modes, state)[0], located(modes, state).any()))
        square.append(nees(state_errors(modes.pose, state), modes.covariance).min())
    assert np.mean(hits, axis=0)[0] >= best and np.mean(hits, axis=0)[1] >= any_mode
    assert 2.5 < np.mean([s for s in square if s < 34]) < 5.5


def test_the_answer_moves_with_the_world():
    state, rays = room(FIRST + 3)
    modes = find_modes(rays)
    turn, shift = 0.7, np.array([100.0, -40.0, 0.0])
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    z = rays.z.copy()
    z[:, 3] = (z[:, 3] + turn + np.pi) % (2 * np.pi) - np.pi
    moved = find_modes(replace(rays, z=z, anchor=rays.anchor @ rotation.T + shift))
    wanted = np.array([*(rotation[:2, :2] @ modes.pose[0, :2] + shift[:2]), modes.pose[0, 2] + turn, modes.pose[0, 3]])
    assert np.abs(state_errors(moved.pose[0], wanted)).max() < 1e-3
    assert moved.evidence[0] == pytest.approx(modes.evidence[0], abs=1e-2)
    assert located(modes, state)[0]


def test_the_order_of_the_paths_does_not_matter():
    _, rays = room(FIRST + 5, planar=True)
    order = np.random.default_rng(1).permutation(len(rays.z))
    shuffled = replace(rays, z=rays.z[order], covariance=rays.covariance[order], anchor=rays.anchor[order])
    one, other = find_modes(rays), find_modes(shuffled)
    np.testing.assert_allclose(one.pose[0], other.pose[0], atol=1e-6)
    np.testing.assert_allclose(one.bounce[0][order], other.bounce[0], atol=1e-5)


def test_a_prior_is_one_more_factor():
    """Two paths in the plane decide nothing; with a prior they sharpen it, and never widen it."""
    state, rays = room(FIRST + 7, planar=True, clutter=0.0)
    few = replace(rays, z=rays.z[:2], covariance=rays.covariance[:2], anchor=rays.anchor[:2])
    prior = Prior(state + np.array([0.3, -0.2, 0.05, 0.2]), np.diag([0.3, 0.3, 0.05, 0.3]) ** 2)
    modes = find_modes(few, prior)
    assert located(modes, state)[0]
    assert np.linalg.eigvalsh(prior.covariance - modes.covariance[0]).min() > -1e-9


def test_the_velocity_comes_with_doppler():
    state, rays = room(FIRST + 11, speed=1.3)
    modes = find_modes(rays)
    wanted = 1.3 * np.array([np.cos(state[2]), np.sin(state[2])])
    spread = np.sqrt(np.diag(modes.velocity_covariance[0]))
    assert np.all(np.abs(modes.velocity[0] - wanted) < 5 * spread) and spread.max() < 0.5
    assert find_modes(replace(rays, doppler=False)).velocity is None


@pytest.mark.parametrize("planar", [True, False])
def test_poor_scans_give_no_mode_and_no_error(planar):
    _, rays = room(FIRST + 13, planar=planar)
    for rows in ([], [0], [0, 0, 0]):
        modes = find_modes(Rays(rays.z[rows], rays.covariance[rows], rays.anchor[rows], rays.height, planar))
        assert np.isfinite(modes.evidence).all() and np.isfinite(modes.pose).all()
    assert len(find_modes(Rays(rays.z[:0], rays.covariance[:0], rays.anchor[:0]))) == 0


def test_two_base_stations_count_twice():
    """Paths of a second base station in the same room sharpen the answer."""
    state, first = room(FIRST + 17)
    rng = np.random.default_rng(2)
    station = np.array([11.0, 7.5, 3.5])
    from dopslam.models.measurement import measure

    place = np.column_stack([rng.uniform(0, 12, (5, 2)), rng.uniform(0.5, 3, 5)])
    exact = measure(state, np.vstack([station, place]), np.array([0, 2, 2, 2, 2, 2]), station, height=1.3)
    z = exact + rng.standard_normal((6, 6)) * [0.05, *[0.01] * 4, 0.1]
    both = Rays(
        np.vstack([first.z, z]),
        np.concatenate([first.covariance, first.covariance[[0] * 6]]),
        np.vstack([first.anchor, np.tile(station, (6, 1))]),
        1.3,
        doppler=False,
    )
    modes = find_modes(both)
    assert located(modes, state)[0]
    assert np.trace(modes.covariance[0]) < np.trace(find_modes(first).covariance[0])


def test_paths_measured_to_micrometers_are_no_singular_matrix():
    """A clean short path at 70 dB: its information drowns everything that bounds the rest in its rounding."""
    for seed in range(12):
        _, rays = room(FIRST + seed)
        sharp = rays.covariance * np.logspace(-12, 0, len(rays.z))[:, None, None]
        modes = find_modes(replace(rays, covariance=sharp))
        assert np.isfinite(modes.pose).all() and np.linalg.eigvalsh(modes.covariance).min() > 0
