"""Scene files and materials: every mistake is one clear sentence."""

import pytest

from dopslam.errors import SceneError
from dopslam.raytracing import SceneSource, load_scene

pytestmark = pytest.mark.rt

WALL = (
    '<shape type="rectangle" id="mesh-wall"><transform name="to_world">'
    '<matrix value="0 0 1 5  9 0 0 0  0 9 0 0  0 0 0 1"/>'
    '</transform><ref id="{0}" name="bsdf"/></shape>'
)
MATERIAL = (
    '<bsdf type="itu-radio-material" id="{0}"><string name="type" value="{1}"/>'
    '<float name="thickness" value="0.1"/></bsdf>'
)


def scene(tmp_path, *parts):
    file = tmp_path / "scene.xml"
    file.write_text(f'<scene version="2.1.0">{"".join(parts)}</scene>')
    return file


def eta(loaded, name):
    return loaded.scene.objects[name].radio_material.relative_permittivity[0]


def test_a_missing_scene_names_the_nearest():
    with pytest.raises(SceneError, match=r"'simple_stret_canyon' is neither.*did you mean 'simple_street_canyon'"):
        load_scene(SceneSource("simple_stret_canyon"), 28e9)


@pytest.mark.parametrize(
    "text",
    [
        "<scene><shape></scene>",
        "",
        "\x00\x01",
        '<scene version="2.1.0"><shape type="nonsense" id="a"/></scene>',
    ],
)
def test_a_broken_file_is_named(tmp_path, text):
    file = tmp_path / "broken.xml"
    file.write_text(text)
    with pytest.raises(SceneError, match=r"broken\.xml"):
        load_scene(SceneSource(file), 28e9)


def test_a_missing_mesh_file_is_named(tmp_path):
    shape = '<shape type="ply" id="a"><string name="filename" value="none.ply"/><ref id="m" name="bsdf"/></shape>'
    with pytest.raises(SceneError, match=r"none\.ply"):
        load_scene(SceneSource(scene(tmp_path, MATERIAL.format("m", "concrete"), shape)), 28e9)


@pytest.mark.parametrize(
    "name, itu, carrier",
    [("ground", "wet_ground", 28e9), ("mat-itu_wet_ground", "wet_ground", 28e9), ("m", "brick", 60e9)],
)
def test_an_undefined_material_is_explained(tmp_path, name, itu, carrier):
    file = scene(tmp_path, MATERIAL.format(name, itu), WALL.format(name))
    plain = name.removeprefix("mat-")
    where = rf"material '{name}' of object wall is '{itu}'.*not at {carrier / 1e9:g} GHz"
    message = where + rf".*\[scene.materials\] {plain} = "
    with pytest.raises(SceneError, match=message):
        load_scene(SceneSource(file), carrier)
    mapped = load_scene(SceneSource(file, {plain: "concrete"}), carrier)
    assert eta(mapped, "wall") == pytest.approx(5.24)
    by_type = load_scene(SceneSource(file, {itu: "glass"}), carrier)
    assert eta(by_type, "wall") == pytest.approx(6.31)


def test_an_unused_material_does_not_matter(tmp_path):
    file = scene(tmp_path, MATERIAL.format("g", "wet_ground"), MATERIAL.format("m", "concrete"), WALL.format("m"))
    assert load_scene(SceneSource(file), 28e9).surfaces.objects == ("wall",)


def test_a_material_can_become_an_absorber(tmp_path):
    file = scene(tmp_path, MATERIAL.format("itu_brick", "brick"), WALL.format("itu_brick"))
    loaded = load_scene(SceneSource(file, {"brick": "absorber"}), 28e9)
    assert type(loaded.scene.objects["wall"].radio_material).__name__ == "AbsorberRadioMaterial"


@pytest.mark.parametrize(
    "mapping, message",
    [
        ({"concret": "glass"}, "has no such material, did you mean 'concrete'"),
        ({"concrete": "gloss"}, "no such ITU material, did you mean 'glass'"),
        ({"concrete": "zzz"}, "known are vacuum"),
    ],
)
def test_a_wrong_mapping_is_explained(ring_xml, mapping, message):
    with pytest.raises(SceneError, match=message):
        load_scene(SceneSource(ring_xml, mapping), 28e9)


def test_endpoints_as_data_are_those_of_the_original(ring_xml, ring_track):
    """Bit for bit, velocities and orientations included; other arrays go to the original."""
    import numpy as np

    from dopslam.raytracing.backend import backend

    rt, mi = backend()
    loaded = load_scene(SceneSource(ring_xml), 28e9)
    rng = np.random.default_rng(0)
    for i, (p, v) in enumerate(zip(*ring_track, strict=True)):
        orientation = mi.Point3f(*rng.normal(size=3).tolist())
        loaded.scene.add(
            rt.Receiver(f"ue{i}", mi.Point3f(*p.tolist()), orientation=orientation, velocity=mi.Vector3f(*v.tolist()))
        )
    two = rt.PlanarArray(num_rows=1, num_cols=2, pattern="iso", polarization="V")
    for array, synthetic in ((loaded.scene.rx_array, True), (two, True), (two, False)):
        arguments = (loaded.scene.receivers.values(), array, synthetic, True)
        mended = loaded.scene._endpoints(*arguments)
        original = type(loaded.scene)._endpoints(loaded.scene, *arguments)
        for a, b in zip(mended, original, strict=True):
            assert (a is None) == (b is None)
            if a is not None:
                np.testing.assert_array_equal(a.numpy(), b.numpy())
    assert loaded.scene._endpoints.__func__ is not type(loaded.scene)._endpoints


def test_an_untested_version_keeps_the_original(ring_xml, monkeypatch):
    from dopslam.raytracing import mends

    monkeypatch.setattr(mends, "TESTED_VERSIONS", ())
    loaded = load_scene(SceneSource(ring_xml), 28e9)
    assert loaded.scene._endpoints.__func__ is type(loaded.scene)._endpoints
