"""Image method against closed forms and finite differences."""

import numpy as np
import pytest

from dopslam.raytracing.images import (
    distance_to_triangles,
    isometry,
    mirror,
    mirror_images,
    reflected_paths,
    scattered_paths,
    triangle_planes,
    winding_number,
    zenith_azimuth,
)

BS = np.array([3.0, -7.0, 40.0])


def random_planes(rng, shape):
    normals = rng.normal(size=(*shape, 3))
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True), rng.uniform(50, 150, shape)


def receivers_and_velocities(rng, count):
    return rng.uniform(-40, 40, (count, 3)), rng.normal(size=(count, 3)) * 20


def test_mirror_is_an_involution_and_fixes_its_plane():
    rng = np.random.default_rng(1)
    normal, offset = random_planes(rng, (200,))
    points = rng.normal(size=(200, 3)) * 100
    image = mirror(points, normal, offset)
    np.testing.assert_allclose(mirror(image, normal, offset), points, atol=1e-11)
    np.testing.assert_allclose(np.sum(0.5 * (points + image) * normal, axis=1), offset, atol=1e-11)


def test_images_of_the_ring_road():
    normals = np.array([[[1.0, 0, 0]], [[0, 1.0, 0]], [[-1.0, 0, 0]], [[0, 1.0, 0]]])
    offsets = np.array([[100.0], [100.0], [100.0], [-100.0]])
    images = mirror_images([0, 0, 40], normals, offsets)[:, -1]
    np.testing.assert_array_equal(images, [[200, 0, 40], [0, 200, 40], [-200, 0, 40], [0, -200, 40]])


def test_line_of_sight():
    rng = np.random.default_rng(2)
    receivers, velocities = receivers_and_velocities(rng, 100)
    path = reflected_paths(BS, receivers, np.zeros((0, 3)), np.zeros(0))
    difference = BS - receivers
    length = np.sqrt(np.sum(difference**2, axis=1))
    np.testing.assert_allclose(path.length, length, rtol=1e-14)
    np.testing.assert_allclose(path.arrival, difference / length[:, None], atol=1e-14)
    np.testing.assert_allclose(path.departure, -difference / length[:, None], atol=1e-14)
    np.testing.assert_allclose(
        path.radial_velocity(velocities), np.sum(velocities * difference, axis=1) / length, rtol=1e-12
    )
    assert path.vertices.shape == (100, 0, 3)


def test_single_wall_against_the_closed_form_of_paper_a():
    """x_inc = x_VA + t(x_U − x_VA), t = ½‖a‖²/(aᵀw) (theory, §1)."""
    rng = np.random.default_rng(3)
    receivers, _ = receivers_and_velocities(rng, 300)
    normals, offsets = random_planes(rng, (300, 1))
    path = reflected_paths(BS, receivers, normals, offsets)
    anchor = mirror(BS, normals[:, 0], offsets[:, 0])
    a, w = BS - anchor, receivers - anchor
    t = 0.5 * np.sum(a * a, axis=1) / np.sum(a * w, axis=1)
    incidence = anchor + t[:, None] * w
    np.testing.assert_allclose(path.vertices[:, 0], incidence, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(path.length, np.linalg.norm(w, axis=1), rtol=1e-12)
    legs = np.linalg.norm(incidence - BS, axis=1) + np.linalg.norm(incidence - receivers, axis=1)
    np.testing.assert_allclose(path.length, legs, rtol=1e-9)
    departure = (incidence - BS) / np.linalg.norm(incidence - BS, axis=1)[:, None]
    np.testing.assert_allclose(path.departure, departure, atol=1e-9)


@pytest.mark.parametrize("depth", [1, 2, 3, 4])
def test_vertices_length_and_directions_belong_together(depth):
    """Every vertex lies on its plane, reflects specularly, and the polyline has the path's length and end
    directions.
    """
    rng = np.random.default_rng(depth)
    receivers, _ = receivers_and_velocities(rng, 200)
    # a convex room: planes around the origin, visited in random order without immediate repetition
    room_n, room_d = np.vstack([np.eye(3), -np.eye(3)]), np.array([100.0, 90, 80, 70, 60, 50])
    order = np.array([rng.permutation(6)[:depth] for _ in range(200)])
    normals, offsets = room_n[order], room_d[order]
    source = np.array([3.0, -7.0, 30.0])
    path = reflected_paths(source, receivers, normals, offsets)
    np.testing.assert_allclose(np.sum(path.vertices * normals, axis=-1), offsets, atol=1e-9)
    corners = np.concatenate([np.broadcast_to(source, (200, 1, 3)), path.vertices, receivers[:, None]], axis=1)
    legs = np.diff(corners, axis=1)
    # Only sequences that light could follow: the unfolded line meets the planes in this order.
    forward = np.all(np.sum(legs[:, 1:] * legs[:, 1:], axis=-1) > 0, axis=1)
    unfolded = np.abs(np.linalg.norm(legs, axis=-1).sum(axis=1) - path.length) < 1e-6
    assert np.sum(forward & unfolded) > 20
    legs, path_rows = legs[unfolded], np.flatnonzero(unfolded)
    unit = legs / np.linalg.norm(legs, axis=-1, keepdims=True)
    np.testing.assert_allclose(unit[:, 0], path.departure[path_rows], atol=1e-9)
    np.testing.assert_allclose(-unit[:, -1], path.arrival[path_rows], atol=1e-9)
    for i in range(depth):
        n = normals[path_rows, i]
        bounced = unit[:, i] - 2 * np.sum(unit[:, i] * n, axis=1)[:, None] * n
        np.testing.assert_allclose(unit[:, i + 1], bounced, atol=1e-9)


def moved_length(kind, receivers, velocities, dt, geometry):
    moved = receivers + dt * velocities
    return (reflected_paths if kind == "reflected" else scattered_paths)(BS, moved, *geometry).length


@pytest.mark.parametrize("kind", ["reflected", "scattered"])
def test_doppler_is_the_negative_rate_of_the_length(kind):
    rng = np.random.default_rng(5)
    receivers, velocities = receivers_and_velocities(rng, 300)
    geometry = random_planes(rng, (300, 2)) if kind == "reflected" else (rng.uniform(50, 90, (300, 3)),)
    path = (reflected_paths if kind == "reflected" else scattered_paths)(BS, receivers, *geometry)
    h = 1e-4
    rate = (
        moved_length(kind, receivers, velocities, -2 * h, geometry)
        - 8 * moved_length(kind, receivers, velocities, -h, geometry)
        + 8 * moved_length(kind, receivers, velocities, h, geometry)
        - moved_length(kind, receivers, velocities, 2 * h, geometry)
    ) / (12 * h)
    np.testing.assert_allclose(path.radial_velocity(velocities), -rate, rtol=1e-8, atol=1e-7)


def test_scatter_path_is_two_legs():
    rng = np.random.default_rng(6)
    receivers, points = rng.normal(size=(2, 100, 3)) * 50
    path = scattered_paths(BS, receivers, points)
    first, second = np.linalg.norm(points - BS, axis=1), np.linalg.norm(points - receivers, axis=1)
    np.testing.assert_allclose(path.length, first + second, rtol=1e-14)
    np.testing.assert_allclose(path.arrival * second[:, None], points - receivers, atol=1e-12)
    np.testing.assert_allclose(path.departure * first[:, None], points - BS, atol=1e-12)
    np.testing.assert_array_equal(path.vertices[:, 0], points)


def test_rigid_motion_moves_everything_along():
    rng = np.random.default_rng(7)
    receivers, velocities = receivers_and_velocities(rng, 50)
    normals, offsets = random_planes(rng, (50, 3))
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    shift = rng.normal(size=3) * 10
    before = reflected_paths(BS, receivers, normals, offsets)
    turned = normals @ rotation.T
    after = reflected_paths(
        BS @ rotation.T + shift,
        receivers @ rotation.T + shift,
        turned,
        offsets + np.sum(turned * shift, axis=-1),
    )
    np.testing.assert_allclose(after.length, before.length, rtol=1e-12)
    np.testing.assert_allclose(after.arrival, before.arrival @ rotation.T, atol=1e-12)
    np.testing.assert_allclose(after.departure, before.departure @ rotation.T, atol=1e-12)
    np.testing.assert_allclose(
        after.radial_velocity(velocities @ rotation.T), before.radial_velocity(velocities), atol=1e-11
    )


def test_isometry_is_the_composite_reflection():
    rng = np.random.default_rng(8)
    normals, offsets = random_planes(rng, (3,))
    points = rng.normal(size=(20, 3)) * 30
    matrix, translation = isometry(normals, offsets)
    expected = points
    for n, d in zip(normals, offsets, strict=True):
        expected = mirror(expected, n, d)
    np.testing.assert_allclose(points @ matrix.T + translation, expected, atol=1e-10)


def test_zenith_and_azimuth_invert():
    rng = np.random.default_rng(9)
    directions = rng.normal(size=(100, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    theta, phi = zenith_azimuth(directions)
    again = np.column_stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    np.testing.assert_allclose(again, directions, atol=1e-15)
    theta, phi = zenith_azimuth([[0, 0, 1.0], [0, 0, -1.0], [0, 1e-12, 1.0]])
    np.testing.assert_allclose(theta, [0, np.pi, 1e-12], rtol=1e-12)
    np.testing.assert_allclose(phi, [0, 0, np.pi / 2])


def cube(half=1.0):
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return np.array([[corners[q[i]] for i in t] for q in quads for t in ((0, 1, 2), (0, 2, 3))])


def test_winding_number_of_a_cube():
    points = np.array([[0, 0, 0], [0.9, -0.9, 0.9], [1.1, 0, 0], [5, 5, 5], [0.5, 0.5, -0.999]])
    np.testing.assert_allclose(np.abs(winding_number(points, cube())), [1, 1, 0, 0, 1], atol=1e-12)
    open_below = cube()[2:]  # one face missing: still tells the sides
    first_normal = triangle_planes(cube()[:1])[0][0]
    inner = np.abs(winding_number(np.array([[0.0, 0, 0], -0.9 * first_normal]), open_below))
    assert np.all(inner > 0.5)


def test_distance_to_triangles():
    points = np.array([[0.2, 0.2, 0.7], [-3.0, 0.5, 0], [2.0, 0, 0], [0.2, 0.3, 0]])
    triangle = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    np.testing.assert_allclose(distance_to_triangles(points, triangle)[:, 0], [0.7, 3.0, 1.0, 0.0], atol=1e-15)
    rng = np.random.default_rng(10)
    triangles, points = rng.normal(size=(5, 3, 3)), rng.normal(size=(40, 3)) * 2
    u, v = rng.uniform(size=(2, 200_000))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    for i, t in enumerate(triangles):
        samples = t[0] + u[:, None] * (t[1] - t[0]) + v[:, None] * (t[2] - t[0])
        nearest = np.array([np.linalg.norm(samples - p, axis=1).min() for p in points])
        exact = distance_to_triangles(points, triangles[i : i + 1])[:, 0]
        assert np.all(exact <= nearest + 1e-12)
        np.testing.assert_allclose(exact, nearest, atol=0.02)
