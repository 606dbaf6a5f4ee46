"""Maps as GeoJSON, glTF and PLY, runs as MCAP: read back by the libraries of their worlds."""

import json

import numpy as np
import pytest

from dopslam.config.scenario import load
from dopslam.errors import DatasetError
from dopslam.evaluate.walls import Walls
from dopslam.formats import mcap as log
from dopslam.formats.export import export
from dopslam.formats.geojson import Origin, earth_centered, geodetic
from dopslam.pipeline import file as stages
from dopslam.records import SPEED_OF_LIGHT, DetectionSeries, Kind
from dopslam.slam.history import History
from dopslam.store import file as dataset


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    path = tmp_path_factory.mktemp("maps") / "d.h5"
    stages.simulate(path, load("ring_road", ["source.kind=model", "track.steps=8"]), seed=3)
    stages.slam(path)
    return path


def test_geojson_holds_walls_landmarks_and_track(run, tmp_path):
    shapely = pytest.importorskip("shapely")
    (file,) = export(run, tmp_path / "o", "geojson")
    tree = json.loads(file.read_text())
    walls, history = dataset.read_record(run, "walls_joint", Walls), dataset.read_record(run, "slam_joint", History)
    lines = [f for f in tree["features"] if f["properties"]["kind"] == "wall"]
    assert len(lines) == len(walls) > 0
    for feature, corners, deviation in zip(lines, walls.corners, walls.deviation, strict=True):
        shape = shapely.from_geojson(json.dumps(feature["geometry"]))
        assert shape.length == pytest.approx(np.linalg.norm(corners[1, :2] - corners[0, :2]), abs=1e-3)
        assert feature["properties"]["std_m"] == pytest.approx(deviation, abs=1e-4)
    (track,) = (f for f in tree["features"] if f["properties"]["kind"] == "track")
    np.testing.assert_allclose(np.array(track["geometry"]["coordinates"])[:, :2], history.mean[:, :2], atol=1e-4)
    points = [f for f in tree["features"] if f["properties"]["kind"] == "scatter point"]
    assert len(points) == len(history.reported(history.steps - 1, Kind.SP))


def test_degrees_are_where_the_origin_puts_them(run, tmp_path):
    origin = Origin.parse("57.7,11.97,20,30")
    (file,) = export(run, tmp_path / "o", "geojson", origin=origin)
    station = json.loads(file.read_text())["features"][0]["geometry"]["coordinates"]
    np.testing.assert_allclose(station, [11.97, 57.7, 60.0], atol=1e-4)
    rng = np.random.default_rng(0)
    points = rng.uniform(-500, 500, (50, 3))
    found = earth_centered(origin.degrees(points))
    np.testing.assert_allclose(np.linalg.norm(found[:, None] - found, axis=-1), np.linalg.norm(points[:, None] - points, axis=-1), atol=1e-6)  # fmt: skip
    ahead = origin.degrees(np.array([[100.0, 0, 0]]))[0] - origin.degrees(np.zeros((1, 3)))[0]
    metres = ahead[:2] * np.pi / 180 * 6.378e6 * [np.cos(np.deg2rad(57.7)), 1]
    np.testing.assert_allclose(np.rad2deg(np.arctan2(metres[1], metres[0])), 30, atol=0.5)


def test_geodetic_is_the_inverse_of_earth_centered():
    rng = np.random.default_rng(1)
    places = np.column_stack([rng.uniform(-180, 180, 300), rng.uniform(-90, 90, 300), rng.uniform(-500, 9000, 300)])
    np.testing.assert_allclose(geodetic(earth_centered(places)), places, atol=1e-7)
    np.testing.assert_allclose(earth_centered(np.array([[0.0, 0, 0], [0, 90, 0]])), [[6378137, 0, 0], [0, 0, 6356752.314245]], atol=1e-6)  # fmt: skip


@pytest.mark.parametrize("text", ["57.7", "a,b", "120,11", "57,11,0,0,0", "nan,1"])
def test_an_origin_that_cannot_be_is_refused(text):
    with pytest.raises(DatasetError, match="--origin"):
        Origin.parse(text)


def test_meshes_are_read_back_with_their_walls_where_they_are(run, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    walls = dataset.read_record(run, "walls_joint", Walls)
    (file,) = export(run, tmp_path / "g", "gltf")
    scene = trimesh.load(file)
    number = int(walls.track[0])
    mesh = scene.geometry[f"wall_{number}"].copy()
    node = next(n for n in scene.graph.nodes_geometry if scene.graph[n][1] == f"wall_{number}")
    mesh.apply_transform(scene.graph[node][0])
    z_up = mesh.vertices @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # glTF is y up
    corners = {tuple(np.round(c, 2)) for c in walls.corners[0]}
    assert {tuple(np.round(v, 2) + 0.0) for v in z_up} == {tuple(np.array(c) + 0.0) for c in corners}
    (file,) = export(run, tmp_path / "p", "ply")
    whole = trimesh.load(file)
    distance = np.linalg.norm(whole.vertices[:, None] - walls.corners.reshape(-1, 3), axis=-1).min(axis=0)
    assert distance.max() < 1e-4 and len(np.unique(whole.visual.face_colors, axis=0)) >= 3


def test_a_log_is_read_back_as_ros_2_messages(run, tmp_path):
    reader = pytest.importorskip("mcap_ros2.reader", reason="needs mcap-ros2-support (pip install 'dopslam[robotics]')")
    (file,) = export(run, tmp_path / "m", "mcap")
    found = {}
    for message in reader.read_ros2_messages(str(file)):
        found.setdefault(message.channel.topic, []).append(message)
    assert set(found) == {"/slam/odometry", "/slam/pose", "/truth/odometry", "/detections"}
    history, series = dataset.read_record(run, "slam_joint", History), stages.read_detections(run)
    assert all(len(messages) == history.steps for messages in found.values())
    last = found["/slam/odometry"][-1].ros_msg
    place = last.pose.pose.position
    np.testing.assert_allclose([place.x, place.y], history.mean[-1, :2])
    turn = last.pose.pose.orientation
    heading = 2 * np.arctan2(turn.z, turn.w)
    assert np.cos(heading - history.mean[-1, 2]) == pytest.approx(1)
    spread = np.reshape(last.pose.covariance, (6, 6))
    np.testing.assert_allclose(spread[np.ix_([0, 1, 5], [0, 1, 5])], history.covariance[-1][:3, :3])
    assert last.twist.twist.linear.x == pytest.approx(22.22, rel=0.05)
    assert found["/truth/odometry"][-1].ros_msg.twist.twist.linear.x == pytest.approx(22.22, rel=1e-6)
    scan = found["/detections"][2].ros_msg
    rows = series.rows(2)
    np.testing.assert_allclose([r.azimuth for r in scan.returns], series.aoa[rows, 0], atol=1e-6)
    np.testing.assert_allclose([r.range for r in scan.returns], SPEED_OF_LIGHT * series.delay[rows], rtol=1e-6)
    assert scan.header.stamp.sec + 1e-9 * scan.header.stamp.nanosec == pytest.approx(series.time[2])


def test_a_recording_is_read_back_by_rerun(run, tmp_path):
    pytest.importorskip("rerun", reason="needs rerun-sdk, 170 MB (pip install 'dopslam[rerun]')")
    from rerun.chunk import RrdReader

    (file,) = export(run, tmp_path / "r", "rrd")
    found: dict[str, list] = {}
    for chunk in RrdReader(file).stream():
        batch = chunk.to_record_batch()
        for row in batch.to_pylist():
            found.setdefault(chunk.entity_path, []).append(row)
    history, walls = dataset.read_record(run, "slam_joint", History), dataset.read_record(run, "walls_joint", Walls)
    rows = sorted(found["/slam/receiver"], key=lambda row: row["step"])
    assert [row["step"] for row in rows] == list(range(1, history.steps + 1))
    np.testing.assert_allclose([row["Points3D:positions"][0][:2] for row in rows], history.mean[:, :2], rtol=1e-6)
    last = max(found["/slam/walls"], key=lambda row: row["step"])
    np.testing.assert_allclose(last["Mesh3D:vertex_positions"], walls.corners.reshape(-1, 3), rtol=1e-5, atol=1e-3)
    assert len(last["Mesh3D:triangle_indices"]) == 2 * len(walls)
    spread = max(found["/slam/uncertainty"], key=lambda row: row["step"])
    half = 2.4477 * np.sqrt(np.linalg.eigvalsh(history.covariance[-1][:2, :2]))
    np.testing.assert_allclose(sorted(spread["Ellipsoids3D:half_sizes"][0])[1:], half, rtol=1e-4)
    assert len(found["/truth/receiver"]) == len(found["/error/position_m"]) == history.steps


def test_returns_are_where_rep_103_puts_them():
    """A car drives north; a mast to its left, higher than it, and ahead of it: in base_link x forward, y left, z up."""
    car, heading, speed = np.array([5.0, 2.0, 1.5]), np.pi / 2, 10.0
    mast = car + np.array([-20.0, 30.0, 10.0])  # west and north of it, above
    away = mast - car
    azimuth, elevation = np.arctan2(away[1], away[0]) - heading, np.arcsin(away[2] / np.linalg.norm(away))
    approach = speed * away[1] / np.linalg.norm(away)
    series = DetectionSeries(
        offsets=np.array([0, 1]), delay=np.array([np.linalg.norm(away) / SPEED_OF_LIGHT]), aoa=np.array([[azimuth, elevation]]),
        aod=np.zeros((1, 2)), radial_velocity=np.array([approach]), gain=np.zeros(1, complex), covariance=np.eye(6)[None],
        snr=np.array([100.0]), noise_variance=np.ones(1), threshold=14.0, false_alarm_rate=0.0, search_volume=1.0,
    )  # fmt: skip
    (found,) = log.radar_scan(0, series, 0)["returns"]
    a, e = found["azimuth"], found["elevation"]
    point = found["range"] * np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    np.testing.assert_allclose(point, [30, 20, 10], atol=1e-9)  # forward, left, up
    assert found["doppler_velocity"] < 0 and found["amplitude"] == pytest.approx(20)


def test_a_file_without_a_map_says_how_to_make_one(tmp_path):
    path = tmp_path / "d.h5"
    stages.simulate(path, load("ring_road", ["source.kind=model", "track.steps=2"]), seed=0)
    with pytest.raises(DatasetError, match="holds no map; run 'dopslam slam"):
        export(path, tmp_path / "o", "geojson")
    with pytest.raises(DatasetError, match="--origin goes with"):
        export(path, tmp_path / "o", "tum", origin=Origin(0, 0))
    assert not (tmp_path / "o").exists()


def test_what_was_found_without_a_truth_goes_out_as_tables_and_trajectories(run, tmp_path):
    history, series = dataset.read_record(run, "slam_joint", History), stages.read_detections(run)
    path = tmp_path / "own.h5"
    dataset.write_records(path, {"detections": series, "slam_joint": history}, dataset.read_root(run)[0], 0)
    export(path, tmp_path / "csv", "csv")
    track = np.genfromtxt(tmp_path / "csv" / "slam_joint.csv", delimiter=",", names=True)
    np.testing.assert_allclose(np.column_stack([track[n] for n in ("x", "y", "heading", "bias")]), history.mean[:, :4])
    np.testing.assert_allclose(track["cov_y_heading"], history.covariance[:, 1, 2])
    np.testing.assert_allclose(track["time"], series.time)
    found = np.genfromtxt(tmp_path / "csv" / "slam_joint_map.csv", delimiter=",", names=True, dtype=None, encoding=None)
    anchors = history.reported(history.steps - 1, Kind.VA)
    np.testing.assert_allclose([[r["x"], r["y"], r["z"]] for r in found if r["kind"] == "VA"], anchors)
    (poses,) = export(path, tmp_path / "tum", "tum")
    np.testing.assert_allclose(np.loadtxt(poses)[:, 1:3], history.mean[:, :2], atol=1e-8)
    bare = tmp_path / "bare.h5"
    dataset.write_records(bare, {"detections": series}, dataset.read_root(run)[0], 0)
    for form in ("csv", "tum"):
        with pytest.raises(DatasetError, match=r"run 'dopslam slam"):
            export(bare, tmp_path / "none", form)


def test_slam_says_what_comes_next(run, tmp_path):
    assert stages.after_slam(run) == f"dopslam bound {run}"
    history, series = dataset.read_record(run, "slam_joint", History), stages.read_detections(run)
    path = tmp_path / "own.h5"
    dataset.write_records(path, {"detections": series, "slam_joint": history}, dataset.read_root(run)[0], 0)
    assert stages.after_slam(path).startswith(f"dopslam view {path}, or dopslam export {path} --to csv")
