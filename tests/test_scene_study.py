"""The study over generated scenes: failures are results, what is there is kept, the table adds up."""

import json

from dopslam.errors import SceneError
from dopslam.studies import scenes
from dopslam.studies.scene_table import text


def test_a_scene_that_fails_is_a_result_and_is_not_tried_again(tmp_path, monkeypatch):
    calls = []

    def fail(path, scenario, seed):
        calls.append(scenario.name)
        raise SceneError("no way")

    monkeypatch.setattr(scenes.stages, "trace", fail)
    first = scenes.run("room", 3, tmp_path)
    assert (first["failures"], first["cause"]) == (["no result"], "trace: no way")
    assert scenes.run("room", 3, tmp_path) == first and calls == ["room_3"]
    assert json.loads((tmp_path / "room-3" / "result-joint.json").read_text()) == first
    scenes.run("room", 3, tmp_path, replay=True)
    scenes.run("room", 3, tmp_path, settings=["filter.gate=25"])
    assert len(calls) == 3
    assert scenes.run("room", 3, tmp_path, settings=["no.key=1"])["stage"] == "generate"


def made(kind, failures=(), **changes):
    return {
        "kind": kind, "seed": 0, "failures": list(failures), "cause": "false detections (3.1 a snapshot)" if failures else "",
        "rmse_over_bound": {"position": 1.1}, "nees": 4.2, "depth": 1, "landmarks_visible": 10, "landmarks_found": 8,
        "landmarks_ever": 9, "false_landmarks": 2, "second_reflections_visible": 4, "second_reflections_found": 3,
    } | changes  # fmt: skip


def test_the_table_counts_scenes_landmarks_and_causes():
    failed = {"kind": "room", "seed": 1, "error": "no", "failures": ["no result"], "cause": "trace: no"}
    shown = text([made("room"), made("hall", ["NEES"], nees=20.0, depth=2), failed])
    for line in (
        "pass all criteria | 1 of 3 (1%–91%)", "no result | 1 of 3", "within the limit: NEES | 1 of 2",
        "20 / 18 / 16; 4", "second reflections in the final map | 6 of 8", "room 1 of 2, hall 0 of 1",
        "1  false detections\n", "two reflections traced | 1.10",
    ):  # fmt: skip
        assert line in shown, line
