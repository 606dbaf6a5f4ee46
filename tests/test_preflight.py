"""A scenario that cannot run says everything that is wrong with it, before anything is traced."""

import numpy as np
import pytest

from dopslam import raytracing
from dopslam.config.scenario import load, parse
from dopslam.errors import SceneError
from dopslam.pipeline import preflight, stages

pytestmark = pytest.mark.rt

HALL = """<scene version="2.1.0">
<bsdf type="itu-radio-material" id="mat-walls"><string name="type" value="{0}"/></bsdf>
<bsdf type="itu-radio-material" id="mat-box"><string name="type" value="{1}"/></bsdf>
<shape type="cube" id="mesh-hall"><transform name="to_world"><scale x="30" y="20" z="4"/></transform>
<ref id="mat-walls" name="bsdf"/></shape>
<shape type="cube" id="mesh-crate.001"><transform name="to_world"><translate x="6" y="0" z="-2"/></transform>
<ref id="mat-box" name="bsdf"/></shape></scene>"""
SCENARIO = """name = "hall"
scene.file = "scene.xml"
base_station = { position = [-20.0, 5.0, 2.0], array = { kind = "planar", columns = 4, rows = 4 } }
receiver = { height = -2.0, array = { kind = "cylinder", columns = 8, rings = 2 } }
radio = { carrier_frequency = 28e9, subcarriers = 40, comb = 16 }
track = { speed = 4.0, start = [0.0, 0.0, 0.0, 0.0], steps = 12, random = false }
"""


def hall(folder, materials=("concrete", "wood"), settings=()):
    (folder / "scene.xml").write_text(HALL.format(*materials))
    (folder / "scenario.toml").write_text(SCENARIO)
    return load(folder, settings)


def found(scenario):
    scene, listed = preflight.examine(scenario, stages.draw_track(scenario, 0).position)
    return scene, [str(finding) for finding in listed if finding.fatal]


def test_all_faults_are_named_at_once(tmp_path):
    scenario = hall(tmp_path, ("brick", "floorboard"), ["radio.carrier_frequency=60e9", "estimator.kind=esprit"])
    scene, faults = found(scenario)
    assert scene is None and len(faults) == 3
    for word in ("'brick'", "'floorboard'", "[scene.materials]", "step 2 at", "inside object 'crate.001'", "Esprit"):
        assert any(word in fault for fault in faults), word
    with pytest.raises(SceneError, match=r"3 faults, found before anything was traced: \(1\)"):
        stages.trace(scenario, 0)


def test_what_is_right_passes_and_is_loaded_once(tmp_path, monkeypatch):
    scenario = hall(tmp_path, settings=["track.start=[0, -8, 0, 0]"])
    calls = []
    real = raytracing.load_scene
    monkeypatch.setattr(raytracing, "load_scene", lambda *given: calls.append(given) or real(*given))
    scene, faults = found(scenario)
    assert faults == [] and len(calls) == 1
    assert scene.carrier_frequency == 28e9


def test_a_track_that_leaves_the_room_is_what_is_named_and_not_all_that_stayed(tmp_path):
    _, (fault,) = found(hall(tmp_path, settings=["track.start=[9, -8, 0, 0]"]))
    assert "step 10 at" in fault and "1 other" in fault and "outside of object 'hall'" in fault


def test_steps_beyond_everything_are_told(tmp_path):
    scenario = parse(hall(tmp_path).to_toml(), folder=tmp_path)
    scene = preflight.checked_scene(hall(tmp_path, settings=["track.start=[0, -8, 0, 0]"]), np.array([[0.0, -8, -2]]))
    (finding,) = preflight._leaving(scenario, scene, np.array([[0.0, 0, 0], [31, 0, 0], [0, 40, 0]]))
    assert not finding.fatal and "2 of 3 steps, the first 1" in finding.what


def test_a_receiver_that_climbs_is_told(tmp_path):
    scenario = parse(hall(tmp_path).to_toml(), folder=tmp_path)
    height, scene = scenario.receiver.height, None  # which does not matter
    flat, ramp = np.full((3, 3), height), np.array([[0.0, 0, height], [1, 0, height + 0.3], [2, 0, height + 2.5]])
    assert preflight._height(scenario, scene, flat) == []
    (finding,) = preflight._height(scenario, scene, ramp)
    assert not finding.fatal and "2.5 m" in finding.what and "step 2" in finding.what


def test_the_base_station_and_points_are_checked_too(tmp_path):
    place = 'scatter_point=[{ name = "lamp", position = [6.5, 0.5, -1.5] }]'
    _, faults = found(hall(tmp_path, settings=["base_station.position=[6, 0, -2]", place, "track.start=[0, -8, 0, 0]"]))
    assert any("the base station" in fault and "1 other" in fault for fault in faults)
