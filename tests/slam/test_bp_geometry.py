"""Directions, chords, likelihood rows and births of BP SLAM against finite differences and closed forms."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from dopslam.evaluate.belief import tangent_jacobian
from dopslam.models.measurement import measure
from dopslam.slam.belief import geometry, kernels
from dopslam.slam.belief.births import birth, order_for
from dopslam.slam.belief.evidence import gaussian_evidence
from dopslam.slam.belief.records import Form

FORMS = [Form.LOS, Form.VA, Form.PS, Form.VA_AOD]
ANCHOR = np.array([1.0, -2.0, 3.0])


def points(seed, spatial=True):
    rng = np.random.default_rng(seed)
    p, q = rng.normal(0, 10, (2, 3))
    if not spatial:
        p[2] = q[2] = ANCHOR[2]
    return p, q


@pytest.mark.parametrize("form", FORMS)
def test_gradients_are_central_differences(form):
    step = 1e-5
    for seed in range(10):
        p, q = points(seed)
        q = ANCHOR if form == Form.LOS else q
        by_q, by_p = geometry.gradients(form, p, q, ANCHOR)
        for axis in range(3):
            d = step * np.eye(3)[axis]

            def stacked(p, q):
                length, e, t = geometry.predict(form, p, q, ANCHOR)
                return np.concatenate([[length], e, t])

            np.testing.assert_allclose(by_p[:, axis], (stacked(p + d, q) - stacked(p - d, q)) / (2 * step), atol=1e-6)
            if form != Form.LOS:
                np.testing.assert_allclose(
                    by_q[:, axis], (stacked(p, q + d) - stacked(p, q - d)) / (2 * step), atol=1e-6
                )


@pytest.mark.parametrize("form,kind", [(Form.LOS, 0), (Form.VA_AOD, 1), (Form.PS, 2)])
def test_same_physics_as_the_kalman_filters(form, kind):
    """The model of paper A with the receiver at height 0: one physics for both filters."""
    for seed in range(20):
        p, q = points(seed)
        p[2] = 0.0
        state = np.array([p[0], p[1], 0.7, 2.5])
        expected = measure(state, q, kind, ANCHOR)
        q = ANCHOR if form == Form.LOS else q
        length, e, t = geometry.predict(form, p, q, ANCHOR)
        np.testing.assert_allclose(length + 2.5, expected[0], rtol=1e-12)
        arrival = geometry.unit_vector(expected[1] + 0.7, expected[2])
        np.testing.assert_allclose(e, arrival, atol=1e-9)
        np.testing.assert_allclose(t, geometry.unit_vector(expected[3], expected[4]), atol=1e-9)


def test_chord_length_and_small_angles():
    rng = np.random.default_rng(0)
    a, b = geometry.unit_vector(rng.uniform(-3, 3, (2, 50)), rng.uniform(-1.5, 1.5, (2, 50)))
    np.testing.assert_allclose(
        np.linalg.norm(geometry.chord(a, b, 2), axis=-1), np.linalg.norm(a - b, axis=-1), rtol=1e-9
    )
    opposite = geometry.chord(geometry.unit_vector(3.1), geometry.unit_vector(0.0), 1)
    assert opposite[0] == pytest.approx(2 * np.sin(1.55), rel=1e-9)  # grows monotonically up to 180°


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("count", [1, 2])
def test_likelihood_row_is_the_linear_gaussian_evidence(form, count):
    """ln N(z; h, H P Hᵀ + R) by sequential scalar updates, correlated R, against scipy."""
    rng = np.random.default_rng(5)
    p, q = points(11, spatial=count == 2)
    q = ANCHOR if form == Form.LOS else q
    heading = 0.4
    n = 1 + 2 * count
    root = rng.normal(0, 0.05, (n, n)) + 0.1 * np.eye(n)
    noise = root @ root.T
    cov = np.zeros((3, 3))
    if form != Form.LOS:
        axes = 3 if count == 2 else 2
        r = rng.normal(0, 0.3, (axes, axes))
        cov[:axes, :axes] = r @ r.T
    length, e, t = geometry.predict(form, p, q, ANCHOR)
    z_a = geometry.turned(e, np.array(-heading)) + 0.02 * rng.normal(size=3)
    z_t = t + 0.02 * rng.normal(size=3)
    if count == 1:
        z_a[2] = z_t[2] = 0.0
    z_a, z_t = z_a / np.linalg.norm(z_a), z_t / np.linalg.norm(z_t)
    agent = np.array([[*p, 0.3, np.cos(heading), np.sin(heading)]])
    got = kernels.row_likelihoods(
        agent, ANCHOR, count, np.array([int(form)]), q[None], cov[None], np.array([-1e3]), np.array([0, 1]),
        np.array([0]), np.ones(1), np.zeros(1), np.array([length + 0.35]), z_a[None], z_t[None],
        np.linalg.inv(np.linalg.cholesky(noise))[None], 1.0,
    )[0, 0]  # fmt: skip
    used = 1 + count if form == Form.VA else n
    _, by_q, _ = tangent_jacobian(form, p, heading, q, ANCHOR, count)
    world = geometry.turned(z_a, np.array(heading))
    residual = np.concatenate([[0.05], geometry.chord(world, e, count), geometry.chord(z_t, t, count)])[:used]
    total = by_q[:used] @ cov @ by_q[:used].T + noise[:used, :used]
    assert got == pytest.approx(multivariate_normal.logpdf(residual, np.zeros(used), total), rel=1e-9)


def _birth(form, count, p, heading, distance, z_a, z_t, noise):
    order = order_for(count, form)
    permuted = np.ascontiguousarray(noise[np.ix_(order, order)])
    agent = np.array([[*p, 0.0, np.cos(heading), np.sin(heading)]])
    return birth(
        int(form), count, agent, np.ones(1), ANCHOR, distance, z_a, z_t, permuted,
        np.linalg.inv(np.linalg.cholesky(permuted)), order,
    )  # fmt: skip


@pytest.mark.parametrize("form", [Form.VA, Form.PS, Form.VA_AOD])
def test_birth_evidence_is_the_integral_over_the_plane(form):
    """∫ N(z; h(q), R) dq by a fine grid, and the posterior's mean and covariance."""
    p, q, heading = np.array([4.0, 1.0, 3.0]), np.array([9.0, 8.0, 3.0]), 0.3
    length, e, t = geometry.predict(form, p, q, ANCHOR)
    noise = np.diag([0.02, 0.004, 0.006]) ** 2
    noise[0, 1] = noise[1, 0] = 0.5 * 0.02 * 0.004
    z_a = geometry.turned(e, np.array(-heading + 0.003))
    z_t = geometry.turned(t, np.array(0.004))
    log_evidence, mean, cov = _birth(form, 1, p, heading, length + 0.01, z_a, z_t, noise)
    step = 0.004
    x, y = np.meshgrid(np.arange(-0.4, 0.4, step), np.arange(-0.4, 0.4, step))
    grid = q + np.stack([x, y, 0 * x], axis=-1)
    lengths, es, ts = geometry.predict(form, p, grid, ANCHOR)
    world = geometry.turned(z_a, np.array(heading))
    residual = np.concatenate(
        [(length + 0.01 - lengths)[..., None], geometry.chord(world, es, 1), geometry.chord(z_t, ts, 1)],
        axis=-1,
    )
    used = 2 if form == Form.VA else 3
    density = multivariate_normal.pdf(residual[..., :used], np.zeros(used), noise[:used, :used])
    unexplained = 2 * np.pi if form == Form.VA else 1.0
    integral = density.sum() * step**2 / unexplained
    assert np.exp(log_evidence) == pytest.approx(integral, rel=0.02)
    weights = density / density.sum()
    expected = np.einsum("xy,xya->a", weights, grid)
    np.testing.assert_allclose(mean, expected, atol=3e-3)
    spread = np.einsum("xy,xya,xyb->ab", weights, grid - expected, grid - expected)
    np.testing.assert_allclose(cov[:2, :2], spread[:2, :2], rtol=0.05, atol=1e-5)


def test_type_odds_at_birth():
    """A virtual anchor and its scatterer twin, the incidence point: odds D²(1 + cos α)/‖x_SP − x_U‖² (theory §4)."""
    p, va = np.array([4.0, 1.0, 0.0]), np.array([9.0, 20.0, 5.0])
    length, e, t = geometry.predict(Form.VA_AOD, p, va, ANCHOR)
    middle, normal = 0.5 * (ANCHOR + va), va - ANCHOR
    twin = p + e * ((middle - p) @ normal) / (e @ normal)
    assert geometry.predict(Form.PS, p, twin, ANCHOR)[0] == pytest.approx(length, rel=1e-12)
    noise = np.diag([1e-3, 1e-4, 1e-4, 1e-4, 1e-4]) ** 2
    values = {form: _birth(form, 2, p, 0.0, length, e, t, noise)[0] for form in (Form.VA_AOD, Form.PS)}
    cosine = e @ (twin - ANCHOR) / np.linalg.norm(twin - ANCHOR)
    odds = length**2 * (1 + cosine) / np.sum((twin - p) ** 2)
    assert np.exp(values[Form.VA_AOD] - values[Form.PS]) == pytest.approx(odds, rel=1e-3)


def test_evidence_moves_with_the_world():
    """Rotating and shifting agent, anchor, features and AODs changes no evidence and no likelihood."""
    rng = np.random.default_rng(7)
    agent = np.column_stack([rng.normal(0, 0.1, (40, 2)), np.zeros((40, 2)), np.full(40, 0.2)])
    heading = rng.normal(0.2, 0.05, 40)
    form = np.array([0, 1, 2, 3])
    mean = np.array([ANCHOR * [1, 1, 0], [5.0, 6, 0], [5, -3, 0], [-6, 4, 0]])
    cov = np.tile(np.diag([0.02, 0.03, 0.0]), (4, 1, 1)) * (form > 0)[:, None, None]
    z_a = geometry.unit_vector(rng.uniform(-3, 3, 3))
    z_t = geometry.unit_vector(rng.uniform(-3, 3, 3))
    distance, noise = np.array([5.0, 7.0, 9.0]), np.tile(np.diag([1.0, 0.5, 0.7]) ** 2, (3, 1, 1))

    def evidence(angle, shift):
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        moved = np.column_stack(
            [agent[:, :3] @ turn.T + shift, agent[:, 3], np.cos(heading + angle), np.sin(heading + angle)]
        )
        anchor = turn @ (ANCHOR * [1, 1, 0]) + shift
        return gaussian_evidence(
            moved, np.full(40, 1 / 40), anchor, 1, form, mean @ turn.T + shift, turn @ cov @ turn.T, distance, z_a,
            z_t @ turn.T, noise, np.ones((4, 3)),
        )  # fmt: skip

    np.testing.assert_allclose(evidence(0.0, np.zeros(3)), evidence(1.1, np.array([3.0, -8.0, 0.0])), rtol=1e-9)
