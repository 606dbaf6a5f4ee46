"""Floor plans, maps and models become closed shapes with materials; what cannot be read is refused in one sentence."""

import json
import sys

import numpy as np
import pytest

from dopslam.errors import ConfigError
from dopslam.raytracing.images import triangle_planes, winding_number
from dopslam.scenes.generators.draft import Mesh, Sheet
from dopslam.scenes.generators.mitsuba import ply, shapes_xml
from dopslam.scenes.generators.place import INDOOR, distance, hits, place, sections
from dopslam.scenes.plans import read_plan
from dopslam.scenes.plans.geojson import EARTH
from dopslam.scenes.plans.raise_ import Usual

pytest.importorskip("shapely")


def feature(kind, coordinates, **properties):
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def geojson(path, *features):
    path.write_text(json.dumps({"type": "FeatureCollection", "features": list(features)}))
    return path


def square(x, y, size):
    return [[x, y], [x + size, y], [x + size, y + size], [x, y + size], [x, y]]


def closed(mesh: Mesh):
    """Area (m²), and the winding numbers of a point inside and outside."""
    triangles = mesh.vertices[mesh.faces]
    return triangle_planes(triangles)[2].sum(), triangles


def test_a_floor_plan_gets_walls_blocks_floor_and_ceiling(tmp_path):
    hole = [square(2, 2, 2), square(2.5, 2.5, 1)]
    plan = geojson(
        tmp_path / "plan.geojson", feature("Polygon", [square(0, 0, 10)], name="outline", material="brick"),
        feature("LineString", [[5, 0], [5, 4]], name="partition"), feature("Polygon", hole, name="ring", height=1.0),
    )  # fmt: skip
    shapes = {shape.name: shape for shape in read_plan(plan, Usual(height=3.0))}
    assert set(shapes) == {"outline_1", "outline_2", "outline_3", "outline_4", "partition", "ring", "floor", "ceiling"}
    assert shapes["outline_2"].material == "brick" and shapes["ceiling"].center == (5.0, 5.0, 3.0)
    assert np.allclose(shapes["partition"].matrix @ [1, 1, 0, 1], [5, 4, 3, 1])
    area, triangles = closed(shapes["ring"])
    assert area == pytest.approx(2 * 3 + 12 * 1.0)  # both sides of 4 − 1 m², and 8 + 4 m of walls
    turns = winding_number(np.array([[2.2, 2.2, 0.5], [3.0, 3.0, 0.5], [3.0, 2.2, 1.5]]), triangles)
    assert np.allclose(turns, [1, 0, 0], atol=1e-9)


def test_a_block_around_a_court_in_meters_is_a_building_and_no_room(tmp_path):
    court = feature("Polygon", [square(0, 0, 50), square(10, 10, 30)], name="court", height="12 m")
    levels = feature("Polygon", [square(60, 0, 10)], **{"building:levels": "4"})
    shapes = {shape.name: shape for shape in read_plan(geojson(tmp_path / "c.geojson", court, levels))}
    assert set(shapes) == {"court", "block_2", "ground"}
    assert np.ptp(shapes["court"].vertices[:, 2]) == np.ptp(shapes["block_2"].vertices[:, 2]) == 12.0


def test_a_ceiling_lies_on_the_walls(tmp_path):
    hall = feature("Polygon", [square(0, 0, 40)], name="hall", height=8)
    box = feature("Polygon", [square(5, 5, 3)], name="rack", height=6)
    shapes = {shape.name: shape for shape in read_plan(geojson(tmp_path / "h.geojson", hall, box))}
    assert shapes["ceiling"].center[2] == 8.0 and np.allclose(shapes["hall_1"].matrix @ [0, 1, 0, 1], [20, 0, 8, 1])
    lines = feature("LineString", [[0, 0], [20, 0], [20, 9]], name="wall", height=4.5)
    shapes = {shape.name: shape for shape in read_plan(geojson(tmp_path / "l.geojson", lines))}
    assert shapes["ceiling"].center[2] == 4.5


def test_a_map_in_degrees_is_turned_into_meters(tmp_path):
    degree = np.rad2deg(1 / EARTH)
    north, east = 48.0, 11.0
    wide = 20 * degree / np.cos(np.deg2rad(north))
    block = [[east, north], [east + wide, north], [east + wide, north + 30 * degree], [east, north + 30 * degree]]
    mesh, ground = read_plan(geojson(tmp_path / "m.json", feature("Polygon", [[*block, block[0]]], height=9)))
    assert np.allclose(np.ptp(mesh.vertices, axis=0), [20, 30, 9], rtol=1e-3)
    assert ground.name == "ground" and ground.u[0] > 60


OSM = """<osm version="0.6">
<node id="1" lat="48.0" lon="11.0"/><node id="2" lat="48.0" lon="11.001"/><node id="3" lat="48.0005" lon="11.001"/>
<node id="4" lat="48.0005" lon="11.0"/>
<way id="7"><nd ref="1"/><nd ref="2"/><nd ref="3"/><nd ref="4"/><nd ref="1"/>
<tag k="building" v="yes"/><tag k="building:levels" v="4"/><tag k="building:material" v="brick"/></way>
<way id="8"><nd ref="1"/><nd ref="2"/><tag k="highway" v="residential"/></way></osm>"""


def test_an_openstreetmap_extract_gives_its_buildings(tmp_path):
    file = tmp_path / "part.osm"
    file.write_text(OSM)
    building, ground = read_plan(file)
    assert (building.name, building.material, ground.name) == ("building_7", "brick", "ground")
    assert np.allclose(np.ptp(building.vertices, axis=0), [74.5, 55.7, 12.0], atol=0.2)
    assert winding_number(np.array([[0.0, 0.0, 6.0]]), building.vertices[building.faces]) == pytest.approx(1.0)


def test_a_picture_gives_its_dark_parts_to_scale(tmp_path):
    image = pytest.importorskip("PIL.Image")
    pixels = np.full((120, 200), 255, np.uint8)
    pixels[10:110, 10:190] = 0
    pixels[15:105, 15:185] = 255  # walls of 5 pixels
    image.fromarray(pixels).save(tmp_path / "plan.png")
    (wall,) = [s for s in read_plan(tmp_path / "plan.png", Usual(height=2.5), 20.0) if isinstance(s, Mesh)]
    assert np.allclose(np.ptp(wall.vertices, axis=0), [9.0, 5.0, 2.5], atol=0.06)
    turns = winding_number(np.array([[5.0, 3.0, 1.0], [0.6, 3.0, 1.0]]), wall.vertices[wall.faces])
    assert np.allclose(np.abs(turns), [0, 1], atol=1e-6)
    with pytest.raises(ConfigError, match="--scale"):
        read_plan(tmp_path / "plan.png")


def test_a_model_keeps_its_objects_and_says_their_material(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box((2, 4, 6)), node_name="wall_brick", geom_name="wall_brick")
    (tmp_path / "m.glb").write_bytes(scene.export(file_type="glb"))
    (mesh,) = read_plan(tmp_path / "m.glb")
    assert mesh.material == "brick"
    assert np.allclose(np.ptp(mesh.vertices, axis=0), [2, 6, 4])  # glTF has y up
    (tmp_path / "m.ply").write_bytes(ply(mesh.vertices, mesh.faces))
    (again,) = read_plan(tmp_path / "m.ply", Usual(wall="metal"))
    assert again.material == "metal" and np.allclose(again.vertices[again.faces], mesh.vertices[mesh.faces])


@pytest.mark.parametrize(
    "name, text, hint",
    [
        ("a.geojson", "{", "GeoJSON"),
        ("a.geojson", '{"type":"FeatureCollection","features":[]}', "holds no LineString"),
        ("a.geojson", json.dumps(feature("LineString", [[0, "x"], [1, 2]])), "feature 1"),
        ("a.geojson", json.dumps(feature("LineString", [[0, 0], [5, 0]], height=-1)), "height"),
        ("a.geojson", json.dumps(feature("LineString", [[0, 0], [5, 0]], height="40 ft")), "give a number above 0"),
        ("a.osm", "<osm/>", "no building"),
        ("a.osm", "<osm", "OpenStreetMap"),
        ("a.png", "no picture", "picture"),
        ("a.glb", "no model", "model"),
        ("a.dwg", "", "is not known"),
    ],
)
def test_what_cannot_be_read_is_refused_in_one_sentence(tmp_path, name, text, hint):
    (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError, match=hint):
        read_plan(tmp_path / name, None, 10.0)


def test_a_missing_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "shapely", None)
    with pytest.raises(ConfigError, match=r"pip install 'dopslam\[plans\]'"):
        read_plan(
            geojson(
                tmp_path / "a.geojson", feature("Polygon", [square(0, 0, 3)]), feature("Polygon", [square(9, 9, 3)])
            )
        )


def room(x, y, height):
    """Triangles of four walls."""
    corners = np.array([[0, 0], [x, 0], [x, y], [0, y]], float)
    triangles = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        low, high = [[*a, 0], [*b, 0]], [[*b, height], [*a, height]]
        triangles += [[low[0], low[1], high[0]], [low[0], high[0], high[1]]]
    return np.array(triangles)


def test_sections_rays_and_distances_of_a_room():
    walls = sections(room(6, 4, 3), 1.5)
    assert np.linalg.norm(walls[:, 1] - walls[:, 0], axis=1).sum() == pytest.approx(20.0)
    rays = np.array([[1.0, 0.0], [0.0, -1.0]])
    assert np.allclose(hits(np.array([1.0, 1.0]), rays, walls), [5.0, 1.0])
    assert np.allclose(distance(np.array([[1.0, 1.5], [7.0, 2.0]]), walls), [1.0, 1.0])


def test_base_station_and_drive_are_put_where_they_see_each_other():
    triangles = room(12, 8, 3)
    placed = place(triangles, INDOOR, 0.0, lambda p: np.zeros(len(p), bool), np.random.default_rng(0))
    length = placed.speed * 10
    x, y, heading = placed.start
    way = np.array([x, y]) + np.linspace(0, length, 20)[:, None] * [np.cos(heading), np.sin(heading)]
    assert distance(way, sections(triangles, 1.4)).min() > 0.5
    assert np.all((way > 0) & (way < [12, 8])) and 0 < placed.station[0] < 12 and 0 < placed.station[1] < 8
    assert placed.seen == 1.0 and placed.speed > 0.7


def test_meshes_are_named_by_their_place_among_the_shapes():
    wall = Sheet("w", "wood", (0, 0, 1), (1, 0, 0), (0, 0, 1))
    text = shapes_xml([wall, Mesh("m", "brick", np.eye(3), np.array([[0, 1, 2]]))])
    assert 'type="ply" id="m"' in text and "meshes/1.ply" in text
