"""The measurement model against finite differences, symmetries and its compiled twin."""

import numpy as np
import pytest

from dopslam.models import kernels
from dopslam.models.measurement import (
    BS,
    SP,
    SR,
    VA,
    jacobians,
    measure,
    residual,
    seen_noise,
    wrap,
)
from dopslam.models.paths import incidence
from dopslam.models.pose import positions

BS_POSITION = np.array([0.0, 0.0, 40.0])
SPEED = 22.22


def draw(rng, n, size=4):
    state = np.column_stack([rng.uniform(-90, 90, (n, 2)), rng.uniform(-np.pi, np.pi, n), rng.uniform(250, 350, n)])
    if size == 6:
        state = np.column_stack([state, rng.uniform(1, 30, n), rng.normal(0, 0.3, n)])
    direction = rng.normal(size=(n, 3))
    direction[:, 2] *= 0.3
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    # A wall beyond the UE: mirror the BS in a plane 100 to 150 m away, so that the incidence point exists.
    wall = rng.uniform(100, 150, n)
    va = BS_POSITION + 2 * (wall - direction @ BS_POSITION)[:, None] * direction
    sp = rng.uniform([-99, -99, 1], [99, 99, 30], (n, 3))
    kind = rng.integers(0, 4, n)
    landmark = np.where(np.isin(kind, (VA, SR))[:, None], va, np.where((kind == SP)[:, None], sp, BS_POSITION))
    return state, landmark, kind


def central_differences(function, x, step=1e-4):
    columns = []
    for j in range(x.shape[-1]):
        h = np.zeros(x.shape[-1])
        h[j] = step * max(1.0, np.abs(x[..., j]).max() * 1e-2)
        columns.append(residual(function(x + h), function(x - h)) / (2 * h[j]))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("size", [4, 6])
def test_jacobians_match_central_differences(size):
    state, landmark, kind = draw(np.random.default_rng(1), 900, size)
    by_state, by_landmark = jacobians(state, landmark, kind, BS_POSITION, speed=SPEED)
    numeric = central_differences(lambda s: measure(s, landmark, kind, BS_POSITION, speed=SPEED), state)
    assert np.abs(by_state - numeric).max() < 1e-6 * np.abs(numeric).max()
    numeric = central_differences(lambda x: measure(state, x, kind, BS_POSITION, speed=SPEED), landmark)
    assert np.abs(by_landmark - numeric).max() < 1e-6 * max(1.0, np.abs(numeric).max())


def test_translation_invariance_of_arrival_and_doppler():
    """Moving UE and landmark together changes neither the arrival angles nor the Doppler (the BS does not
    move).
    """
    state, landmark, kind = draw(np.random.default_rng(2), 300)
    by_state, by_landmark = jacobians(state, landmark, kind, BS_POSITION, speed=SPEED)
    free = kind != BS
    total = by_state[free][:, [1, 2, 5], :2] + by_landmark[free][:, [1, 2, 5], :2]
    assert np.abs(total).max() < 1e-12


def test_rigid_motion_equivariance():
    rng = np.random.default_rng(3)
    state, landmark, kind = draw(rng, 200)
    angle, shift = 0.7, np.array([12.0, -30.0, 0.0])
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    moved = state.copy()
    moved[:, :2] = (positions(state) @ turn.T + shift)[:, :2]
    moved[:, 2] += angle
    before = measure(state, landmark, kind, BS_POSITION, speed=SPEED)
    after = measure(moved, landmark @ turn.T + shift, kind, turn @ BS_POSITION + shift, speed=SPEED)
    turned = np.where(kind == SR, 0.0, angle)  # AOD is in world axes, everything else is relative
    before[:, 3] = wrap(before[:, 3] + turned)
    np.testing.assert_allclose(residual(after, before), 0, atol=1e-9)


def test_every_virtual_anchor_has_a_scatter_twin():
    """An SP at a VA's incidence point gives the same six numbers: one measurement never tells the type."""
    state, landmark, kind = draw(np.random.default_rng(4), 300)
    va = landmark[kind == VA]
    state = state[kind == VA]
    point, t = incidence(positions(state), va, BS_POSITION)
    path = (t > 0) & (t < 1)
    assert path.sum() > 50
    as_va = measure(state[path], va[path], VA, BS_POSITION, speed=SPEED)
    as_sp = measure(state[path], point[path], SP, BS_POSITION, speed=SPEED)
    np.testing.assert_allclose(residual(as_va, as_sp), 0, atol=1e-9)


def test_a_second_reflection_is_a_virtual_anchor_without_departure():
    """Length, arrival and Doppler of the base station mirrored twice; the departure tells nothing, whatever it is."""
    state, _, _ = draw(np.random.default_rng(11), 50)
    twice = BS_POSITION * [-1, 1, 1] + [200.0, 0, 0]  # mirrored at x = 100
    twice = twice * [1, -1, 1] + [0, 240.0, 0]  # then at y = 120
    shared = [0, 1, 2, 5]
    one, other = (measure(state, twice, kind, BS_POSITION, speed=SPEED) for kind in (SR, VA))
    np.testing.assert_array_equal(one[:, shared], other[:, shared])
    for own, anchors in zip(
        *(jacobians(state, twice, kind, BS_POSITION, speed=SPEED) for kind in (SR, VA)), strict=True
    ):
        np.testing.assert_array_equal(own[:, shared], anchors[:, shared])
        assert not own[:, 3:5].any()


@pytest.mark.parametrize("rows", [5, 6])
def test_the_departure_of_a_second_reflection_is_uniform(rows):
    """Its noise: the other rows' block of R, and densities 1/2π and 1/π of azimuth and elevation."""
    root = np.random.default_rng(12).normal(size=(rows, rows))
    noise = root @ root.T
    seen, others = seen_noise(noise, SR), [i for i in range(rows) if i not in (3, 4)]
    np.testing.assert_array_equal(seen[np.ix_(others, others)], noise[np.ix_(others, others)])
    np.testing.assert_array_equal(seen_noise(noise, VA), noise)
    peak = 1 / np.sqrt(np.linalg.det(2 * np.pi * seen))
    assert peak * np.sqrt(np.linalg.det(2 * np.pi * noise[np.ix_(others, others)])) == pytest.approx(1 / (2 * np.pi**2))
    compiled = [[kernels.noise_entry(noise, SR, i, j) for j in range(rows)] for i in range(rows)]
    np.testing.assert_allclose(compiled, seen, rtol=1e-15)


def test_broadcasts_landmarks_against_particles():
    rng = np.random.default_rng(5)
    state, landmark, kind = draw(rng, 4)
    particles = rng.normal(size=(7, 4)) + state[0]
    z = measure(particles, landmark[:, None], kind[:, None], BS_POSITION, speed=SPEED)
    by_state, by_landmark = jacobians(particles, landmark[:, None], kind[:, None], BS_POSITION, speed=SPEED)
    assert z.shape == (4, 7, 6) and by_state.shape == (4, 7, 6, 4) and by_landmark.shape == (4, 7, 6, 3)
    np.testing.assert_array_equal(z[2, 3], measure(particles[3], landmark[2], kind[2], BS_POSITION, speed=SPEED))


def test_doppler_is_minus_the_rate_of_the_path_length():
    state, landmark, kind = draw(np.random.default_rng(6), 200)
    dt = 1e-5
    later, earlier = state.copy(), state.copy()
    step = SPEED * dt * np.column_stack([np.cos(state[:, 2]), np.sin(state[:, 2])])
    later[:, :2] += step
    earlier[:, :2] -= step
    lengths = [measure(s, landmark, kind, BS_POSITION, speed=SPEED)[:, 0] for s in (later, earlier)]
    rate = (lengths[0] - lengths[1]) / (2 * dt)
    np.testing.assert_allclose(-rate, measure(state, landmark, kind, BS_POSITION, speed=SPEED)[:, 5], atol=1e-4)


@pytest.mark.parametrize("size", [4, 6])
@pytest.mark.parametrize("rows", [5, 6])
def test_compiled_twin_is_equal(size, rows):
    state, landmark, kind = draw(np.random.default_rng(7), 300, size)
    z = measure(state, landmark, kind, BS_POSITION, speed=SPEED, height=1.5)
    by_state, by_landmark = jacobians(state, landmark, kind, BS_POSITION, speed=SPEED, height=1.5)
    site = (*BS_POSITION, 1.5, SPEED)
    for i in range(len(state)):
        z_i, a_i, b_i, only_z = np.empty(rows), np.empty((rows, size)), np.empty((rows, 3)), np.empty(rows)
        kernels.linearize(state[i], landmark[i], kind[i], site, z_i, a_i, b_i)
        kernels.predict_measurement(state[i], landmark[i], kind[i], site, only_z)
        np.testing.assert_allclose(z_i, z[i, :rows], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(only_z, z[i, :rows], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(a_i, by_state[i, :rows], rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(b_i, by_landmark[i, :rows], rtol=1e-10, atol=1e-12)


def test_nothing_breaks_under_the_base_station():
    """At the pole the azimuths of the BS path are undefined: finite, and dropped by the compiled twin."""
    state = np.array([0.0, 0.0, 0.3, 300.0])
    by_state, by_landmark = jacobians(state, np.zeros(3), BS, BS_POSITION, speed=SPEED)
    assert np.isfinite(by_state).all() and np.isfinite(by_landmark).all()
    z, a, b, nu = np.empty(6), np.empty((6, 4)), np.empty((6, 3)), np.empty(6)
    kernels.linearize(state, np.zeros(3), BS, (*BS_POSITION, 0.0, SPEED), z, a, b)
    kernels.subtract(z + 1.0, z, b, a, nu)
    assert np.isfinite(a).all() and nu[1] == 0.0 and nu[3] == 0.0 and nu[0] == 1.0
