"""Generated scenes: the same for ever, valid, with room for their drives."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from dopslam.config.scenario import load, override, parse
from dopslam.errors import ConfigError
from dopslam.scenes.generators import GENERATORS, generate, scene_xml
from dopslam.scenes.generators.draft import Box
from dopslam.scenes.generators.draw import turn

SEEDS = range(12)


@pytest.mark.parametrize("kind", GENERATORS)
def test_a_seed_gives_the_same_scene_for_ever_and_another_seed_another(kind):
    first, again, other = generate(kind, 1), generate(kind, 1), generate(kind, 2)
    assert first == again
    assert first != other
    root = ET.fromstring(scene_xml(first))
    assert [shape.get("id") for shape in root.iter("shape")] == [shape.name for shape in first.shapes]
    assert {ref.get("id") for ref in root.iter("ref")} <= {bsdf.get("id") for bsdf in root.iter("bsdf")}


@pytest.mark.parametrize("kind", GENERATORS)
@pytest.mark.parametrize("seed", SEEDS)
def test_everything_that_has_a_place_is_clear_of_the_boxes(kind, seed):
    scene = generate(kind, seed)
    track, boxes = scene.keys["track"], [s for s in scene.shapes if isinstance(s, Box)]
    way = turn(np.array(track["start"]), track["speed"], track["turn_rate"], track["period"], track["steps"])
    fixed = [scene.keys["base_station"]["position"], *(p["position"] for p in scene.keys["scatter_point"])]
    for box in boxes:
        assert box.clearance(way).min() > 0.6
        assert box.clearance(np.array(fixed)[:, :2]).min() > 0.15
    assert len({shape.name for shape in scene.shapes}) == len(scene.shapes)


def test_the_distance_to_a_turned_box():
    box = Box("b", "wood", (1.0, 2.0), (2.0, 1.0), np.pi / 2, 1.0)
    points = np.array([[1.0, 2.0], [3.0, 2.0], [1.0, 5.0], [3.0, 5.0]])
    assert np.allclose(box.clearance(points), [-1.0, 1.0, 1.0, np.sqrt(2)])
    corner = box.matrix @ [1.0, 1.0, 1.0, 1.0]
    assert np.allclose(corner[:3], [0.0, 4.0, 1.0])


def test_what_a_scenario_says_itself_is_kept_and_the_rest_is_made():
    text = '[scene]\ngenerator = "hall"\nseed = 4\n[track]\nsteps = 7\n[base_station.array]\nkind = "cylinder"\n'
    text += "columns = 8\nrings = 1\n"
    scenario = parse(text, ["radio.carrier_frequency=60e9"])
    made = generate("hall", 4, carrier=60e9).keys
    assert scenario.name == "hall_4" and scenario.track.steps == 7
    assert scenario.track.speed == made["track"]["speed"]
    assert scenario.base_station.array.kind == "cylinder"
    assert list(scenario.base_station.position) == made["base_station"]["position"]
    assert override(scenario, []).to_toml() == scenario.to_toml()  # what is stored reads back as the same


def test_materials_follow_the_carrier():
    for seed in SEEDS:
        for shape in generate("street", seed, carrier=70e9).shapes:
            assert shape.material not in ("brick", "marble")


@pytest.mark.parametrize(
    "line, hint",
    [
        ('generator = "streat"', "street"),
        ('generator = "room"\noptions = { lenght = 3 }', "length"),
        ('generator = "room"\noptions = { length = [5, 3] }', "least"),
        ('generator = "room"\noptions = { length = 2, width = 2 }', "no room"),
        ('generator = "room"\nseed = -1', "seed"),
        ('generator = "room"\nbuiltin = "munich"', "exactly one"),
    ],
)
def test_what_cannot_be_made_is_refused_with_its_remedy(line, hint):
    with pytest.raises(ConfigError, match=hint):
        parse(f"[scene]\n{line}\n")


@pytest.mark.rt
def test_a_generated_scene_is_traced_from_signal_to_nothing_but_its_seed(tmp_path):
    from dopslam.pipeline import stages

    (tmp_path / "scenario.toml").write_text('[scene]\ngenerator = "room"\nseed = 3\n[track]\nsteps = 4\n')
    traced = stages.trace(load(tmp_path), 0)
    assert traced.paths.steps == 4
    assert any(name.startswith("VA wall_") for name in traced.landmarks.name)
