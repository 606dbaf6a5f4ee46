"""Maps as meshes: glTF (binary, y up as its standard says) and PLY (z up), walls, landmarks, base station and track colored.

Needs the package ``trimesh``: ``pip install 'dopslam[plans]'``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dopslam.datasets.parts import Part
from dopslam.errors import DatasetError
from dopslam.formats.mapped import Mapped, runs_of
from dopslam.records import Kind

WALL, ANCHOR, POINT, STATION, TRACK = (230, 159, 0), (230, 159, 0), (0, 158, 115), (213, 94, 0), (0, 114, 178)
Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # world (z up) → glTF (y up)


def write_gltf(parts: list[Part], out: Path) -> None:
    """``slam_….glb`` for every filter history."""
    for run in runs_of(parts):
        scene = _trimesh().Scene(meshes(run))
        scene.apply_transform(Y_UP)
        scene.export(out / f"{run.name}.glb")


def write_ply(parts: list[Part], out: Path) -> None:
    """``slam_….ply`` for every filter history."""
    for run in runs_of(parts):
        whole = _trimesh().util.concatenate(list(meshes(run).values()))
        whole.export(out / f"{run.name}.ply")


def _trimesh():
    try:
        import trimesh
    except ImportError as error:
        raise DatasetError("meshes need the package 'trimesh': pip install 'dopslam[plans]'") from error
    return trimesh


def meshes(run: Mapped) -> dict:
    """Name → mesh, world frame; virtual anchors are left out, since they stand for the walls."""
    trimesh = _trimesh()
    size = max(float(np.ptp(run.position, axis=0).max()), 1.0)

    def ball(place: np.ndarray, radius: float, color: tuple, fine: int = 1):
        mesh = trimesh.creation.icosphere(subdivisions=fine, radius=radius)
        mesh.apply_translation(place)
        return painted(mesh, color)

    def painted(mesh, color: tuple):
        mesh.visual.face_colors = [*color, 255]
        return mesh

    found = {"base_station": ball(run.base_station, size / 60, STATION, 2)}
    for number, corners in zip(run.walls.track.tolist(), run.walls.corners, strict=True):
        faces = [[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]]  # both sides
        found[f"wall_{number}"] = painted(trimesh.Trimesh(corners, faces, process=False), WALL)
    history = run.history
    for row in run.last.tolist():
        if history.kind[row] == Kind.SP:
            found[f"scatter_point_{int(history.track[row])}"] = ball(history.position[row], size / 100, POINT, 2)
    steps = [ball(place, size / 250, TRACK, 0) for place in run.position]
    found["track"] = painted(trimesh.util.concatenate(steps), TRACK)
    return found


class Gltf:
    """The map of every filter as glTF."""

    writes, reads = True, False

    def write(self, parts: list[Part], out: Path) -> None:
        """A file per filter history."""
        write_gltf(parts, out)


class Ply:
    """The map of every filter as PLY."""

    writes, reads = True, False

    def write(self, parts: list[Part], out: Path) -> None:
        """Files per filter history."""
        write_ply(parts, out)
