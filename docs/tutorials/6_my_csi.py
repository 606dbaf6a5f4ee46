#!/usr/bin/env python3
"""# 6. My channel measurements: from CSI to paths and a map

A file of complex numbers and a small TOML that says what its axes mean are enough. No scene, no scenario.
"""

# %% A measurement
# A receiver with eight antennas in a ring walks through a room of 16 m × 12 m; the base station is a panel on a wall.
# Here the room's walls are mirrors and this is all the physics there is; a measurement of one's own takes its place.
import tempfile
from pathlib import Path

import numpy as np

from dopslam.cli import main
from dopslam.pipeline.file import histories

CARRIER, SPACING, PERIOD = 28e9, 4e6, 125e-6  # Hz, Hz between subcarriers, s between symbols
LIGHT = 299_792_458.0
base = np.array([0.1, 5.0, 2.5])
speed = np.array([1.2, 0.5, 0.0])
images = {"base": base, "y=0": base * [1, -1, 1], "y=12": [0.1, 19.0, 2.5], "x=16": [31.9, 5.0, 2.5]}


def panel(rows, columns):
    """Positions of a panel's elements in wavelengths; element = row · columns + column."""
    z, y = np.meshgrid(np.arange(rows) - (rows - 1) / 2, np.arange(columns) - (columns - 1) / 2, indexing="ij")
    return 0.5 * np.stack([0 * y, y, z], axis=-1).reshape(-1, 3)


# The ring turns with the receiver: its first element looks ahead.
around = 2 * np.pi * np.arange(8) / 8 + np.arctan2(speed[1], speed[0])
ring = np.concatenate([0.653 * np.c_[np.cos(around), np.sin(around), 0 * around] + [0, 0, h] for h in (-0.25, 0.25)])
frequencies = SPACING * (np.arange(64) - 31.5)
times = PERIOD * (np.arange(8) - 3.5)


def channel(receiver):
    """Channel (receive, transmit, symbol, subcarrier) of one place: the base station and its mirror images."""
    total = np.zeros((16, 16, 8, 64), complex)
    for wall, image in images.items():
        way = np.asarray(image) - receiver
        length = np.linalg.norm(way)
        leaves = -way / length * {"y=0": [1, -1, 1], "y=12": [1, -1, 1], "x=16": [-1, 1, 1]}.get(wall, [1, 1, 1])
        gain = 1e-3 / length * (1 if wall == "base" else 0.4) * np.exp(-2j * np.pi * CARRIER * length / LIGHT)
        total += gain * np.einsum(
            "r,t,n,k->rtnk", np.exp(2j * np.pi * ring @ way / length), np.exp(2j * np.pi * panel(4, 4) @ leaves),
            np.exp(2j * np.pi * CARRIER / LIGHT * (speed @ way / length) * times),
            np.exp(-2j * np.pi * frequencies * length / LIGHT),
        )  # fmt: skip
    return total


rng = np.random.default_rng(0)
walk = np.array([4.0, 3.0, 1.5]) + 0.2 * np.arange(1, 11)[:, None] * speed
measured = np.array([channel(place) for place in walk])
measured += 1e-5 * (rng.standard_normal((*measured.shape, 2)) @ [1, 1j])
print("a measurement is", measured.shape)

# %% What the numbers mean
# The tables are those of a scenario; `[csi]` names the axes in the array's order. For the map, `[track]` says where the walk
# starts, if that is known; without, it is found from the paths.
MAPPING = f"""
[csi]
variable = "H"
axes = ["snapshot", "rx", "tx", "symbol", "subcarrier"]
period = 0.2
[radio]
carrier_frequency = {CARRIER}
subcarrier_spacing = {SPACING}
symbol_period = {PERIOD}
[receiver]
height = 1.5
array = {{ kind = "cylinder", columns = 8, rings = 2 }}
[base_station]
position = [0.1, 5.0, 2.5]
array = {{ kind = "planar", rows = 4, columns = 4 }}
"""


# %% Paths, and a map
# On the command line:
#
#     dopslam import my.npz --format csi --map csi.toml --out mine.h5
#     dopslam estimate mine.h5
#     dopslam slam mine.h5
#     dopslam export mine.h5 --to geojson --out map
if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        file, rule, data = Path(folder, "my.npz"), Path(folder, "csi.toml"), Path(folder, "mine.h5")
        np.savez(file, H=measured.astype(np.complex64))
        rule.write_text(MAPPING)
        main(["import", str(file), "--format", "csi", "--map", str(rule), "--out", str(data)])
        main(["estimate", str(data), "--jobs", "1"])
        main(["slam", str(data)])
        main(["export", str(data), "--to", "geojson", "--out", str(Path(folder, "map"))])
        history = next(iter(histories(data).values()))
        found = history.position[history.map_offsets[-2] : history.map_offsets[-1]]
        for wall, image in list(images.items())[1:]:
            print(f"image at {wall}: {np.linalg.norm(found - image, axis=1).min():.2f} m from what was mapped")
