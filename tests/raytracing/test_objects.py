"""Whatever objects and materials are called, the tracer finds the same paths and says the author's names."""

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from dopslam.errors import SceneError
from dopslam.raytracing import ScatterPoints, SceneSource, builtin_scenes, load_scene, trace
from dopslam.raytracing.objects import name_objects

NAMES = ["wall.001", "Wall East", "wand_ö", "bs", "ue0", "dopslam-bs", "dopslam-points", "concrete", "no-name-1", "a/b"]


def shapes(*ids):
    text = "".join(f'<shape type="rectangle" id="{i}"/>' if i else '<shape type="rectangle"/>' for i in ids)
    return ET.fromstring(f'<scene><bsdf type="itu-radio-material" id="mat-concrete"/>{text}</scene>')


def test_names_are_kept_and_safe_inside():
    names = name_objects(root := shapes("mesh-a", "b.1", "concrete", "", "object_4"), Path("s.xml"))
    assert list(names.values()) == ["a", "b.1", "concrete", "object_4_", "object_4"]
    assert [shape.get("id") for shape in root.findall("shape")] == [f"mesh-{inside}" for inside in names]
    assert not any("." in inside or inside == "concrete" for inside in names)


def test_two_objects_of_one_name_are_refused():
    with pytest.raises(SceneError, match=r"s\.xml: two objects are named 'a'"):
        name_objects(shapes("a", "mesh-a"), Path("s.xml"))


@pytest.mark.rt
def test_a_wall_may_have_any_name(tmp_path, ring_xml):
    text = ring_xml.read_text(encoding="utf-8")
    receivers = np.array([[70.0, 0, 0], [60, 30, 1]])
    points = ScatterPoints(("lamp.1", "bs"), np.array([[50.0, 20, 3], [20, 60, 1]]))
    expected = trace(SceneSource(ring_xml), 28e9, [0, 0, 40], receivers, None, points)
    for name in NAMES:
        file = tmp_path / "scene.xml"
        file.write_text(text.replace('id="wall_east"', f'id="{name}"'), encoding="utf-8")
        landmarks, paths = trace(SceneSource(file), 28e9, [0, 0, 40], receivers, None, points)
        assert f"VA {name}" in landmarks.name, name
        assert len(landmarks) == len(expected[0])
        np.testing.assert_allclose(np.sort(paths.tau), np.sort(expected[1].tau), rtol=1e-12)


@pytest.mark.rt
@pytest.mark.parametrize(
    "itu, carrier",
    [
        ("marble", 60e9),
        ("brick", 40e9),
        ("brick", 110e9),
        ("glass", 0.1e9),
        ("floorboard", 60e9),
        ("clear_acrylic", 140e9),
    ],
)
def test_a_material_is_defined_up_to_the_ends_of_its_range(tmp_path, ring_xml, itu, carrier):
    file = tmp_path / "scene.xml"
    file.write_text(ring_xml.read_text(encoding="utf-8").replace('value="concrete"', f'value="{itu}"'), "utf-8")
    loaded = load_scene(SceneSource(file), carrier)
    assert loaded.carrier_frequency == carrier
    assert abs(float(loaded.scene.frequency.numpy()[0]) / carrier - 1) < 2e-6


@pytest.mark.rt
def test_the_remedy_of_an_undefined_material_is_one(tmp_path, ring_xml):
    file = tmp_path / "scene.xml"
    file.write_text(ring_xml.read_text(encoding="utf-8").replace('value="concrete"', 'value="brick"'), "utf-8")
    with pytest.raises(SceneError, match=r"\[scene.materials\] concrete = ") as failure:
        load_scene(SceneSource(file), 60e9)
    remedy = str(failure.value).split("concrete = '")[1].split("'")[0]
    load_scene(SceneSource(file, {"concrete": remedy}), 60e9)


@pytest.mark.rt
@pytest.mark.parametrize("name", [n for n in builtin_scenes() if n not in ("munich", "san_francisco", "florence")])
def test_builtin_scenes_keep_their_names(name):
    loaded = load_scene(SceneSource(name), 3.5e9)
    assert set(loaded.authors_name.values()) == set(loaded.surfaces.objects)
