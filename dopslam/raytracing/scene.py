"""Loads a scene: an XML file or one of Sionna's own, with its materials checked for the carrier frequency.

Everything a user can get wrong in a scene file is found here and said in one sentence, before the ray tracer
sees it.
"""

from __future__ import annotations

import difflib
import gc
import importlib.util
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dopslam.errors import SceneError
from dopslam.raytracing.backend import backend
from dopslam.raytracing.mends import born_at, mend_endpoints
from dopslam.raytracing.objects import name_objects
from dopslam.raytracing.surfaces import Surfaces, build_surfaces

ABSORBER = "absorber"


@dataclass(frozen=True)
class SceneSource:
    """Where a scene comes from.

    Attributes
    ----------
    path : a scene file, or the name of a scene that Sionna ships, such as ``"simple_street_canyon"``
    materials : material (its id in the file, or its ITU type) → ITU type to use instead, or ``"absorber"``
    xml : the scene itself, where it is not in a file; ``path`` is its name in messages then
    """

    path: str | Path
    materials: Mapping[str, str] = field(default_factory=dict)
    xml: str | None = None


@dataclass(frozen=True)
class LoadedScene:
    """A scene in the ray tracer (``scene``, a ``sionna.rt.Scene``) and its surfaces as arrays.

    ``authors_name`` is the scene file's name of every object by its name in the ray tracer: see
    :mod:`dopslam.raytracing.objects`.
    """

    scene: Any
    surfaces: Surfaces
    name: str
    carrier_frequency: float  # Hz, for which its materials were evaluated
    authors_name: Mapping[str, str]


def builtin_scenes() -> dict[str, Path]:
    """Scenes that Sionna ships, by name; does not import it."""
    spec = importlib.util.find_spec("sionna")
    roots = [Path(root) / "rt" / "scenes" for root in (spec.submodule_search_locations if spec else None) or ()]
    files = {path.name: path / f"{path.name}.xml" for root in roots if root.is_dir() for path in sorted(root.iterdir())}
    return {name: path for name, path in files.items() if path.is_file()}


def scene_file(path: str | Path) -> Path:
    """The XML file of a scene path or built-in name.

    Raises
    ------
    SceneError
        If there is no such file or built-in scene; names the nearest.
    """
    if Path(path).is_file():
        return Path(path)
    shipped = builtin_scenes()
    if str(path) in shipped:
        return shipped[str(path)]
    near = difflib.get_close_matches(str(path), shipped, n=1)
    hint = f"did you mean {near[0]!r}?" if near else f"give an existing file or one of {', '.join(sorted(shipped))}"
    raise SceneError(f"scene {str(path)!r} is neither a file nor a scene that Sionna ships; {hint}")


def load_geometry(source: SceneSource) -> LoadedScene:
    """Load a scene of whatever materials, for a look at its surfaces; its gains mean nothing."""
    return load_scene(source, 28e9, "concrete")


def load_scene(source: SceneSource, carrier_frequency: float, all_of: str | None = None) -> LoadedScene:
    """Load a scene for tracing at ``carrier_frequency`` [Hz]; ``all_of`` is an ITU type that replaces every material.

    Raises
    ------
    SceneError
        If the file is missing or broken, or a material is undefined at this frequency.
    LLVMError
        If the ray tracer cannot run on this machine.
    """
    file = scene_file(source.path) if source.xml is None else Path(source.path)
    rt, mi = backend()
    try:
        root = ET.fromstring(source.xml or file.read_text(encoding="utf-8"))
    except (ET.ParseError, UnicodeDecodeError, OSError) as error:
        raise SceneError(f"{file}: not a readable XML file ({error})") from error
    named = {name: all_of for bsdf in _materials(root) for name in _names(bsdf) if name} if all_of else None
    _map_materials(root, source.materials if named is None else named, file)
    wrong = undefined_materials(root, carrier_frequency, file)
    if wrong:
        raise SceneError("; ".join(wrong))
    authors_name = name_objects(root, file)
    # Scenes are cyclic; one that is still registered changes the tracer's kernels, which compile again.
    gc.collect()
    previous = mi.file_resolver()
    resolver = mi.FileResolver(previous)
    resolver.append(str(file.parent))
    try:
        mi.set_file_resolver(resolver)
        # Merging shapes, the default, would destroy the names of the walls.
        frequency = _inside(carrier_frequency, root)
        with born_at(frequency):
            scene = rt.load_scene_from_string(ET.tostring(root, encoding="unicode"), merge_shapes=False)
        for material in scene.radio_materials.values():
            if not hasattr(material, "frequency_update"):  # absorbers lack it in Sionna 2.2, and the next line calls it
                material.frequency_update = lambda: None
        scene.frequency = frequency
    except (RuntimeError, ValueError, TypeError, AssertionError) as error:
        raise SceneError(f"{file}: the ray tracer refuses it ({_one_line(error)})") from error
    finally:
        mi.set_file_resolver(previous)
    mend_endpoints(scene)
    pattern = rt.PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization="VH")
    scene.tx_array = scene.rx_array = pattern
    meshes = {str(authors_name.get(name, name)): _triangles(item.mi_mesh) for name, item in scene.objects.items()}
    surfaces = build_surfaces(dict(sorted(meshes.items())))
    return LoadedScene(scene, surfaces, file.stem, carrier_frequency, authors_name)


def _one_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return " ".join(lines)[-300:]


def _triangles(mesh) -> np.ndarray:
    vertices = np.asarray(mesh.vertex_positions_buffer(), dtype=float).reshape(-1, 3)
    return vertices[np.asarray(mesh.faces_buffer(), dtype=np.intp).reshape(-1, 3)]


def _materials(root: ET.Element) -> list[ET.Element]:
    return [bsdf for bsdf in root.findall("./bsdf") + root.findall(".//shape/bsdf")]


def _names(bsdf: ET.Element) -> list[str]:
    """Names by which a material can be called: its id with and without prefix, and its ITU type."""
    name = bsdf.get("id", "")
    plain = name.removeprefix("mat-")
    return [name, plain, *([itu] if (itu := _itu_type(bsdf)) else [])]


def _itu_type(bsdf: ET.Element) -> str | None:
    """ITU type of a material element, by Sionna's rules; None if it is none."""
    plain = bsdf.get("id", "").removeprefix("mat-")
    by_name = plain.startswith(("itu_", "itu-"))
    if not by_name and bsdf.get("type") != "itu-radio-material":
        return None
    stated = bsdf.find("string[@name='type']")
    return stated.get("value") if stated is not None else plain[4:] if by_name else None


def _itu_table() -> dict[str, dict]:
    rt, _ = backend()
    return rt.radio_materials.itu.ITU_MATERIALS_PROPERTIES


def _map_materials(root: ET.Element, mapping: Mapping[str, str], file: Path) -> None:
    """Replace materials in place, as the scenario's ``[scene.materials]`` asks."""
    known, table = sorted({name for bsdf in _materials(root) for name in _names(bsdf) if name}), _itu_table()
    for old, new in mapping.items():
        if new != ABSORBER and new not in table:
            near = difflib.get_close_matches(new, [*table, ABSORBER], n=1)
            raise SceneError(
                f"[scene.materials] {old} = {new!r}: no such ITU material"
                + (f", did you mean {near[0]!r}?" if near else f"; known are {', '.join(table)} and {ABSORBER}")
            )
        if old not in known:
            near = difflib.get_close_matches(old, known, n=1)
            raise SceneError(
                f"[scene.materials] {old}: {file.name} has no such material"
                + (f", did you mean {near[0]!r}?" if near else f"; it has {', '.join(known) or 'none'}")
            )
    for bsdf in _materials(root):
        new = next((mapping[name] for name in _names(bsdf) if name in mapping), None)
        if new is None:
            continue
        thickness = bsdf.find("float[@name='thickness']")
        old_id = bsdf.get("id", "")
        bsdf.clear()
        if new == ABSORBER:
            # The id must not look like an ITU material's, or Sionna turns it back into one.
            fresh = f"absorbing-{old_id}"
            bsdf.attrib.update(type="absorber-radio-material", id=fresh)
            for reference in root.iter("ref"):
                if reference.get("id") == old_id:
                    reference.set("id", fresh)
            continue
        bsdf.attrib.update(type="itu-radio-material", id=old_id)
        ET.SubElement(bsdf, "string", name="type", value=new)
        if thickness is not None:
            bsdf.append(thickness)


def _used_itu_types(root: ET.Element) -> list[tuple[str, str, list[str]]]:
    """(material, its ITU type, objects made of it) of every ITU material in use."""
    used = []
    for bsdf in _materials(root):
        name, itu = bsdf.get("id", ""), _itu_type(bsdf)
        users = [
            shape.get("id", "without id").removeprefix("mesh-")
            for shape in root.iter("shape")
            if bsdf in list(shape) or any(reference.get("id") == name for reference in shape.iter("ref"))
        ]
        if itu is not None and users:
            used.append((name, itu, users))
    return used


def undefined_materials(root: ET.Element, carrier_frequency: float, file: Path) -> list[str]:
    """Sentences on the ITU materials that Recommendation P.2040 does not define at this frequency, each with its
    remedy: the nearest material that is defined there."""
    table, wrong, ghz = _itu_table(), [], carrier_frequency / 1e9
    for name, itu, users in _used_itu_types(root):
        where = f"{file.name}: material {name!r} of object {', '.join(users[:3])}{'…' if len(users) > 3 else ''}"
        if itu not in table:
            near = difflib.get_close_matches(itu, table, n=1)
            wrong.append(
                f"{where} has the unknown ITU type {itu!r}"
                + (f"; did you mean {near[0]!r}?" if near else f"; known are {', '.join(table)}")
            )
        elif not any(low <= ghz <= high for low, high in table[itu]):
            ranges = ", ".join(f"{low:g} to {high:g} GHz" for low, high in sorted(table[itu]))
            wrong.append(
                f"{where} is {itu!r}, which is defined for {ranges} and not at "
                f"{carrier_frequency / 1e9:g} GHz; {_other_material(name, itu, ghz)}"
            )
    return wrong


def defined_materials(source: SceneSource, carrier_frequency: float) -> dict[str, str]:
    """Material of a scene → the one most like it, for every ITU material in use that is undefined at this frequency."""
    file = scene_file(source.path)
    root, table = ET.fromstring(source.xml or file.read_text(encoding="utf-8")), _itu_table()
    used = {name.removeprefix("mat-"): itu for name, itu, _ in _used_itu_types(root) if itu in table}
    ghz = carrier_frequency / 1e9
    wrong = {name: itu for name, itu in used.items() if not any(low <= ghz <= high for low, high in table[itu])}
    return {name: other for name, itu in wrong.items() if (other := _most_alike(itu, ghz)) is not None}


def _other_material(name: str, itu: str, ghz: float) -> str:
    """The remedy: of the materials defined at this frequency the one that is most alike where both are defined."""
    alike = _most_alike(itu, ghz)
    if alike is None:
        return "no ITU material is: choose another radio.carrier_frequency, or a radio-material with values of your own"
    return (
        f"map it in the scenario: [scene.materials] {name.removeprefix('mat-')} = {alike!r} (of all defined there the "
        f"nearest in permittivity; or another ITU type)"
    )


def _most_alike(itu: str, ghz: float) -> str | None:
    """Of the materials defined at this frequency the one nearest in permittivity."""
    table = _itu_table()
    defined = [n for n, rows in table.items() if n != "vacuum" and any(low <= ghz <= high for low, high in rows)]
    return min(defined, key=lambda other: abs(_permittivity(other) - _permittivity(itu)), default=None)


def _permittivity(itu: str) -> float:
    """Relative permittivity at the low end of a material's first range."""
    (low, _), (a, b, _, _) = next(iter(_itu_table()[itu].items()))
    return a * low**b


def _inside(carrier_frequency: float, root: ET.Element) -> float:
    """The carrier, or a neighbor 1e-6 away if a material's range ends exactly there.

    Sionna computes in single precision, where 60 GHz is more than 60 times 1 GHz and marble is defined up to 60 GHz.
    """
    table = _itu_table()
    ranges = [list(table[itu]) for _, itu, _ in _used_itu_types(root)]

    def defined(frequency: float) -> bool:
        ghz = float(np.float32(frequency) * np.float32(1e-9)), float(np.float32(frequency) / np.float32(1e9))
        return all(any(low <= min(ghz) and max(ghz) <= high for low, high in rows) for rows in ranges)

    choices = (carrier_frequency * (1 + change) for change in (0.0, -1e-6, 1e-6))
    return next((choice for choice in choices if defined(choice)), carrier_frequency)
