"""OpenStreetMap: the buildings of an ``.osm`` extract on disk, raised by their ``height`` or their levels."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from dopslam.errors import ConfigError
from dopslam.scenes.plans.geojson import in_meters
from dopslam.scenes.plans.raise_ import HEIGHTS, Feature

MATERIALS = {
    "brick": "brick",
    "concrete": "concrete",
    "glass": "glass",
    "metal": "metal",
    "wood": "wood",
    "stone": "marble",
}


def read_osm(path: Path) -> list[Feature]:
    """The buildings of an extract, in meters about its middle.

    Raises
    ------
    ConfigError
        If it is no OpenStreetMap XML, or holds no building.
    """
    try:
        root = ET.parse(path).getroot()
    except (OSError, ET.ParseError) as error:
        raise ConfigError(f"{path}: cannot be read as OpenStreetMap XML ({error})") from error
    try:
        nodes = {n.attrib["id"]: (float(n.attrib["lon"]), float(n.attrib["lat"])) for n in root.iter("node")}
    except (KeyError, ValueError) as error:
        raise ConfigError(f"{path}: a node without id, lon or lat ({error})") from error
    ways = {w.attrib.get("id"): [n.attrib.get("ref") for n in w.iter("nd")] for w in root.iter("way")}
    found = []
    for element in (*root.iter("way"), *root.iter("relation")):
        tags = {t.attrib.get("k"): t.attrib.get("v", "") for t in element.iter("tag")}
        if tags.get("building", tags.get("building:part", "no")) == "no":
            continue
        lines = [ways.get(element.attrib.get("id"), [])] if element.tag == "way" else [
            ways.get(m.attrib.get("ref"), []) for m in element.iter("member") if m.attrib.get("role") in ("outer", "outline", "")
        ]  # fmt: skip
        for line in lines:
            points = np.array([nodes[ref] for ref in line if ref in nodes], dtype=float).reshape(-1, 2)
            if len(points) >= 4 and line[0] == line[-1]:
                name = tags.get("name") or f"building_{element.attrib.get('id', len(found))}"
                material = MATERIALS.get(tags.get("building:material", ""))
                found.append(Feature(name, points[:-1], True, (), _height(tags), material))
    if not found:
        raise ConfigError(f"{path}: holds no building; take an extract with building=* ways")
    return in_meters(found)


def _height(tags: dict) -> float | None:
    for key, unit in HEIGHTS:
        text = tags.get(key, "").removesuffix("m").strip()
        try:
            value = float(text) * unit
        except ValueError:
            continue
        if 0 < value < 1000:
            return value
    return None
