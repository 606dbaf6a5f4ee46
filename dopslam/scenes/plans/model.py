"""Models in three dimensions: glTF, PLY, OBJ and whatever trimesh reads, every node an object of the scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dopslam.errors import ConfigError
from dopslam.scenes.generators.draft import Mesh
from dopslam.scenes.plans.raise_ import extra

Y_UP = {".glb", ".gltf"}  # by their specification
ITU = ("concrete", "brick", "plasterboard", "wood", "glass", "ceiling_board", "chipboard", "plywood", "marble", "metal")


def read_model(path: Path, material: str) -> list[Mesh]:
    """The meshes of a file; an object whose name or material holds an ITU type is made of it, others of ``material``.

    Raises
    ------
    ConfigError
        If the file cannot be read, or holds no triangles.
    """
    trimesh = extra("trimesh", "plans")
    try:
        scene = trimesh.load_scene(path, process=False)
        parts = scene.dump()
    except Exception as error:  # every format has faults of its own
        raise ConfigError(f"{path}: cannot be read as a model ({type(error).__name__}: {error})") from error
    meshes = []
    for number, part in enumerate(parts, start=1):
        faces = np.asarray(getattr(part, "faces", np.zeros((0, 3))))
        if not len(faces):
            continue
        name = str(part.metadata.get("name") or f"object_{number}")
        own = getattr(getattr(part.visual, "material", None), "name", None) or ""
        made_of = next((itu for itu in ITU if itu in f"{name} {own}".lower()), material)
        vertices = np.asarray(part.vertices, dtype=float)
        if path.suffix.lower() in Y_UP:
            vertices = vertices[:, [0, 2, 1]] * [1.0, -1.0, 1.0]
        meshes.append(Mesh(name, made_of, vertices, faces))
    if not meshes:
        raise ConfigError(f"{path}: holds no triangles; export meshes")
    names = [m.name for m in meshes]
    return [
        m if names.count(m.name) == 1 else Mesh(f"{m.name}_{i}", m.material, m.vertices, m.faces)
        for i, m in enumerate(meshes)
    ]
