"""A new scene folder that runs: from a kind, from a scene that ships with the ray tracer, or from a plan, map or model."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from dopslam.config.scenario import load
from dopslam.errors import ConfigError, SceneError
from dopslam.pipeline import preflight
from dopslam.scenes.generators import GENERATORS, generate
from dopslam.scenes.generators.mitsuba import write_shapes
from dopslam.scenes.generators.place import INDOOR, OUTDOOR, Placed, level_places, place, terrain
from dopslam.scenes.plans import read_plan
from dopslam.scenes.plans.raise_ import INDOOR as INDOOR_EXTENT
from dopslam.scenes.plans.raise_ import Usual

HILLY = 2.0  # m, between the lowest and the highest ground
LAYOUTS = 5  # random places tried before a scene counts as having none


def new_scene(
    folder: Path, kind: str | None = None, source: Path | None = None, seed: int = 0, scale: float | None = None,
    carrier: float = 28e9, bandwidth: float | None = None, usual: Usual | None = None,
) -> None:  # fmt: skip
    """Write a folder with ``scenario.toml`` and, unless the scene ships elsewhere, ``scene.xml``.

    Parameters
    ----------
    folder : new
    kind : a generator's name, or ``builtin:NAME``
    source : a plan, map or model; instead of ``kind``
    seed : of what is drawn
    scale : pixels to the meter, of a picture
    carrier, bandwidth : Hz
    usual : heights and materials where a plan says none

    Raises
    ------
    ConfigError, SceneError
        If the folder exists, the source cannot be read, or nothing can drive there; the folder is not left half made.
    """
    if folder.exists():
        raise ConfigError(f"{folder}: exists already; choose another name or remove it")
    if (kind is None) == (source is None):
        raise ConfigError("give either a kind or a file to start from")
    made = folder.with_name(f".{folder.name}.new")
    shutil.rmtree(made, ignore_errors=True)
    made.mkdir(parents=True)
    try:
        radio = {"carrier_frequency": carrier} | ({"bandwidth": bandwidth} if bandwidth else {})
        if kind in GENERATORS:
            scene = generate(kind, seed, None, carrier)
            write_shapes(scene.shapes, made)
            text = scenario_text(folder.name, f"{kind} {seed}", 'file = "scene.xml"', scene.keys | {"radio": radio})
            (made / "scenario.toml").write_text(text, encoding="utf-8")
            load(made)
        elif kind is not None and not kind.startswith("builtin:"):
            raise ConfigError(f"kind {kind!r}: known are {', '.join(GENERATORS)} and builtin:NAME")
        else:
            _placed(made, folder.name, kind, source, seed, scale, radio, usual)
        made.rename(folder)
    finally:
        shutil.rmtree(made, ignore_errors=True)


def _placed(made: Path, name: str, kind, source, seed, scale, radio: dict, usual) -> None:
    """A scene that says nothing of base station and drive: both are put where they are of use."""
    from dopslam import raytracing

    if source is not None:
        write_shapes(read_plan(Path(source), usual, scale), made)
        where, title = 'file = "scene.xml"', f"From {Path(source).name}"
        origin = raytracing.SceneSource(made / "scene.xml")
    else:
        builtin = kind.removeprefix("builtin:")
        where, title = f'builtin = "{builtin}"', f"Sionna RT's {builtin}"
        origin = raytracing.SceneSource(builtin)
    loaded = raytracing.load_geometry(origin)
    triangles = loaded.surfaces.triangles
    if not len(triangles):
        raise SceneError(f"{title}: holds no surface")
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    indoor = (high - low)[:2].max() < INDOOR_EXTENT
    ground = float(low[2]) if abs(low[2]) > 0.5 else 0.0
    habit = INDOOR if indoor else OUTDOOR
    if indoor:
        habit = replace(habit, station_height=float(np.clip(high[2] - ground - 0.4, 1.0, 3.0)))
    error, floor = None, terrain(triangles, loaded.surfaces.triangle_object)
    hilly = not indoor and len(floor) > 2 and np.ptp(floor[..., 2]) > HILLY
    for attempt in range(LAYOUTS * (3 if hilly else 1)):
        rng = np.random.default_rng([seed, attempt])
        level, spots = level_places(floor, rng) if hilly else (ground, None)
        placed = place(triangles, habit, level, raytracing.solids(loaded.surfaces), rng, spots)
        if placed is None:
            continue
        keys = {
            "base_station": {
                "position": list(placed.station),
                "yaw_deg": round(float(np.degrees(placed.yaw)), 1),
                "array": {"kind": "planar", "columns": 8, "rows": 8},
            },
            "receiver": {"height": placed.receiver_height, "array": {"kind": "cylinder", "columns": 8, "rings": 4}},
            "radio": radio,
            "track": _drive(placed, indoor),
            "trace": {"max_depth": 1},
            "source": {"traced": {"transmit_power_dbm": 0.0 if indoor else 20.0}},
        }
        materials = raytracing.defined_materials(origin, radio["carrier_frequency"])
        text = scenario_text(name, title, where, keys, materials)
        (made / "scenario.toml").write_text(text, encoding="utf-8")
        try:
            scenario = load(made)
            preflight.checked_scene(scenario, _nominal(placed, scenario.track.steps, scenario.track.period))
            return
        except SceneError as fault:
            error = fault
    raise error or SceneError(
        f"{title}: no place for a base station and a drive was found; write scenario.toml yourself, starting from "
        "'dopslam new NAME --kind street'"
    )


def _drive(placed: Placed, indoor: bool) -> dict:
    return {
        "speed": placed.speed,
        "turn_rate": 0.0,
        "period": 0.2,
        "steps": 50,
        "start": [*placed.start, 10.0],
        "start_std": [0.1, 0.1, 0.0052, 0.3] if indoor else [0.3, 0.3, 0.0052, 0.3],
    }


def _nominal(placed: Placed, steps: int, period: float) -> np.ndarray:
    x, y, heading = placed.start
    along = placed.speed * period * np.arange(1, steps + 1)
    height = np.full(steps, placed.receiver_height)
    return np.column_stack([x + along * np.cos(heading), y + along * np.sin(heading), height])


def _value(value) -> str:
    """A value as TOML, tables inline."""
    match value:
        case bool():
            return str(value).lower()
        case str():
            return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
        case dict():
            return "{ " + ", ".join(f"{key} = {_value(v)}" for key, v in value.items()) + " }"
        case list() | tuple():
            return "[" + ", ".join(map(_value, value)) + "]"
        case _:
            return f"{value:.10g}" if isinstance(value, float) and abs(value) < 1e6 else str(value)


def scenario_text(name: str, title: str, scene: str, keys: dict, materials: dict | None = None) -> str:
    """``scenario.toml`` with comments that say what may be changed and what follows by itself."""
    station, receiver, track = keys["base_station"], keys["receiver"], keys["track"]
    lines = [
        f"# {title}. Run it with: dopslam run {name}", f"name = {_value(name)}", f"title = {_value(title)}", "",
        "[scene]", scene,
        *([f"materials = {_value(materials)} # defined at this carrier instead"] if materials else []), "",
        "# World frame in meters, x east, y north, z up. yaw_deg is where a panel looks, counted from east to north.",
        "# Arrays: planar (a panel of patches), cylinder (sees all around).",
        "[base_station]", f"position = {_value(station['position'])}", f"yaw_deg = {_value(station['yaw_deg'])}",
        f"array = {_value(station['array'])}", "",
        "[receiver]", f"height = {_value(receiver['height'])}", f"array = {_value(receiver['array'])}", "",
        "# Pilots follow from carrier and bandwidth [Hz] unless subcarriers, subcarrier_spacing and comb are given.",
        "[radio]", *(f"{key} = {_value(value)}" for key, value in keys["radio"].items()), "",
        "# Where the receiver goes: speed [m/s], turn_rate [rad/s], period [s]; start: x, y [m], heading [rad], clock bias [m],",
        "# known to start_std. process_std (how far it strays in a step) follows from the speed unless given.",
        "[track]", *(f"{key} = {_value(value)}" for key, value in track.items()), "",
        "# Small objects that scatter, with their radar cross-section [m²]:",
    ]  # fmt: skip
    points = keys.get("scatter_point", [])
    if not points:
        lines += ["# [[scatter_point]]", '# name = "lamp"', "# position = [1.0, 2.0, 3.0]", "# rcs = 1.0", ""]
    for point in points:
        lines += ["[[scatter_point]]", *(f"{key} = {_value(value)}" for key, value in point.items()), ""]
    lines += [
        "# Reflections of a path, at most; two take longer.",
        "[trace]", f"max_depth = {keys['trace']['max_depth']}", "",
        "[source.traced]", f"transmit_power_dbm = {_value(keys['source']['traced']['transmit_power_dbm'])}", "",
    ]  # fmt: skip
    return "\n".join(lines)
