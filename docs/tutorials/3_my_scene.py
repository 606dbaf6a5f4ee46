#!/usr/bin/env python3
"""# 3. My scene and my track

A scene is a folder with a `scenario.toml`; what it leaves out follows from what it says, and is printed. `dopslam new` writes one
from a kind, a floor plan, a map or a model.
"""

# %% A folder of one's own
# A generated room, a carrier, and a drive through way points (x, y, time). The way points lie near the place that the generator
# would start from; a track that runs into a wall is refused before anything is traced.
import tempfile
from pathlib import Path

import numpy as np

import dopslam as ds

START = ds.load("ring_road").name  # any shipped scene can be read the same way
with tempfile.TemporaryDirectory() as folder:
    place = Path(folder, "scenario.toml")
    place.write_text('name = "my room"\n[scene]\ngenerator = "room"\nseed = 7\n', encoding="utf-8")
    draft = ds.load(folder)
    x, y, heading, _ = draft.track.start
    ahead = np.array([np.cos(heading), np.sin(heading)])
    points = [[x, y, 0.0], [*(np.array([x, y]) + 0.5 * ahead), 1.0], [*(np.array([x, y]) + 0.8 * ahead), 2.0]]
    way = ", ".join(f"[{a:.3f}, {b:.3f}, {t}]" for a, b, t in points)
    place.write_text(place.read_text() + f"[track]\nwaypoints = [{way}]\nperiod = 0.5\n", encoding="utf-8")
    room = ds.load(folder)
print(room.name, "base station at", room.base_station.position, "pilots", room.radio.subcarriers)

# %% What a run will see
# Tracing gives every path with its interaction points. `dopslam check FOLDER` says which of them a receiver can see, and what
# could be done about the others.
truth = ds.trace(room, seed=0)
print(truth.track.steps, "steps,", len(truth.landmarks), "landmarks,", len(truth.paths.tau), "paths")
for name, order in zip(truth.landmarks.name[:6], truth.landmarks.order[:6], strict=True):
    print(f"  {name} ({order} reflections)")

# %% From here
#     dopslam new mine --kind street          # or --from plan.geojson, .osm, .glb
#     dopslam check mine
#     dopslam run mine
