"""The dataset file's schema in one place: for every array its unit, frame and dimensions.

Version 2. A group per record; a dataset per array; ragged columns lie flat with an ``…offsets`` column that rises
from 0 to the number of rows. The dimension names become HDF5 dimension scales, so that xarray (engine ``h5netcdf``)
opens a group as it is. Frames: ``world`` right-handed, z up; ``receiver`` with azimuth counted from the heading;
``base station`` turned by its yaw.

Version 1 had no ``anchor`` and ``flags`` (all 0), no ``time`` of detections, no ``base_stations``, and in histories the
probability of a virtual anchor alone (:data:`EARLIER`); it is still read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import h5py
import numpy as np

SCHEMA = "dopslam"
VERSION = 2
READ = (1, VERSION)  # versions this program reads
UNSAID = "1"  # what version 1 wrote where it did not know the unit

UNITS: dict[Any, str] = {
    "time": "s", "position": "m", "heading": "rad", "velocity": "m/s", "bias": "m", "start": "m, m, rad, m",
    "tau": "s", "theta_t": "rad", "phi_t": "rad", "theta_r": "rad", "phi_r": "rad", "doppler": "Hz", "vertices": "m",
    "delay": "s", "aoa": "rad", "aod": "rad", "radial_velocity": "m/s", "noise_variance": "W", "gain": "sqrt(W)",
    "state": "m, m, rad, m", "y": "sqrt(W)", "points": "m", "yaw": "rad", "triangles": "m", "index": "1", "drive": "1", "step": "1",
    "name": "1", "kind": "1", "order": "1", "offsets": "1", "vertex_offsets": "1", "map_offsets": "1", "landmark": "1",
    "anchor": "1", "flags": "1", "a": "1", "snr": "1", "existence": "1", "type_probability": "1", "track": "1",
    "mean": "m, m, rad, m", "covariance": "products of m, m, rad, m", "position_covariance": "m^2",
    "normal": "1", "offset": "m", "corners": "m", ("Walls", "covariance"): "products of 1, 1, 1, m",
    ("DetectionSeries", "covariance"): "products of s, rad, rad, rad, rad, m/s", ("Bound", "landmark"): "m^2",
}  # fmt: skip

# What a unit does not say.
DESCRIPTIONS = {
    ("Paths", "tau"): "geometric delay, without the clock bias",
    ("Paths", "a"): "amplitude in Sionna's convention, without exp(-2j pi f_c tau), isotropic vertical elements",
    ("Paths", "doppler"): "positive when approaching",
    ("Paths", "anchor"): "row of base_stations",
    ("DetectionSeries", "delay"): "as measured: geometric delay plus clock bias / c, modulo delay_range",
    ("DetectionSeries", "radial_velocity"): "positive when approaching",
    ("DetectionSeries", "anchor"): "row of base_stations",
    (
        "DetectionSeries",
        "flags",
    ): "bits: 1 close pair, 2 edge of view, 4 weak, 8 singular, 16 ambiguous, 32 merged, 64 limited",
    (
        "DetectionSeries",
        "covariance",
    ): "of delay, aoa azimuth, aoa elevation, aod azimuth, aod elevation, radial_velocity",
    ("Track", "bias"): "clock bias times c; the receiver's clock is late by it",
    ("Landmarks", "kind"): "0 BS, 1 VA, 2 SP",
    ("History", "kind"): "1 VA, 2 SP, 3 second reflection: the likeliest type",
    ("History", "type_probability"): "given existence; columns BS, VA, SP and, since second reflections are a type, SR",
    ("History", "mean"): "x, y, heading, clock bias times c (, speed m/s, turn rate rad/s)",
    ("Bound", "covariance"): "of x, y, heading, clock bias times c (, speed m/s, turn rate rad/s)",
    ("Walls", "normal"): "unit vector from the base station outwards; normal . p = offset on the wall",
    ("Walls", "covariance"): "of normal x, y, z and offset",
    ("Walls", "corners"): "extent: rectangle in the plane around the incidence points that were seen",
    ("Walls", "track"): "of the virtual anchor in the map",
    ("Bound", "landmark"): "of each landmark's position; NaN before its first detection and for the BS",
}

FRAMES = {
    "position": "world", "position_covariance": "world", "yaw": "world", "heading": "world", "velocity": "world", "theta_t": "world", "phi_t": "world",
    "normal": "world", "corners": "world", "theta_r": "world", "phi_r": "world", "vertices": "world", "points": "world", "triangles": "world", "aoa": "receiver", "aod": "base station",
}  # fmt: skip

# Names of the dimensions of every array of a record, the leading ones first.
DIMENSIONS: dict[str, dict[str, tuple[str, ...]]] = {
    "Track": {
        "time": ("step",), "position": ("step", "xyz"), "heading": ("step",), "velocity": ("step", "xyz"),
        "bias": ("step",), "start": ("state",),
    },
    "Steps": {"index": ("place",), "drive": ("place",), "step": ("place",), "start": ("place", "state")},
    "Landmarks": {
        "name": ("landmark",), "kind": ("landmark",), "position": ("landmark", "xyz"), "order": ("landmark",),
    },
    "Paths": {
        "offsets": ("step_edge",), "landmark": ("path",), "a": ("path",), "tau": ("path",), "theta_t": ("path",),
        "phi_t": ("path",), "theta_r": ("path",), "phi_r": ("path",), "doppler": ("path",),
        "vertex_offsets": ("path_edge",), "vertices": ("vertex", "xyz"), "anchor": ("path",),
    },
    "DetectionSeries": {
        "offsets": ("step_edge",), "delay": ("detection",), "aoa": ("detection", "az_el"), "aod": ("detection", "az_el"),
        "radial_velocity": ("detection",), "gain": ("detection",), "covariance": ("detection", "parameter", "parameter_"),
        "snr": ("detection",), "noise_variance": ("step",), "anchor": ("detection",), "flags": ("detection",),
        "time": ("step",),
    },
    "BaseStations": {"position": ("base_station", "xyz"), "yaw": ("base_station",)},
    "History": {
        "mean": ("step", "state"), "covariance": ("step", "state", "state_"), "map_offsets": ("step_edge",),
        "position": ("entry", "xyz"), "position_covariance": ("entry", "xyz", "xyz_"), "existence": ("entry",),
        "type_probability": ("entry", "type"), "kind": ("entry",), "track": ("entry",),
    },
    "Bound": {
        "covariance": ("step", "state", "state_"), "landmark": ("step", "landmarks", "xyz", "xyz_"),
    },
    "Walls": {
        "track": ("wall",), "normal": ("wall", "xyz"), "offset": ("wall",), "covariance": ("wall", "plane", "plane_"),
        "corners": ("wall", "corner", "xyz"), "existence": ("wall",),
    },
    "FloorPlan": {"name": ("outline",), "offsets": ("outline_edge",), "points": ("point", "xy")},
    "Mesh": {"triangles": ("triangle", "corner", "xyz")},
    "Signal": {"y": ("step", "subcarrier", "symbol", "element")},
}  # fmt: skip

FIXED = {
    "xyz": 3,
    "xyz_": 3,
    "xy": 2,
    "az_el": 2,
    "parameter": 6,
    "parameter_": 6,
    "plane": 4,
    "plane_": 4,
}  # lengths that never vary


TEXTS = {"name"}
COMPLEX = {"a", "gain", "y"}
INTEGERS = {
    "offsets",
    "vertex_offsets",
    "map_offsets",
    "kind",
    "order",
    "track",
    "index",
    "drive",
    "step",
    "anchor",
    "flags",
}
MAY_LACK = {("Track", "bias"), ("Bound", "landmark")}  # NaN where nothing is known


def fault_of(record: str, columns: Mapping[str, np.ndarray]) -> str:
    """What is wrong with the types, shapes and values of a record's arrays, naming the array; empty if nothing is."""
    sizes: dict[str, tuple[str, int]] = {}
    for name, array in columns.items():
        allowed = "OUS" if name in TEXTS else "iufc" if name in COMPLEX else "iu" if _counts(record, name) else "iuf"
        if array.dtype.kind not in allowed:
            return f"{name} holds {array.dtype}, no {'text' if name in TEXTS else 'whole numbers' if allowed == 'iu' else 'numbers'}"
        named = DIMENSIONS.get(record, {}).get(name)
        if named is None:
            continue
        wanted = "(" + ", ".join(str(FIXED.get(dimension, dimension)) for dimension in named) + ")"
        if array.ndim != len(named):
            return f"{name} has the shape {array.shape}, expected {wanted}"
        for dimension, size in zip(named, array.shape, strict=True):
            base = dimension.rstrip("_").removesuffix("_edge")
            rows = size - 1 if dimension.endswith("_edge") else size
            if FIXED.get(dimension, size) != size or (base in sizes and sizes[base][1] != rows):
                other = f", {sizes[base][0]} gives {sizes[base][1]} for {base!r}" if base in sizes else ""
                return f"{name} has the shape {array.shape}, expected {wanted}{other}"
            sizes[base] = name, rows
        if array.dtype.kind in "fc":
            bad = np.isinf(array) if (record, name) in MAY_LACK else ~np.isfinite(array)
            if bad.any():
                row = int(np.argmax(bad.reshape(len(array), -1).any(axis=1))) if array.ndim else 0
                return f"{name} holds non-finite values, the first in row {row}"
    return ""


def _counts(record: str, name: str) -> bool:
    """Whether an array holds whole numbers."""
    return name in INTEGERS or (name == "landmark" and record != "Bound")


def _types_of_version_1(probability: np.ndarray) -> np.ndarray:
    """(N, 3) type probabilities from the probability of a virtual anchor (N,), the rest a scatter point's."""
    return np.column_stack([np.zeros_like(probability), probability, 1 - probability])


# (record, array) → the array that an earlier version had instead, and how to read it.
EARLIER: dict[tuple[str, str], tuple[str, Callable[[np.ndarray], Any]]] = {
    ("History", "type_probability"): ("va_probability", _types_of_version_1),
}


def remedy(path, group: str, have: set[str]) -> str:
    """What makes a group that is not there, given those that are."""
    if group in ("track", "landmarks") and "detections" in have:
        return (
            "bring the true track along: dopslam import TABLE … --track TRACK.csv; what was found without it: "
            f"dopslam view {path}, or dopslam export {path} --to csv --out FOLDER, or tum, geojson, mcap"
        )
    if group == "detections" and have & {"paths", "signal"}:
        return f"run 'dopslam estimate {path}' first"
    if group == "detections":
        return "make them with 'dopslam trace' and 'dopslam estimate', draw them with 'dopslam simulate', or bring your own with 'dopslam import'"
    if group.startswith(("slam_", "walls_")):
        return f"run 'dopslam slam {path}' first"
    if group.startswith("bound_"):
        return f"run 'dopslam bound {path}' first"
    return "only a traced scene has it: begin with 'dopslam trace SCENE --out FILE'"


def unit_of(record: str, name: str) -> str:
    """Unit of an array of a record."""
    return UNITS.get((record, name), UNITS.get(name, "1"))


def set_text(node: h5py.HLObject, name: str, text: str) -> None:
    """Set a text attribute of fixed length, which lies in the checksummed header.

    Texts of variable length lie in HDF5's global heap, which has no checksum and whose damage can hang the library.
    """
    size = max(1, len(text.encode()))
    node.attrs.create(name, text.encode(), dtype=h5py.string_dtype("utf-8", size))


def plain(value):
    """An attribute as a Python value: text, number or truth value."""
    if isinstance(value, bytes):
        return value.decode()
    return value.item() if hasattr(value, "item") and getattr(value, "ndim", 0) == 0 else value


def annotate(node: h5py.Group, record: str) -> None:
    """Add frames and dimension scales to a record's group; the content and its hash stay as they are."""
    dimensions = DIMENSIONS.get(record, {})
    for name in dimensions.keys() & node.keys():
        data, named = node[name], dimensions[name]
        assert isinstance(data, h5py.Dataset)  # a column that was just written
        if name in FRAMES:
            set_text(data, "frame", FRAMES[name])
        if (record, name) in DESCRIPTIONS:
            set_text(data, "description", DESCRIPTIONS[record, name])
        if data.ndim != len(named):
            continue
        for axis, dimension in enumerate(named):
            if dimension not in node:
                _make_scale(node, dimension, data.shape[axis])
            data.dims[axis].attach_scale(node[dimension])


def _make_scale(node: h5py.Group, name: str, size: int) -> None:
    """A dimension that has a name and a length but no values, as netCDF writes it; it takes no room in the file."""
    scale = node.create_dataset(name, shape=(size,), dtype=">f4")
    scale.make_scale(f"This is a netCDF dimension but not a netCDF variable. {size:10d}")


def is_scale(node: h5py.Group, name: str) -> bool:
    """Whether a dataset only names a dimension."""
    return node[name].attrs.get("CLASS") == b"DIMENSION_SCALE"
