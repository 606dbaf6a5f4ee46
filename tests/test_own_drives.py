"""Drives of one's own in run: waypoints with times or a speed, stops, reversal, files; what follows from them."""

import numpy as np
import pytest

from dopslam.config.scenario import load, override, parse
from dopslam.config.trackfile import from_file, from_waypoints
from dopslam.errors import ConfigError
from dopslam.pipeline import stages

STOP_AND_GO = [[0, 0, 0], [10, 0, 5], [10, 0, 8], [20, 5, 14]]


def test_a_place_given_twice_is_a_stop_that_keeps_its_heading():
    drive = from_waypoints(STOP_AND_GO, 0.0, 1.5, 0.25)
    at = 0.25 * np.arange(len(drive.position))
    for x, y, time in STOP_AND_GO:
        assert np.allclose(drive.position[np.argmin(np.abs(at - time))], [x, y, 1.5], atol=1e-9)
    standing = (at > 5.01) & (at < 7.99)
    assert np.all(np.abs(drive.speed[standing]) < 1e-9) and np.allclose(drive.heading[standing], 0, atol=1e-9)
    travelled = np.gradient(drive.position, 0.25, axis=0)[2:-2]
    assert np.allclose(travelled, drive.velocity[2:-2], atol=0.12)  # their own derivative, to the period
    forward = np.column_stack([np.cos(drive.heading), np.sin(drive.heading)])
    assert np.allclose(drive.velocity[:, :2], drive.speed[:, None] * forward, atol=1e-9)


def test_who_sets_out_against_the_heading_drives_backwards():
    drive = from_waypoints([[0, 0, 0], [8, 0, 4], [8, 0, 5], [2, 0, 9]], 0.0, 0.0, 0.2)
    assert np.allclose(drive.heading, 0, atol=1e-9)
    assert drive.speed.max() > 1 and drive.speed.min() < -1


def test_waypoints_at_one_speed():
    drive = from_waypoints([[0, 0], [10, 0], [20, 10]], 2.0, 0.0, 0.5)
    assert np.median(drive.speed) == pytest.approx(2.0, rel=0.15)
    assert len(drive.position) - 1 == int((10 + np.hypot(10, 10)) / 2 / 0.5)


@pytest.mark.parametrize(
    "points, speed, hint",
    [
        ([[0, 0, 0]], 0, "two or more"), ([[0, 0, 0], [1, 1]], 0, "all as"), ([[0, 0], [1, 1]], 0, "speed above 0"),
        ([[0, 0, 1], [1, 1, 1]], 0, "must rise"), ([[0, 0, 0], [1, 1, 1e9]], 0, "steps"),
    ],
)  # fmt: skip
def test_waypoints_that_make_no_drive_are_refused(points, speed, hint):
    with pytest.raises(ConfigError, match=hint):
        from_waypoints(points, speed, 0.0, 0.2)


def test_a_file_is_resampled_with_its_headings_and_height(tmp_path):
    time = np.arange(0, 4.01, 0.1)
    angle = 0.5 * time
    rows = np.column_stack([time, np.sin(angle), 1 - np.cos(angle), 1.2 + 0 * time])
    np.savetxt(tmp_path / "d.csv", rows, delimiter=",", header="time,x,y,z", comments="")
    drive = from_file(tmp_path / "d.csv", 0.0, 0.2)
    assert np.allclose(drive.speed[1:-1], 0.5, atol=0.01) and np.allclose(drive.position[:, 2], 1.2)
    assert np.allclose(drive.heading[1:-1], 0.5 * 0.2 * np.arange(len(drive.heading))[1:-1], atol=0.02)
    half = 0.5 * angle
    turned = np.column_stack([time + 1.6e9, rows[:, 1:], 0 * half, 0 * half, np.sin(half), np.cos(half)])
    np.savetxt(tmp_path / "d.tum", turned, fmt="%.9f")
    tum = from_file(tmp_path / "d.tum", 0.0, 0.2)
    assert np.allclose(tum.heading, 0.1 * np.arange(len(tum.heading)), atol=1e-6)


TEXT = """
name = "mine"
[scene]
builtin = "box"
[base_station]
position = [0, 0, 5]
array = { kind = "cylinder", columns = 8, rings = 2 }
[receiver]
height = 1.5
array = { kind = "cylinder", columns = 8, rings = 2 }
[track]
"""


def test_a_scenario_needs_nothing_beside_its_waypoints(tmp_path):
    scenario = parse(TEXT + f"waypoints = {STOP_AND_GO}\nmax_acceleration = 2.0\n")
    assert (scenario.track.steps, scenario.track.period, scenario.track.start[:2]) == (70, 0.2, (0.0, 0.0))
    assert scenario.filter.motion == "unknown" and scenario.filter.speed_walk == pytest.approx(0.4)
    track = stages.draw_track(scenario, 3)
    assert track.steps == 70 and np.allclose(track.position[-1], [20, 5, 1.5])
    fastest = np.linalg.norm(track.velocity, axis=1).max()
    assert scenario.estimator.max_radial_velocity > fastest
    assert not np.allclose(track.bias, stages.draw_track(scenario, 4).bias)
    with pytest.raises(ConfigError, match="leave the key out"):
        stages.simulate(scenario, 0)
    stored = override(scenario, [])
    assert stored.to_toml() == scenario.to_toml()
    assert np.array_equal(stages.draw_track(stored, 3).position, track.position)


def test_a_scenario_names_its_file_and_what_is_said_is_kept(tmp_path):
    (tmp_path / "d.csv").write_text("time,x,y,heading,bias\n0,1,2,0.3,7\n1,2,2,0.3,7\n2,3,2,0.3,7\n")
    (tmp_path / "scenario.toml").write_text(TEXT + 'file = "d.csv"\nperiod = 0.5\n[filter]\nmotion = "known"\n')
    scenario = load(tmp_path)
    assert scenario.track.start == (1.0, 2.0, 0.3, 7.0) and scenario.track.steps == 4
    assert scenario.filter.motion == "known"
    assert np.allclose(stages.draw_track(scenario, 0).bias, 7.0)
    with pytest.raises(ConfigError, match=r"track\.file"):
        load(tmp_path, ['track.file="none.csv"'])
    with pytest.raises(ConfigError, match="either file or waypoints"):
        load(tmp_path, ["track.waypoints=[[0,0,0],[1,1,1]]"])


def test_a_drive_of_ones_own_in_a_generated_scene_is_not_taken_for_the_generators():
    own = parse(
        '[scene]\ngenerator = "street"\nseed = 3\n', ["track.waypoints=[[0, 0, 0], [9, 0, 3], [9, 0, 5], [20, 0, 9]]"]
    )
    assert own.filter.motion == "unknown" and own.track.start[:2] == (0, 0) and own.track.steps == 45
    slow = parse('[scene]\ngenerator = "street"\nseed = 3\n', ["track.waypoints=[[0, 0], [9, 0]]"])
    assert slow.filter.motion == "unknown" and slow.track.speed > 0


@pytest.mark.parametrize("left_over", ["speed = 6.9", "start = [-28, -2.5, 0, 0]", "steps = 56", "turn_rate = 0.5"])
def test_keys_that_a_template_leaves_beside_waypoints_are_refused(left_over):
    key = left_over.split(" ")[0]
    track = f"[track]\n{left_over}\nwaypoints = [[0, 0, 0], [9, 0, 3], [9, 0, 5], [20, 0, 9]]"
    with pytest.raises(ConfigError, match=f"{key} = .*leave these keys out"):
        parse(f'scene.generator = "street"\n{track}')


def test_the_start_of_a_drive_may_be_off_by_what_is_known_of_it_and_says_the_clock_bias():
    text = 'scene.generator = "street"\n[track]\nwaypoints = [[0, 0, 0], [9, 0, 3], [20, 0, 9]]\nstart = [0.4, -0.3, 0.01, 55]\n'
    assert parse(text).track.start == (0.4, -0.3, 0.01, 55)
    assert override(parse(text), ["trace.max_depth=1"]).track.start == (0.4, -0.3, 0.01, 55)


def test_headings_in_degrees_are_refused_and_others_are_not(tmp_path):
    from dopslam.config.trackfile import read_rows

    rng = np.random.default_rng(0)
    for turn, sideways in ((0.3, 0.0), (-0.2, 0.0), (0.25, np.pi / 2)):
        angle = rng.uniform(-np.pi, np.pi) + turn * np.arange(40)
        place = np.cumsum(np.column_stack([np.cos(angle), np.sin(angle)]), axis=0)
        path = tmp_path / "t.csv"
        for scale, refused in ((1.0, False), (180 / np.pi, not sideways)):
            table = np.column_stack([np.arange(40), place, scale * (angle + sideways)])
            np.savetxt(path, table, delimiter=",", header="time,x,y,heading", comments="")
            if refused:
                with pytest.raises(ConfigError, match="as degrees, and not as radians"):
                    read_rows(path, "track.file")
            else:
                np.testing.assert_allclose(read_rows(path, "track.file")["heading"], table[:, 3])


def test_a_track_may_have_semicolons_and_decimal_commas(tmp_path):
    from dopslam.config.trackfile import read_rows

    (tmp_path / "t.csv").write_bytes("time;x;y\r\n0,5;1,25;2\r\n1,0;1,5;2,5\r\n".encode("utf-16"))
    rows = read_rows(tmp_path / "t.csv", "track.file")
    assert rows["x"].tolist() == [1.25, 1.5] and rows["time"].tolist() == [0.5, 1.0]


def test_speeds_where_times_belong_are_told_what_the_third_number_is():
    with pytest.raises(ConfigError, match=r"rows of x \[m\], y \[m\], time \[s\]: time must rise"):
        from_waypoints([[0, 0, 5.0], [10, 0, 5.0]], 1.0, 1.5, 0.5)
