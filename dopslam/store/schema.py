"""The dataset file's schema in one place: for every array its unit, frame and dimensions.

Version 1. A group per record; a dataset per array; ragged columns lie flat with an ``…offsets`` column that rises
from 0 to the
number of rows. The dimension names become HDF5 dimension scales, so that xarray (engine ``h5netcdf``) opens a group
as it is.
Frames: ``world`` right-handed, z up; ``receiver`` with azimuth counted from the heading; ``base station`` turned by
its yaw.
"""

from __future__ import annotations

import h5py

UNITS = {
    "time": "s", "position": "m", "heading": "rad", "velocity": "m/s", "bias": "m", "start": "m, m, rad, m",
    "tau": "s", "theta_t": "rad", "phi_t": "rad", "theta_r": "rad", "phi_r": "rad", "doppler": "Hz", "vertices": "m",
    "delay": "s", "aoa": "rad", "aod": "rad", "radial_velocity": "m/s", "noise_variance": "W", "gain": "sqrt(W)",
    "state": "m, m, rad, m", "y": "sqrt(W)", "points": "m", "triangles": "m",
}  # fmt: skip

FRAMES = {
    "position": "world", "heading": "world", "velocity": "world", "theta_t": "world", "phi_t": "world",
    "theta_r": "world", "phi_r": "world", "vertices": "world", "points": "world", "triangles": "world", "aoa": "receiver", "aod": "base station",
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
        "vertex_offsets": ("path_edge",), "vertices": ("vertex", "xyz"),
    },
    "DetectionSeries": {
        "offsets": ("step_edge",), "delay": ("detection",), "aoa": ("detection", "az_el"), "aod": ("detection", "az_el"),
        "radial_velocity": ("detection",), "gain": ("detection",), "covariance": ("detection", "parameter", "parameter_"),
        "snr": ("detection",), "noise_variance": ("step",),
    },
    "FloorPlan": {"name": ("outline",), "offsets": ("outline_edge",), "points": ("point", "xy")},
    "Mesh": {"triangles": ("triangle", "corner", "xyz")},
    "Signal": {"y": ("step", "subcarrier", "symbol", "element")},
}  # fmt: skip


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
        if name in FRAMES:
            set_text(data, "frame", FRAMES[name])
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
