"""Scenario files: what is read back, and the one line that each mistake gets."""

import pytest

from dopslam.config.scenario import find_scenario, load, override, parse, shipped_scenes
from dopslam.errors import ConfigError


@pytest.mark.parametrize("name", sorted(shipped_scenes()))
def test_shipped_scenarios_survive_a_round_trip(name):
    scenario = load(name)
    assert parse(scenario.to_toml()).model_dump() == scenario.model_dump()


def test_the_ring_road_ships_under_its_name_and_its_folder():
    assert (
        find_scenario("ring_road") == find_scenario("scenes/ring_road").resolve()
        or find_scenario("ring_road").is_file()
    )
    assert "ring_road" in shipped_scenes()


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("trace.max_dept=2", ["trace.max_dept", "max_depth"]),
        ("base_station.array.colums=3", ["base_station.array.colums", "columns"]),
        ("filter.density=jont", ["filter.density", "jont", "joint"]),
        ("track.speed=-1", ["track.speed", "-1"]),
        ("track.steps=0", ["track.steps", "0"]),
        ("trace.max_depth=2.5", ["trace.max_depth"]),
        ("radio.carrier_frequency=nan", ["radio.carrier_frequency"]),
        ("nonsense", ["nonsense", "key.path=value"]),
        ("track.speed.x=1", ["track.speed.x"]),
    ],
)
def test_a_mistake_is_named_with_its_key_and_a_remedy(setting, words):
    with pytest.raises(ConfigError) as caught:
        load("ring_road", [setting])
    for word in words:
        assert word in str(caught.value)
    assert "\n" not in str(caught.value)


def test_overrides_change_one_key_and_leave_the_rest():
    plain, changed = load("ring_road"), load("ring_road", ["trace.max_depth=2"])
    assert changed.trace.max_depth == 2
    assert override(plain, ["trace.max_depth=2"]).model_dump() == changed.model_dump()
    assert override(plain, []).scene_file == plain.scene_file


def test_a_missing_scene_names_the_nearest():
    with pytest.raises(ConfigError, match="ring_road"):
        load("scenes/ring_rod")


def test_broken_toml_is_one_line(tmp_path):
    (tmp_path / "scenario.toml").write_text("name = [")
    with pytest.raises(ConfigError, match="not valid TOML"):
        load(tmp_path)


def test_a_missing_key_is_named(tmp_path):
    (tmp_path / "scenario.toml").write_text('name = "x"\n[scene]\nfile = "scene.xml"\n')
    with pytest.raises(ConfigError, match="base_station"):
        load(tmp_path)
