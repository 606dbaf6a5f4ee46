#!/usr/bin/env python3
"""# 1. A run, read line by line

A receiver drives a circle inside four walls; a base station in the middle sends; what arrives are the direct path, reflections
and echoes of small objects. From them the receiver finds where it is and what is around it. Run the whole:
`python docs/tutorials/1_a_run.py`, or cell by cell in an editor that knows `# %%`.
"""

# %% The scenario
# Everything about a run stands in one scenario; `set` overrides any key (`dopslam keys` lists them).
import numpy as np

import dopslam as ds

scenario = ds.load("ring_road", set=["track.steps=12"])
print("base station", scenario.base_station.position, "carrier", scenario.radio.carrier_frequency / 1e9, "GHz")

# %% Truth and detections
# `ds.trace` drives through the scene and traces rays, `ds.synthesize` makes the received signal of them, `ds.estimate` finds paths
# in it; together they take some seconds a step. `ds.simulate` draws detections from the measurement model instead, at once.
truth, detections = ds.simulate(scenario, seed=0)
first = detections.rows(0)
print("snapshot 1:", len(detections.delay[first]), "detections")
for delay, (azimuth, elevation) in zip(detections.delay[first], detections.aoa[first], strict=True):
    print(
        f"  {delay * 299.792458e6:7.2f} m of path and clock, from {np.degrees(azimuth):7.1f}° / {np.degrees(elevation):5.1f}°"
    )

# %% What the filter is told, and the filter
# A problem holds the base station, the start and its uncertainty, the motion, how detections come about. No filter sees more.
problem = ds.problem(truth.scenario)
joint = ds.slam(problem, detections, ds.filters.Joint())
print("last state", np.round(joint.mean[-1], 3), "± ", np.round(np.sqrt(np.diag(joint.covariance[-1])), 3))

# %% The map
# A landmark has a kind (1 virtual anchor, 2 scatter point), a place with its covariance and a probability of existence. A virtual
# anchor is the base station mirrored at a wall; `dopslam.evaluate.walls` turns it into the wall.
last = joint.rows(joint.steps - 1)
for kind, place, existence in zip(joint.kind[last], joint.position[last], joint.existence[last], strict=True):
    print(f"  kind {kind} at {np.round(place, 1)}, existence {existence:.3f}")

# %% How good it is
# The bound is the least error that any unbiased filter can have with these very detections. RMSE over bound near 1 is efficient,
# NEES near 4 says that the filter's own covariance is right.
bound = ds.bound(problem, truth, detections)
result = ds.evaluate(truth, bound, detections, joint=joint)
print(result)

# %% The same from the command line
#     dopslam run ring_road --source model --set track.steps=12 --filter joint
#
# leaves a folder with report.html: a replay, the table above, figures. Without `--source model` it traces.
