"""A scene as a Mitsuba XML text that the ray tracer loads: cubes and rectangles as they are, meshes in PLY files beside it."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from dopslam.scenes.generators.draft import Box, Generated, Mesh, Sheet

THICKNESS = {"glass": 0.01, "metal": 0.01, "wood": 0.03, "plasterboard": 0.05, "ceiling_board": 0.02}  # m; others 0.2
FOLDER = "meshes"


def scene_xml(scene: Generated) -> str:
    """The scene's geometry and materials; everything else belongs into ``scenario.toml``."""
    return shapes_xml(scene.shapes)


def shapes_xml(shapes: Iterable[Box | Sheet | Mesh]) -> str:
    """Shapes and materials; the n-th mesh is taken from ``meshes/n.ply`` (n from 0, over all shapes)."""
    shapes = list(shapes)
    root = ET.Element("scene", version="2.1.0")
    for material in sorted({shape.material for shape in shapes}):
        bsdf = ET.SubElement(root, "bsdf", type="itu-radio-material", id=material)
        ET.SubElement(bsdf, "string", name="type", value=material)
        ET.SubElement(bsdf, "float", name="thickness", value=f"{THICKNESS.get(material, 0.2):g}")
    for number, shape in enumerate(shapes):
        _add(root, shape, number)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _add(root: ET.Element, shape: Box | Sheet | Mesh, number: int) -> None:
    form = {Box: "cube", Sheet: "rectangle", Mesh: "ply"}[type(shape)]
    element = ET.SubElement(root, "shape", type=form, id=shape.name)
    if isinstance(shape, Mesh):
        ET.SubElement(element, "string", name="filename", value=f"{FOLDER}/{number}.ply")
        ET.SubElement(element, "boolean", name="face_normals", value="true")
    else:
        transform = ET.SubElement(element, "transform", name="to_world")
        value = "  ".join(" ".join(f"{v:.9g}" for v in row) for row in shape.matrix)
        ET.SubElement(transform, "matrix", value=value)
    ET.SubElement(element, "ref", id=shape.material, name="bsdf")


def write_shapes(shapes: Iterable[Box | Sheet | Mesh], folder: Path) -> None:
    """Write ``scene.xml`` and the meshes it names into an existing folder."""
    shapes = list(shapes)
    for number, shape in enumerate(shapes):
        if isinstance(shape, Mesh):
            (folder / FOLDER).mkdir(exist_ok=True)
            (folder / FOLDER / f"{number}.ply").write_bytes(ply(shape.vertices, shape.faces))
    (folder / "scene.xml").write_text(shapes_xml(shapes), encoding="utf-8")


def ply(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    """A triangle mesh as a binary PLY file."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(len(faces), dtype=[("count", "u1"), ("corner", "<i4", 3)])
    rows["count"], rows["corner"] = 3, faces
    return header.encode("ascii") + np.asarray(vertices, "<f4").tobytes() + rows.tobytes()
