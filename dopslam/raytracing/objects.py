"""Names of a scene's objects: whatever their author wrote is kept, whatever the ray tracer takes for its own is avoided.

Mitsuba reads a dot in a name as a path (Blender writes ``wall.001``) and Sionna keeps objects, materials and devices in
one list of names, so that a wall called like a device of ours would be replaced by it without a word. Objects whose
names are not safe there run under a substitute inside the tracer; our records always say the author's.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

from dopslam.errors import SceneError

OWN = "dopslam-"  # what we add to a scene is named with this prefix
TRANSMITTER, TARGET = f"{OWN}bs", f"{OWN}points"


def receiver_name(number: int) -> str:
    """Name of a receiver inside the ray tracer."""
    return f"{OWN}ue{number}"


def name_objects(root: ET.Element, file: Path) -> dict[str, str]:
    """Give every shape of a scene an id that is safe inside the ray tracer.

    Parameters
    ----------
    root : the scene, changed in place
    file : named in messages

    Returns
    -------
    name inside the tracer → the author's name (the id without ``mesh-``; ``object_3`` for the third if it has none)

    Raises
    ------
    SceneError
        If two objects have the same name.
    """
    shapes = list(root.findall("shape"))
    materials = {bsdf.get("id", "").removeprefix("mat-") for bsdf in root.iter("bsdf")}
    given = [shape.get("id", "").removeprefix("mesh-") for shape in shapes]
    for name in given:
        if name and given.count(name) > 1:
            raise SceneError(f"{file}: two objects are named {name!r}; give each an id of its own")
    names: dict[str, str] = {}
    for number, (shape, name) in enumerate(zip(shapes, given, strict=True), start=1):
        safe = bool(name) and "." not in name and not name.startswith((OWN, "no-name")) and name not in materials
        inside = name if safe else f"{OWN}object-{number}"
        shape.set("id", f"mesh-{inside}")
        names[inside] = name or _free(f"object_{number}", given)
    return names


def _free(name: str, taken: list[str]) -> str:
    while name in taken:
        name += "_"
    return name
