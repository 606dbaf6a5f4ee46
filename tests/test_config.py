"""Scenario files: what is read back, and the one line that each mistake gets."""

import subprocess
import sys
from types import UnionType
from typing import Annotated, Literal, Union, get_args, get_origin

import pytest

from dopslam.config import reference
from dopslam.config.scenario import Scenario, find_scenario, load, override, parse, shipped_scenes
from dopslam.config.sentences import models_in
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


def numbers_without_range(annotation, metadata=()):
    """Numbers inside an annotation that are not bounded on both sides."""
    if get_origin(annotation) is Annotated:
        first, *more = get_args(annotation)
        return numbers_without_range(first, (*more, *metadata))
    if annotation in (int, float):
        bounds = [inner for item in metadata for inner in (getattr(item, "metadata", None) or [item])]
        low = any(getattr(b, n, None) is not None for b in bounds for n in ("ge", "gt"))
        high = any(getattr(b, n, None) is not None for b in bounds for n in ("le", "lt"))
        return 0 if low and high else 1
    if get_origin(annotation) in (Literal, dict):
        return 0
    own = metadata if get_origin(annotation) in (Union, UnionType) else ()
    return sum(numbers_without_range(part, own) for part in get_args(annotation))


def models_of(model):
    yield model
    for field in model.model_fields.values():
        for inner in models_in(field.annotation):
            yield from models_of(inner)


def test_every_number_has_a_range_and_every_list_an_end():
    seen = {}
    for model in models_of(Scenario):
        for name, field in model.model_fields.items():
            seen[f"{model.__name__}.{name}"] = numbers_without_range(field.annotation, tuple(field.metadata))
    assert len(seen) > 100
    assert [key for key, count in seen.items() if count] == []


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("dataset.tracks={kind='line',ends=[[0,0],[1,nan]]}", ["dataset.tracks.ends.1.1 = nan"]),
        ("dataset.tracks={kind='file'}", ["'dataset.tracks.file' is missing"]),
        ("radio.carrier=60e9", ["did you mean 'carrier_frequency'?"]),
        ("dataset.tracks={kind='drive',polygon=[[0,0],[1,0],[1,1]],speed=[3,1]}", ["speed = [3.0, 1.0]"]),
        ("dataset.steps=99999999", ["dataset.steps = 99999999"]),
        ("trace.samples=1000000000", ["trace.samples"]),
        ("evaluation.gospa_order=500", ["evaluation.gospa_order"]),
        ("source.model.range_std=1e-300", ["source.model.range_std"]),
        ("source.model.clutter_rate=1e9", ["source.model.clutter_rate"]),
        ("radio.subcarrier_spacing=1e12", ["radio.subcarrier_spacing", "radio.carrier_frequency"]),
        ("track.speed=" + "9" * 9000, ["track.speed", "(9002 characters)"]),
        ("title=" + "9" * 3000, ["title", "(3000 characters)"]),
    ],
)
def test_a_value_out_of_its_range_is_named_by_the_key_that_was_written(setting, words):
    with pytest.raises(ConfigError) as caught:
        load("ring_road", [setting])
    for word in words:
        assert word in str(caught.value)
    assert len(str(caught.value)) < 600


def test_all_keys_that_are_missing_are_named():
    with pytest.raises(ConfigError, match=r"keys .*name, .*base_station.* are missing"):
        parse("[track]\nspeed = 1\n")


def test_a_scenario_of_measured_detections_is_told_where_it_goes():
    with pytest.raises(ConfigError, match="dopslam import TABLE --scene PATH"):
        parse('name = "mine"\n[base_station]\nposition = [0.0, 5.0, 2.5]\n')


def test_every_key_is_listed_with_its_range(call, capsys):
    listed = {key.name: key for key in reference.listed()}
    assert listed["track.speed"].allowed == "number from 0 to 100000"
    assert listed["trace.samples"].allowed == "whole number from 1000 to 1e+07"
    assert listed["base_station.position"].allowed == "3 × number from -1e+06 to 1e+06"
    assert listed["estimator.false_alarm_rate"].allowed == "number from 1e-12 below 1"
    assert listed["dataset.tracks.radius"].default == "" and listed["track.period"].default == "0.5"
    assert all(
        "from" in key.allowed for key in listed.values() if "number" in key.allowed and "table" not in key.allowed
    )
    assert call("keys", "source.model") == 0
    assert "source.model.range_std" in capsys.readouterr().out
    assert call("keys", "trak") == 2
    assert "did you mean" in capsys.readouterr().err


def test_reading_a_scenario_imports_neither_numpy_nor_an_estimator():
    code = (
        "import sys; from dopslam.config.scenario import load; load('ring_road')\n"
        "print({'numpy', 'scipy', 'numba', 'h5py', 'estimation.estimators.nomp'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
