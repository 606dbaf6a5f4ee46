"""Sampled tracks: physics of each kind, independence of parts, files of one's own."""

import numpy as np
import pytest

from dopslam.config.scenario import load
from dopslam.datasets import tracks
from dopslam.datasets.polygon import clearance
from dopslam.errors import ConfigError
from dopslam.pipeline import stages as pipeline
from dopslam.records import same

L_SHAPE = [[0, 0], [90, 0], [90, 40], [40, 40], [40, 90], [0, 90]]
KINDS = {
    "motion": [],
    "line": ["dataset.tracks.kind=line", "dataset.tracks.ends=[[-50, -20], [60, 35]]"],
    "circle": ["dataset.tracks.kind=circle", "dataset.tracks.radius=30", "dataset.tracks.center=[5, 1]"],
    "drive": [
        "dataset.tracks.kind=drive", f"dataset.tracks.polygon={L_SHAPE}", "dataset.tracks.speed=[4, 9]", "dataset.tracks.turn_rate=0.8",
    ],
}  # fmt: skip


def made(kind, *more):
    return tracks.sampled(load("ring_road", [*KINDS[kind], "dataset.steps=17", *more]), seed=4)


@pytest.mark.parametrize("kind", KINDS)
def test_any_part_can_be_made_alone(kind):
    whole, steps = made(kind).part(0, 60)
    part, its = made(kind).part(23, 30)
    for name in ("time", "position", "heading", "velocity", "bias"):
        assert np.array_equal(getattr(whole, name)[23:53], getattr(part, name))
    for name in ("index", "drive", "step", "start"):
        assert np.array_equal(getattr(steps, name)[23:53], getattr(its, name))
    assert np.array_equal(steps.drive, np.arange(60) // 17)
    assert np.array_equal(steps.step, np.arange(60) % 17)


@pytest.mark.parametrize("kind", ["line", "circle", "drive"])
def test_velocity_is_the_rate_of_the_position(kind):
    track = made(kind, "track.period=0.001", "dataset.steps=400").drive(2)
    rate = (track.position[2:] - track.position[:-2]) / 0.002
    straight = np.linalg.norm(rate - track.velocity[1:-1], axis=1) < 0.02
    assert straight.mean() > 0.99  # all but the turning points of a line
    assert np.allclose(np.arctan2(track.velocity[:, 1], track.velocity[:, 0]), track.heading)
    assert np.all(np.diff(track.time) > 0)


def test_drives_never_leave_the_polygon_and_differ():
    t = made("drive", "dataset.steps=300", "track.period=0.3")
    drives = [t.drive(d) for d in range(8)]
    for track in drives:
        assert clearance(np.array(L_SHAPE, float), track.position[:, :2]).min() > 0
        speed = np.linalg.norm(track.velocity, axis=1)
        assert np.ptp(speed) < 1e-9 and 4 <= speed[0] <= 9
        turned = np.abs(tracks.wrap(np.diff(track.heading)))
        assert turned.max() <= 0.8 * 0.3 + 1e-9
    spread = np.ptp(np.concatenate([d.position[:, :2] for d in drives]), axis=0)
    assert np.all(spread > 50)


def test_a_polygon_too_narrow_to_turn_in_is_refused():
    t = made("drive", "dataset.tracks.polygon=[[0, 0], [50, 0], [50, 4], [0, 4]]")
    with pytest.raises(ConfigError, match="no place to turn.*turn_rate"):
        t.drive(0)


def test_the_first_motion_drive_is_the_traced_track():
    scenario = load("ring_road")
    assert same(tracks.sampled(scenario, 4).drive(0), pipeline.draw_track(scenario, 4))


def test_clearance_against_the_unit_square():
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    points = np.array([[0.5, 0.5], [0.1, 0.6], [2, 0.5], [2, 2], [-0.25, 0.5]])
    assert clearance(square, points) == pytest.approx([0.5, 0.1, -1, -np.sqrt(2), -0.25])


def test_tracks_from_a_file(tmp_path):
    path = tmp_path / "mine.csv"
    time = np.arange(5) * 0.5
    lines = [f"{t},{3 * t},{4 * t},{d}" for d in (0, 1) for t in time]
    path.write_text("time,x,y,drive\n" + "\n".join(lines))
    made = tracks.sampled(load("ring_road", ["dataset.tracks.kind=file", f"dataset.tracks.file={path}"]), seed=0)
    assert made.limit == 10
    track, steps = made.part(3, 4)
    assert np.allclose(track.velocity, [3, 4, 0])
    assert np.array_equal(steps.drive, [0, 0, 1, 1])
    assert np.array_equal(steps.step, [3, 4, 0, 1])
    assert np.allclose(track.heading, np.arctan2(4, 3))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x,y\n1,2\n", "needed are time"),
        ("time,x,y\n", "needed are time"),
        ("time,x,y\n0,1\n", "row 1 has 2 cells"),
        ("time,x,y\n0,1,nan\n", "row 1.*non-finite"),
        ("time,x,y\n1,1,1\n0,1,1\n", "must rise"),
        ("time,x,y\n1,1,drei\n", "numbers"),
    ],
)
def test_a_malformed_track_file_is_one_error(tmp_path, text, message):
    path = tmp_path / "mine.csv"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        tracks.sampled(load("ring_road", ["dataset.tracks.kind=file", f"dataset.tracks.file={path}"]), seed=0)
