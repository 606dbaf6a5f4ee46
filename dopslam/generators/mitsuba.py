"""A generated scene as a Mitsuba XML text that the ray tracer loads: cubes and rectangles, no mesh files."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from dopslam.generators.draft import Box, Generated, Sheet

THICKNESS = {"glass": 0.01, "metal": 0.01, "wood": 0.03, "plasterboard": 0.05, "ceiling_board": 0.02}  # m; others 0.2


def scene_xml(scene: Generated) -> str:
    """The scene's geometry and materials; everything else belongs into ``scenario.toml``."""
    root = ET.Element("scene", version="2.1.0")
    for material in sorted({shape.material for shape in scene.shapes}):
        bsdf = ET.SubElement(root, "bsdf", type="itu-radio-material", id=material)
        ET.SubElement(bsdf, "string", name="type", value=material)
        ET.SubElement(bsdf, "float", name="thickness", value=f"{THICKNESS.get(material, 0.2):g}")
    for shape in scene.shapes:
        _add(root, shape)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _add(root: ET.Element, shape: Box | Sheet) -> None:
    element = ET.SubElement(root, "shape", type="cube" if isinstance(shape, Box) else "rectangle", id=shape.name)
    transform = ET.SubElement(element, "transform", name="to_world")
    ET.SubElement(transform, "matrix", value="  ".join(" ".join(f"{v:.9g}" for v in row) for row in shape.matrix))
    ET.SubElement(element, "ref", id=shape.material, name="bsdf")
