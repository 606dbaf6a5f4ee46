"""The tracer against closed forms, radar and Friis equations, and an enumeration that loses no path."""

import os
import subprocess
import sys

import numpy as np
import pytest

from dopslam.errors import SceneError
from dopslam.raytracing import ScatterPoints, SceneSource, Tracer, TraceSettings, join, load_scene, trace
from dopslam.raytracing.images import zenith_azimuth
from dopslam.records import SPEED_OF_LIGHT, Kind, same

pytestmark = pytest.mark.rt

CARRIER = 28e9
WAVELENGTH = SPEED_OF_LIGHT / CARRIER
BS = np.array([0.0, 0.0, 40.0])
ANCHORS = {"east": (200, 0, 40), "north": (0, 200, 40), "south": (0, -200, 40), "west": (-200, 0, 40)}
POINTS = ScatterPoints(
    ("east", "north", "west", "south"), [[99, 0, 10], [0, 99, 10], [-99, 0, 10], [0, -99, 10]],
    [100.0, 10.0, 1.0, 50.0], [0.0, 0.5, -2.0, 3.0],
)  # fmt: skip


@pytest.fixture(scope="module")
def ring(ring_xml, ring_track):
    return trace(SceneSource(ring_xml), CARRIER, BS, *ring_track, POINTS)


def rows_of(landmarks, paths, name):
    return np.flatnonzero(paths.landmark == landmarks.name.tolist().index(name))


def test_ring_road_has_nine_landmarks_at_every_step(ring):
    landmarks, paths = ring
    assert landmarks.name.tolist() == [
        "BS", "VA wall_east", "VA wall_north", "VA wall_south", "VA wall_west", "SP east", "SP north",
        "SP west", "SP south",
    ]  # fmt: skip
    assert landmarks.kind.tolist() == [Kind.BS] + [Kind.VA] * 4 + [Kind.SP] * 4
    assert landmarks.order.tolist() == [0] + [1] * 8
    np.testing.assert_array_equal(np.diff(paths.offsets), 9)
    np.testing.assert_array_equal(paths.landmark.reshape(40, 9), np.tile(np.arange(9), (40, 1)))
    np.testing.assert_allclose(landmarks.position[1:5], [ANCHORS[n] for n in sorted(ANCHORS)], atol=1e-9)


def test_ring_road_geometry_is_exact(ring, ring_track):
    """Delay, angles and Doppler of every path against the measurement model of paper A, to 1e-9."""
    landmarks, paths = ring
    positions, velocities = ring_track
    for name, kind, mark in zip(landmarks.name, landmarks.kind, landmarks.position, strict=True):
        rows = rows_of(landmarks, paths, name)
        arrival = mark - positions
        distance = np.linalg.norm(arrival, axis=1)
        departure = {Kind.BS: positions - BS, Kind.SP: mark - BS + 0 * positions}.get(kind)
        if kind == Kind.VA:
            a, w = BS - mark, positions - mark
            t = 0.5 * (a @ a) / (w @ a)
            departure = mark + t[:, None] * w - BS
            np.testing.assert_allclose(paths.vertices[paths.vertex_offsets[rows]], departure + BS, atol=1e-9)
        length = distance + (np.linalg.norm(mark - BS) if kind == Kind.SP else 0.0)
        np.testing.assert_allclose(paths.tau[rows] * SPEED_OF_LIGHT, length, rtol=1e-12)
        d = np.sum(velocities * arrival, axis=1) / distance
        np.testing.assert_allclose(paths.doppler[rows] * WAVELENGTH, d, rtol=1e-9, atol=1e-12)
        for got, expected in zip(
            (paths.theta_r[rows], paths.phi_r[rows], paths.theta_t[rows], paths.phi_t[rows]),
            (*zenith_azimuth(arrival), *zenith_azimuth(departure)),
            strict=True,
        ):
            np.testing.assert_allclose(np.angle(np.exp(1j * (got - expected))), 0, atol=1e-9)
    np.testing.assert_array_equal(np.diff(paths.vertex_offsets), (landmarks.kind != Kind.BS)[paths.landmark])


def test_gain_of_the_line_of_sight_is_friis(ring):
    landmarks, paths = ring
    rows = rows_of(landmarks, paths, "BS")
    friis = WAVELENGTH / (4 * np.pi * SPEED_OF_LIGHT * paths.tau[rows])
    np.testing.assert_allclose(np.abs(paths.a[rows]), friis, rtol=1e-5)


def test_gain_of_scatter_points_is_the_radar_equation(ring, ring_track):
    """|a| = λ√σ / ((4π)^{3/2} d₁ d₂) times the polarization projected over both legs (1 for vertical over
    flat legs).
    """
    landmarks, paths = ring
    for i, name in enumerate(POINTS.names):
        rows = rows_of(landmarks, paths, f"SP {name}")
        second = np.linalg.norm(POINTS.positions[i] - ring_track[0], axis=1)
        first = np.linalg.norm(POINTS.positions[i] - BS)
        radar = WAVELENGTH * np.sqrt(POINTS.rcs[i]) / ((4 * np.pi) ** 1.5 * first * second)
        np.testing.assert_allclose(np.abs(paths.a[rows]), radar, rtol=1e-5)


def test_cross_section_and_phase_scale_the_gain(ring, ring_xml, ring_track):
    landmarks, paths = ring
    unit = ScatterPoints(POINTS.names, POINTS.positions)
    _, plain = trace(SceneSource(ring_xml), CARRIER, BS, *ring_track, unit)
    for i, name in enumerate(POINTS.names):
        rows = rows_of(landmarks, paths, f"SP {name}")
        factor = np.sqrt(POINTS.rcs[i]) * np.exp(1j * POINTS.phases[i])
        np.testing.assert_allclose(paths.a[rows], plain.a[rows] * factor, rtol=1e-12)


def test_walls_reflect_less_than_everything(ring):
    landmarks, paths = ring
    for name in ANCHORS:
        rows = rows_of(landmarks, paths, f"VA wall_{name}")
        free = WAVELENGTH / (4 * np.pi * SPEED_OF_LIGHT * paths.tau[rows])
        loss = 20 * np.log10(np.abs(paths.a[rows]) / free)
        assert np.all((loss < 0) & (loss > -25))


@pytest.mark.parametrize("depth, samples", [(1, 2_000), (2, 20_000), (3, 20_000)])
def test_no_path_is_lost_between_convex_walls(ring_xml, expected_paths, depth, samples):
    rng = np.random.default_rng(depth)
    receivers = np.column_stack([rng.uniform(-90, 90, (150, 2)), rng.uniform(-1, 5, 150)])
    tracer = Tracer(SceneSource(ring_xml), CARRIER, BS, None, TraceSettings(max_depth=depth, samples=samples))
    _check_complete(tracer, receivers, depth, expected_paths)


def test_no_path_is_lost_in_the_street_canyon(expected_paths):
    receivers = np.column_stack([np.linspace(-25, 55, 41), np.full(41, 0.5), np.full(41, 1.5)])
    tracer = Tracer(SceneSource("simple_street_canyon"), CARRIER, [-20.0, -6.0, 12.0], None, TraceSettings(max_depth=2))
    _check_complete(tracer, receivers, 2, expected_paths)


def _check_complete(tracer, receivers, depth, expected_paths):
    expected = expected_paths(tracer.surfaces, tracer.bs_position, receivers, depth)
    traced = join(list(tracer.chunks(receivers)))
    names = {
        (row, "BS" if not planes else tracer.naming.name(tracer.naming.canonical(planes))) for row, planes in expected
    }
    owner = np.repeat(np.arange(len(receivers)), np.diff(traced.paths.offsets))
    found = {(int(r), traced.landmarks.name[i]) for r, i in zip(owner, traced.paths.landmark, strict=True)}
    assert found == names
    assert len(traced.paths.a) == len(expected)


def test_second_order_anchors_are_named_by_their_walls(ring_xml, ring_track):
    landmarks, paths = trace(SceneSource(ring_xml), CARRIER, BS, *ring_track, None, TraceSettings(max_depth=2))
    double = landmarks.order == 2
    assert {n for n in landmarks.name[double]} == {
        "VA wall_east > wall_north", "VA wall_east > wall_south", "VA wall_north > wall_west",
        "VA wall_south > wall_west",
        "VA wall_east > wall_west", "VA wall_west > wall_east", "VA wall_north > wall_south",
        "VA wall_south > wall_north",
    }  # fmt: skip
    corner = landmarks.name.tolist().index("VA wall_east > wall_north")
    np.testing.assert_allclose(landmarks.position[corner], [200, 200, 40], atol=1e-9)
    rows = np.flatnonzero(paths.landmark == corner)
    np.testing.assert_array_equal(np.diff(paths.vertex_offsets)[rows], 2)


def test_chunks_and_repetition_change_nothing(ring_xml, ring_track, ring):
    """Bitwise the same for any chunk size, and again for the same seed."""
    small = Tracer(SceneSource(ring_xml), CARRIER, BS, POINTS, TraceSettings(chunk=7))
    chunks = list(small.chunks(*ring_track))
    assert [c.paths.steps for c in chunks] == [7, 7, 7, 7, 7, 5]
    first = join(chunks)
    assert same(first.landmarks, ring[0]) and same(first.paths, ring[1])
    again = join(list(small.chunks(*ring_track)))
    assert same(again.paths, first.paths)
    np.testing.assert_array_equal(again.transfer, first.transfer)


def test_chunks_with_different_anchors_join(ring_xml, ring_track):
    settings = TraceSettings(max_depth=2, chunk=3)
    tracer = Tracer(SceneSource(ring_xml), CARRIER, [60.0, 60.0, 20.0], POINTS, settings)
    receivers = np.array([[-80.0, 60, 1], [80, 80, 1], [0, 0, 1], [10, -90, 1], [50, 50, 1], [-50, -90, 40]])
    joined = join(list(tracer.chunks(receivers)))
    (whole,) = Tracer(SceneSource(ring_xml), CARRIER, [60.0, 60.0, 20.0], POINTS, TraceSettings(max_depth=2)).chunks(
        receivers
    )
    assert same(joined.landmarks, whole.landmarks) and same(joined.paths, whole.paths)


def test_polarizations_come_from_one_transfer(ring_xml, ring_track):
    traced = {}
    for pair in (("V", "V"), ("H", "H"), ("V", "H"), ("+45", "-45")):
        tracer = Tracer(SceneSource(ring_xml), CARRIER, BS, None, TraceSettings(polarization=pair))
        (traced[pair],) = tracer.chunks(*ring_track)
    transfer = traced["V", "V"].transfer
    np.testing.assert_array_equal(traced["V", "V"].paths.a, transfer[:, 0, 0])
    np.testing.assert_array_equal(traced["H", "H"].paths.a, transfer[:, 1, 1])
    np.testing.assert_array_equal(traced["V", "H"].paths.a, transfer[:, 1, 0])
    skew = 0.5 * np.array([1, -1]) @ transfer @ np.array([1, 1])
    np.testing.assert_allclose(traced["+45", "-45"].paths.a, skew, rtol=1e-12)


def scene_of(tmp_path, *shapes, name="made.xml", itu="glass"):
    material = (
        '<bsdf type="itu-radio-material" id="stuff"><string name="type" value="{}"/>'
        '<float name="thickness" value="{}"/></bsdf>'
    )
    body = [material.format(itu, 0.02), *shapes]
    file = tmp_path / name
    file.write_text(f'<scene version="2.1.0">{"".join(body)}</scene>')
    return file


def upright(name, x):
    """A wall in the plane x, 40 m wide and high, as a rectangle of Mitsuba."""
    return (
        f'<shape type="rectangle" id="{name}"><transform name="to_world">'
        f'<matrix value="0 0 1 {x}  20 0 0 0  0 20 0 0  0 0 0 1"/>'
        '</transform><ref id="stuff" name="bsdf"/></shape>'
    )


def test_passing_through_a_pane_leaves_the_landmark(tmp_path):
    file = scene_of(tmp_path, upright("pane", 5.0), upright("wall", 20.0))
    receivers = np.array([[10.0, 1.0, 0.0], [12.0, -2.0, 1.0]])
    settings = TraceSettings(refraction=True, max_depth=2)
    landmarks, paths = trace(SceneSource(file), CARRIER, [0.0, 0.0, 0.0], receivers, None, None, settings)
    assert "BS" in landmarks.name and "VA wall" in landmarks.name
    rows = rows_of(landmarks, paths, "VA wall")
    np.testing.assert_allclose(
        paths.tau[rows] * SPEED_OF_LIGHT, np.linalg.norm(receivers - [40, 0, 0], axis=1), rtol=1e-12
    )
    np.testing.assert_array_equal(np.diff(paths.vertex_offsets)[rows], 1)
    _, blocked = trace(SceneSource(file), CARRIER, [0.0, 0.0, 0.0], receivers)
    assert len(blocked.a) == 0 and blocked.offsets.tolist() == [0, 0, 0]


def test_free_space_and_no_reflections(tmp_path, ring_xml):
    file = scene_of(tmp_path)
    points = ScatterPoints(("ball",), [[5.0, 5.0, 5.0]])
    landmarks, paths = trace(SceneSource(file), CARRIER, [0.0, 0.0, 10.0], [[10.0, 0, 0]], None, points)
    assert landmarks.name[paths.landmark].tolist() == ["BS", "SP ball"]
    _, direct = trace(SceneSource(ring_xml), CARRIER, BS, [[10.0, 0, 0]], None, None, TraceSettings(max_depth=0))
    assert direct.landmark.tolist() == [0]


def test_walls_hide_scatter_points(tmp_path):
    file = scene_of(tmp_path, upright("wall", 5.0))
    points = ScatterPoints(("seen", "hidden"), [[3.0, 4.0, 0.0], [8.0, 4.0, 0.0]])
    landmarks, paths = trace(SceneSource(file), CARRIER, [0.0, 0.0, 0.0], [[0.0, 8.0, 0.0]], None, points)
    assert landmarks.name[paths.landmark].tolist() == ["BS", "VA wall", "SP seen"]


def test_many_scatter_points_keep_their_order(ring_xml):
    rng = np.random.default_rng(3)
    names = tuple(f"p{i}" for i in range(60))
    points = ScatterPoints(names, rng.uniform(-80, 80, (60, 3)) * [1, 1, 0.2] + [0, 0, 20])
    receivers = rng.uniform(-80, 80, (25, 3)) * [1, 1, 0]
    landmarks, paths = trace(SceneSource(ring_xml), CARRIER, BS, receivers, None, points)
    np.testing.assert_allclose(landmarks.position[-60:], points.positions)
    rows = np.flatnonzero(landmarks.kind[paths.landmark] == Kind.SP)
    assert len(rows) == 60 * 25


@pytest.mark.parametrize(
    "arguments, message",
    [
        (
            {"bs_position": [100.0, 0, 40]},
            "the base station at .* closer than 1 cm to a surface of object 'wall_east'",
        ),
        ({"receivers": [[0, 0, 1.0], [0, 99.995, 1.0]]}, "the receiver at step 1 .* 'wall_north'"),
        (
            {"scatter_points": ScatterPoints(("lamp",), [[-100.0, 3, 3]])},
            "scatter point 'lamp' at .* 'wall_west'",
        ),
        ({"receivers": np.zeros((0, 3))}, "no receiver positions"),
        ({"velocities": np.zeros((2, 3))}, "1 receivers but velocities of shape"),
    ],
)
def test_positions_are_checked(ring_xml, arguments, message):
    given = {"bs_position": BS, "receivers": [[10.0, 0, 0]]} | arguments
    with pytest.raises(SceneError, match=message):
        trace(SceneSource(ring_xml), CARRIER, **given)


@pytest.mark.parametrize("variable, value", [("HOME", os.devnull), ("DRJIT_CACHE_DIR", os.devnull + "/x")])
def test_an_unwritable_cache_is_only_slower(ring_xml, variable, value):
    code = (
        "import sys; from dopslam.raytracing import SceneSource, trace;"
        "print(len(trace(SceneSource(sys.argv[1]), 28e9, [0, 0, 40], [[70.0, 0, 0]])[1].a))"
    )
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join(sys.path)) | {variable: value}
    answer = subprocess.run(
        [sys.executable, "-c", code, str(ring_xml)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert answer.stdout.split()[-1] == "5"


def test_a_full_buffer_of_candidates_is_noticed(ring_xml, ring_track, ring, monkeypatch):
    """With room for 50 candidates Sionna alone would silently drop most of the 200 paths."""
    from dopslam.raytracing import mends

    monkeypatch.setattr(mends, "FIRST_BUFFER", 50)
    landmarks, paths = trace(SceneSource(ring_xml), CARRIER, BS, *ring_track, POINTS)
    assert same(paths, ring[1])
    assert same(landmarks, ring[0])


def test_a_loaded_scene_serves_several_tracers(ring_xml, ring_track, ring):
    loaded = load_scene(SceneSource(ring_xml), CARRIER)
    first = ScatterPoints(("a", "b"), [[10.0, 20.0, 5.0], [-10.0, 20.0, 5.0]])
    next(Tracer(loaded, CARRIER, [10.0, 0, 20], first).chunks(ring_track[0]))
    landmarks, paths = trace(loaded, CARRIER, BS, *ring_track, POINTS)
    assert same(landmarks, ring[0]) and same(paths, ring[1])
    _, without = trace(loaded, CARRIER, BS, *ring_track)
    assert len(without.a) == 40 * 5
    with pytest.raises(SceneError, match="loaded for 28 GHz and cannot be traced at 10 GHz"):
        trace(loaded, 10e9, BS, *ring_track)


def test_thousands_of_positions_keep_all_their_paths(ring_xml):
    rng = np.random.default_rng(11)
    receivers = np.column_stack([rng.uniform(-90, 90, (3000, 2)), np.zeros(3000)])
    tracer = Tracer(SceneSource(ring_xml), CARRIER, BS, POINTS, TraceSettings(samples=10_000))
    sizes = []
    for traced in tracer.chunks(receivers, np.ones_like(receivers)):
        np.testing.assert_array_equal(np.diff(traced.paths.offsets), 9)
        sizes.append(traced.paths.steps)
    assert sizes == [500] * 6


def test_metal_reflects_everything(tmp_path):
    """An upright metal wall makes an image of the base station: Friis over the reflected path."""
    file = scene_of(tmp_path, upright("wall", 5.0), itu="metal")
    receivers = np.array([[0.0, 8.0, 1.0], [-3.0, -6.0, 0.0], [2.0, 3.0, -2.0]])
    landmarks, paths = trace(SceneSource(file), CARRIER, [0.0, 0.0, 3.0], receivers)
    rows = rows_of(landmarks, paths, "VA wall")
    length = np.linalg.norm(receivers - [10.0, 0.0, 3.0], axis=1)
    np.testing.assert_allclose(np.abs(paths.a[rows]), WAVELENGTH / (4 * np.pi * length), rtol=5e-3)
