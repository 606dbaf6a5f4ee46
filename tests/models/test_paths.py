"""The law of every kind of landmark: derivatives, inverse, symmetries, the closed image method, the compiled twin."""

import numpy as np
import pytest

from dopslam.models import kernels
from dopslam.models.measurement import directions, jacobians, measure
from dopslam.models.paths import PATHS, incidence, mirror, paths, place, slopes, spreading_loss
from dopslam.records import Kind

ANCHOR = np.array([1.0, -2.0, 12.0])
LANDMARKS = [k for k in PATHS if not PATHS[k].known]


def drawn(kind, count=40, seed=0):
    """Receivers in the plane and landmarks whose paths exist."""
    rng = np.random.default_rng(seed)
    p = np.column_stack([rng.uniform(-40, 40, (4 * count, 2)), np.full(4 * count, 1.5)])
    x = rng.uniform([-60, -60, 2], [60, 60, 30], (4 * count, 3))
    there = paths(p, ANCHOR, x, kind).exists
    return p[there][:count], x[there][:count]


@pytest.mark.parametrize("kind", PATHS)
def test_slopes_are_differences(kind):
    p, x = drawn(kind)
    found = slopes(p, ANCHOR, x, kind)
    for axis, h in enumerate(1e-5 * np.eye(3)):
        for (low, high), length, departure in (
            (((p - h, x), (p + h, x)), found.length_by_p, found.departure_by_p),
            (((p, x - h), (p, x + h)), found.length_by_x, found.departure_by_x),
        ):
            a, b = (paths(at, ANCHOR, on, kind) for at, on in (low, high))
            np.testing.assert_allclose((b.length - a.length) / 2e-5, length[:, axis], atol=1e-7)
            np.testing.assert_allclose((b.departure - a.departure) / 2e-5, departure[:, :, axis], atol=1e-7)


@pytest.mark.parametrize("kind", LANDMARKS)
def test_the_place_of_a_path_is_where_it_came_from(kind):
    p, x = drawn(kind)
    path = paths(p, ANCHOR, x, kind)
    arrival = (x - p) / np.linalg.norm(x - p, axis=1, keepdims=True)
    norm = np.linalg.norm(path.departure, axis=1, keepdims=True)
    departure = path.departure / np.where(norm > 0, norm, 1.0)
    np.testing.assert_allclose(place(p, ANCHOR, path.length, arrival, departure, kind), x, atol=1e-8)
    untold = place(p, ANCHOR, path.length, arrival, np.zeros_like(p), kind)
    np.testing.assert_allclose(untold, x, atol=1e-8)


def test_a_reflection_is_the_image_method():
    """Over the plane that halves base station and virtual anchor: point, length and departure."""
    p, x = drawn(Kind.VA)
    point, t = incidence(p, x, ANCHOR)
    path = paths(p, ANCHOR, x, Kind.VA)
    normal = (x - ANCHOR) / np.linalg.norm(x - ANCHOR, axis=1, keepdims=True)
    offset = np.sum(normal * (x + ANCHOR) / 2, axis=1)
    np.testing.assert_allclose(np.sum(normal * point, axis=1), offset, atol=1e-9)
    np.testing.assert_allclose(mirror(ANCHOR, normal, offset), x, atol=1e-9)
    legs = np.linalg.norm(point - ANCHOR, axis=1) + np.linalg.norm(p - point, axis=1)
    np.testing.assert_allclose(path.length, legs, rtol=1e-12)
    leaving = (point - ANCHOR) / np.linalg.norm(point - ANCHOR, axis=1, keepdims=True)
    np.testing.assert_allclose(path.departure / path.length[:, None], leaving, atol=1e-10)
    assert np.all((t > 0) & (t < 1))
    behind = mirror(p, normal, offset)  # the receiver on the other side of the wall
    assert not paths(behind, ANCHOR, x, Kind.VA).exists.any()


@pytest.mark.parametrize("kind", PATHS)
def test_the_compiled_twin(kind):
    p, x = drawn(kind, seed=3)
    site = (*ANCHOR, 1.5, 7.0)
    z, twin = np.empty(6), (np.empty(6), np.empty((6, 4)), np.empty((6, 3)))
    for at, on in zip(p, x, strict=True):
        state = np.array([at[0], at[1], 0.4, 30.0])
        assert kernels.predict_measurement(state, on, int(kind), site, z)
        np.testing.assert_allclose(z, measure(state, on, kind, ANCHOR, speed=7.0, height=1.5), atol=1e-10)
        assert kernels.linearize(state, on, int(kind), site, *twin)
        by_state, by_landmark = jacobians(state, on, kind, ANCHOR, speed=7.0, height=1.5)
        np.testing.assert_allclose(twin[0], z, atol=1e-10)
        np.testing.assert_allclose(twin[1], by_state, atol=1e-10)
        np.testing.assert_allclose(twin[2], by_landmark, atol=1e-10)
        loss = kernels.log_spreading(int(kind), on, state, site)
        here = ANCHOR if PATHS[kind].known else on
        assert loss == pytest.approx(np.log(spreading_loss(kind, here, at, ANCHOR)))
        if PATHS[kind].known:
            continue
        born = np.empty(3)
        length, aoa, aod = z[0] - 30.0, directions(z[1] + 0.4, z[2]), directions(z[3], z[4])
        if kernels.starting_point(z, state, int(kind), site, born):
            np.testing.assert_allclose(born, place(at, ANCHOR, length, aoa, aod, kind), atol=1e-8)


def test_kinds_side_by_side():
    """A mixed set is what each kind gives alone."""
    p, x = drawn(Kind.VA, 4)
    kinds = np.array([Kind.BS, Kind.VA, Kind.SP, Kind.SR])
    together = measure(np.array([*p[0][:2], 0.3, 5.0]), x, kinds, ANCHOR, speed=2.0, height=1.5)
    for i, kind in enumerate(kinds):
        alone = measure(np.array([*p[0][:2], 0.3, 5.0]), x[i], kind, ANCHOR, speed=2.0, height=1.5)
        np.testing.assert_array_equal(together[i], alone)
