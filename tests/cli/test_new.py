"""``dopslam new``: a folder that loads and whose positions are sound, whatever it is made from."""

import json

import numpy as np
import pytest

from dopslam.config.scenario import load
from dopslam.pipeline import preflight
from dopslam.scenes.generators import GENERATORS, generate


@pytest.mark.parametrize("kind", GENERATORS)
def test_a_kind_gives_a_folder_that_says_everything_itself(tmp_path, call, kind):
    assert call("new", tmp_path / "mine", "--kind", kind, "--seed", 5) == 0
    scenario = load(tmp_path / "mine")
    made = generate(kind, 5, carrier=28e9).keys
    assert list(scenario.base_station.position) == made["base_station"]["position"]
    assert scenario.track.steps == made["track"]["steps"]
    assert len(scenario.scatter_point) == len(made["scatter_point"])
    assert scenario.scene.file == "scene.xml" and (tmp_path / "mine" / "scene.xml").is_file()


def test_what_cannot_be_made_leaves_nothing_behind(tmp_path, call, capsys):
    assert call("new", tmp_path / "mine", "--kind", "castle") == 2
    assert "street" in capsys.readouterr().err
    (tmp_path / "there").mkdir()
    assert call("new", tmp_path / "there", "--kind", "room") == 2
    assert "exists already" in capsys.readouterr().err
    assert call("new", tmp_path / "mine", "--from", tmp_path / "no.geojson") == 2
    assert call("new", tmp_path / "mine") == 2  # nobody there to be asked
    assert [path.name for path in tmp_path.iterdir()] == ["there"]


@pytest.mark.rt
@pytest.mark.parametrize("source", ["plan", "builtin:box_two_screens", "builtin:simple_street_canyon"])
def test_base_station_and_drive_find_a_sound_place(tmp_path, call, source):
    options = ["--kind", source]
    if source == "plan":
        pytest.importorskip("shapely")
        ring = [[0, 0], [14, 0], [14, 9], [0, 9], [0, 0]]
        pillar = [[4, 5], [4.5, 5], [4.5, 5.5], [4, 5.5], [4, 5]]
        features = [
            {"type": "Feature", "properties": {}, "geometry": {"type": "Polygon", "coordinates": [points]}}
            for points in (ring, pillar)
        ]
        (tmp_path / "plan.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}))
        options = ["--from", tmp_path / "plan.geojson"]
    assert call("new", tmp_path / "mine", *options) == 0
    scenario = load(tmp_path / "mine")
    track = scenario.track
    along = track.speed * track.period * np.arange(1, track.steps + 1)
    way = [np.cos(track.start[2]) * along + track.start[0], np.sin(track.start[2]) * along + track.start[1]]
    _, found = preflight.examine(scenario, np.column_stack([*way, np.full(len(along), scenario.receiver.height)]))
    assert found == []
