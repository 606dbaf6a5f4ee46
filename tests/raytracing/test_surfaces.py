"""Planes, names, outlines and position checks of triangle meshes; nothing is traced here."""

import numpy as np
import pytest

from dopslam.errors import SceneError
from dopslam.raytracing.landmarks import Naming, landmarks_of
from dopslam.raytracing.surfaces import build_surfaces, check_positions, floor_plan, solids
from dopslam.records import Kind


def quad(a, b, c, d):
    return np.array([[a, b, c], [a, c, d]], dtype=float)


def box(low, high):
    """A closed box as 12 triangles with outward normals."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    p = {
        (i, j, k): (x, y, z)
        for i, x in enumerate((x0, x1))
        for j, y in enumerate((y0, y1))
        for k, z in enumerate((z0, z1))
    }
    faces = [
        [(0, 0, 0), (0, 0, 1), (0, 1, 1), (0, 1, 0)], [(1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1)],
        [(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)], [(0, 1, 0), (0, 1, 1), (1, 1, 1), (1, 1, 0)],
        [(0, 0, 0), (0, 1, 0), (1, 1, 0), (1, 0, 0)], [(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)],
    ]  # fmt: skip
    return np.concatenate([quad(*(p[v] for v in face)) for face in faces])


ROOM = {
    "wall_east": quad((100, -100, -5), (100, 100, -5), (100, 100, 60), (100, -100, 60)),
    "wall_north": quad((-100, 100, -5), (100, 100, -5), (100, 100, 60), (-100, 100, 60)),
    "wall_west": quad((-100, -100, -5), (-100, 100, -5), (-100, 100, 60), (-100, -100, 60)),
    "wall_south": quad((-100, -100, -5), (100, -100, -5), (100, -100, 60), (-100, -100, 60)),
}


def test_walls_become_planes_with_the_objects_names():
    surfaces = build_surfaces(ROOM)
    assert surfaces.plane_name == ("wall_east", "wall_north", "wall_west", "wall_south")
    np.testing.assert_array_equal(np.abs(surfaces.plane_normal).argmax(axis=1), [0, 1, 0, 1])
    points = surfaces.triangles.mean(axis=1)
    residual = np.sum(points * surfaces.plane_normal[surfaces.triangle_plane], axis=1)
    np.testing.assert_allclose(residual, surfaces.plane_offset[surfaces.triangle_plane], atol=1e-12)


def test_faces_of_a_box_are_named_by_their_side():
    surfaces = build_surfaces({"house": box((0, 0, 0), (4, 6, 9))})
    assert sorted(surfaces.plane_name) == sorted(
        f"house.{side}" for side in ("east", "west", "north", "south", "top", "bottom")
    )
    east = surfaces.plane_name.index("house.east")
    np.testing.assert_allclose(surfaces.plane_normal[east] * surfaces.plane_offset[east], [4, 0, 0])


@pytest.mark.parametrize("gap, planes", [(0.0, 9), (0.002, 9), (0.05, 12)])
def test_flush_facades_share_a_plane(gap, planes):
    """North, south and floor planes are shared by two neighbors; the tolerance is 5 mm."""
    low, high = (10, 0 + gap, 0 + gap), (14, 6 + gap, 9)
    surfaces = build_surfaces({"a": box((0, 0, 0), (4, 6, 8)), "b": box(low, high)})
    assert len(surfaces.plane_offset) == planes
    if planes == 9:
        assert "b.north+a.north" in surfaces.plane_name


def test_a_fine_mesh_in_any_attitude_is_one_plane():
    rng = np.random.default_rng(1)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    grid = [
        quad((i, j, 0), (i + 1, j, 0), (i + 1, j + 1, 0), (i, j + 1, 0)) for i in range(30) for j in range(30)
    ]  # fmt: skip
    mesh = (np.concatenate(grid) @ rotation.T + [50, -80, 20]).astype(np.float32)
    surfaces = build_surfaces({"tilted": mesh})
    assert surfaces.plane_name == ("tilted",)
    np.testing.assert_allclose(np.abs(surfaces.plane_normal[0] @ rotation[:, 2]), 1.0, atol=1e-9)


def test_degenerate_triangles_are_on_no_plane():
    surfaces = build_surfaces({"a": np.concatenate([ROOM["wall_east"], np.ones((1, 3, 3))])})
    assert surfaces.triangle_plane.tolist() == [0, 0, -1]


def test_both_ways_around_a_right_angled_corner_are_one_landmark():
    surfaces = build_surfaces(ROOM)
    naming = Naming(surfaces)
    east, north, west, _ = range(4)
    assert naming.canonical((north, east)) == naming.canonical((east, north)) == (east, north)
    assert naming.canonical((west, east)) == (west, east) != naming.canonical((east, west))
    sequences = {naming.canonical(s) for s in [(), (east,), (north, east), (west, east), (east, west)]}
    marks, rows = landmarks_of(surfaces, np.array([0.0, 0, 40]), sequences, naming, ("lamp",), np.array([[1.0, 2, 3]]))
    assert marks.name.tolist() == [
        "BS", "VA wall_east", "VA wall_east > wall_north", "VA wall_east > wall_west",
        "VA wall_west > wall_east", "SP lamp",
    ]  # fmt: skip
    expected = [[0, 0, 40], [200, 0, 40], [200, 200, 40], [-400, 0, 40], [400, 0, 40], [1, 2, 3]]
    np.testing.assert_allclose(marks.position, expected)
    assert marks.kind.tolist() == [Kind.BS, Kind.VA, Kind.VA, Kind.VA, Kind.VA, Kind.SP]
    assert marks.order.tolist() == [0, 1, 2, 2, 2, 1]
    assert rows[(west, east)] == 4


def test_an_oblique_corner_keeps_its_two_orders_apart():
    slanted = quad((0, 100, 0), (80, 160, 0), (80, 160, 50), (0, 100, 50))
    naming = Naming(build_surfaces({"a": ROOM["wall_east"], "b": slanted}))
    assert naming.canonical((0, 1)) != naming.canonical((1, 0))


HOUSE = build_surfaces(
    {
        "house": box((0, 0, 0), (10, 8, 6)),
        "floor": quad((-50, -50, 0), (50, -50, 0), (50, 50, 0), (-50, 50, 0)),
    }
)


@pytest.mark.parametrize(
    "position, message",
    [
        (
            [5, 4, 3],
            r"the receiver at step at \(5.000, 4.000, 3.000\) m lies inside object 'house'; move it out",
        ),
        ([5, 8.004, 3], "closer than 1 cm to a surface of object 'house'"),
        ([20, 20, 0.005], "closer than 1 cm to a surface of object 'floor'"),
        ([np.nan, 0, 0], "give finite numbers"),
    ],
)
def test_bad_positions_are_refused(position, message):
    with pytest.raises(SceneError, match=message):
        check_positions(
            HOUSE, {"the receiver at step": np.array(position), "the base station": np.array([20.0, 0, 20])}
        )


def test_the_step_is_named():
    track = np.array([[-5.0, 4, 3], [5, 4, 3], [15, 4, 3]])
    with pytest.raises(SceneError, match="the receiver at step 1 at"):
        check_positions(HOUSE, {"the receiver at step": track, "the base station": np.array([20.0, 0, 20])})


def test_good_positions_pass():
    check_positions(
        HOUSE, {"a": np.array([[20.0, 0, 0.02], [10.011, 4, 3], [5, 4, 6.02]]), "b": np.array([5, 4, 30.0])}
    )


def test_a_room_around_everything_is_no_obstacle():
    room = build_surfaces({"room": box((0, 0, 0), (10, 8, 6))})
    check_positions(room, {"bs": np.array([5.0, 4, 5]), "ue": np.array([[1.0, 1, 1], [9, 7, 1]])})
    with pytest.raises(SceneError, match="inside object 'room'"):
        check_positions(room, {"bs": np.array([5.0, 4, 5]), "ue": np.array([[1.0, 1, 1], [19, 7, 1]])})


def test_floor_plan():
    outlines = floor_plan(HOUSE, height=1.5)
    assert [name for name, _ in outlines] == ["house"]
    line = outlines[0][1]
    np.testing.assert_array_equal(line[0], line[-1])
    assert {tuple(p) for p in line.tolist()} == {(0, 0), (10, 0), (10, 8), (0, 8)}
    above = floor_plan(HOUSE, height=20.0)[0][1]
    assert {tuple(p) for p in above.tolist()} == {(0, 0), (10, 0), (10, 8), (0, 8)}
    walls = dict(floor_plan(build_surfaces(ROOM), height=0.0))
    assert sorted(map(tuple, walls["wall_east"].tolist())) == [(100, -100), (100, 100)]
    high = dict(floor_plan(build_surfaces(ROOM), height=100.0))
    assert sorted(map(tuple, high["wall_east"].tolist())) == [(100, -100), (100, 100)]


def test_small_parts_of_a_plane_are_not_named():
    wall = quad((0, 0, 0), (20, 0, 0), (20, 0, 9), (0, 0, 9))
    window = quad((2, 0.001, 2), (4, 0.001, 2), (4, 0.001, 4), (2, 0.001, 4))
    assert build_surfaces({"window": window, "wall": wall}).plane_name == ("wall",)


def test_what_is_solid_and_what_reaches_around_everything():
    scene = build_surfaces({"crate": box((2, 2, 0), (3, 4, 1)), "hall": box((0, 0, 0), (10, 10, 5))})
    points = np.array([[2.5, 3.0, 0.5], [2.5, 3.0, 1.5], [5.0, 5.0, 1.0], [12.0, 5.0, 1.0]])
    assert solids(scene)(points).tolist() == [True, False, False, False]
