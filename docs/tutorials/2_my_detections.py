#!/usr/bin/env python3
"""# 2. My detections

Whatever measures delays and angles can be filtered: a table of one's own becomes a dataset file, or arrays become a record.
"""

# %% Arrays become a record
# Any arrays of these shapes do: flat columns, `offsets` says which rows belong to which snapshot. Here they are drawn from the
# model; then every third one is thrown away and the covariances are doubled, as if a poorer receiver had measured.
import csv
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import dopslam as ds
from dopslam.cli import main

scenario = ds.load("ring_road", set=["track.steps=10"])
truth, detections = ds.simulate(scenario, seed=1)
kept = np.arange(len(detections.delay)) % 3 != 0
counts = [int(kept[detections.rows(step)].sum()) for step in range(detections.steps)]
columns = ("delay", "aoa", "aod", "radial_velocity", "gain", "snr", "anchor", "flags")
mine = replace(
    detections,
    offsets=np.concatenate([[0], np.cumsum(counts)]),
    covariance=2 * detections.covariance[kept],
    **{name: getattr(detections, name)[kept] for name in columns},
)
problem = ds.problem(truth.scenario)
thin = ds.slam(problem, mine, ds.filters.Joint())
print(ds.evaluate(truth, ds.bound(problem, truth, mine), thin=thin))

# %% A table becomes a dataset file
# Somebody else's table: nanoseconds, degrees, zenith angles. A short TOML says what its columns mean.
MAPPING = """
[columns]
time = "t"
delay = "toa_ns"
aoa_azimuth = "phi_deg"
aoa_elevation = "theta_deg"
aod_azimuth = "dod_az"
aod_elevation = "dod_el"
radial_velocity = "v"
[units]
delay = "ns"
aoa_azimuth = "deg"
aoa_elevation = "deg"
[conventions]
elevation = "zenith"
[std]
delay = 0.35
aoa_azimuth = 3
aoa_elevation = 3
aod_azimuth = 0.05
aod_elevation = 0.05
radial_velocity = 0.1
"""
with tempfile.TemporaryDirectory() as folder:
    table, rule, data = Path(folder, "table.csv"), Path(folder, "columns.toml"), Path(folder, "mine.h5")
    rule.write_text(MAPPING)
    step = np.repeat(np.arange(detections.steps), np.diff(detections.offsets))
    with open(table, "w", newline="") as file:
        lines = csv.writer(file)
        lines.writerow(["t", "toa_ns", "phi_deg", "theta_deg", "dod_az", "dod_el", "v"])
        lines.writerows(
            np.column_stack([
                detections.time[step], detections.delay * 1e9, np.degrees(detections.aoa[:, 0]),
                90 - np.degrees(detections.aoa[:, 1]), detections.aod[:, 0], np.pi / 2 - detections.aod[:, 1],
                detections.radial_velocity,
            ]).tolist()
        )  # fmt: skip
    # On the command line: dopslam import table.csv --map columns.toml --scene ring_road --out mine.h5
    main(["import", str(table), "--map", str(rule), "--scene", "ring_road", "--out", str(data)])
    # and: dopslam slam mine.h5 --filter joint
    main(["slam", str(data), "--filter", "joint"])
    # To look at what was found, without a truth too: dopslam view mine.h5
    main(["view", "--no-open", str(data)])
    # The walls that were found, for a map program: dopslam export mine.h5 --to geojson --out map
    main(["export", str(data), "--to", "geojson", "--out", str(Path(folder, "map"))])
