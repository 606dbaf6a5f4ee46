#!/usr/bin/env python3
"""A tour in cells: a run, own detections, an own filter, an own estimator, an own scene.

Open it in an editor that knows ``# %%`` cells, or run it whole: python scripts/tour.py (about a minute, most of it
compiling at the first time).
"""

# %% A run, stage by stage ---------------------------------------------------------------------------------------------
from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import dopslam as ds
from dopslam.models.motion import propagate, transition_jacobian
from dopslam.pipeline.link import signal_model
from dopslam.pipeline.stages import stack_detections
from estimation import Nomp

SCENE = """
name = "my room"
[scene]
generator = "room"
seed = 7
[track]
steps = 3
"""
SHORT = ["track.steps=5"]  # drop it to drive the whole turn
scenario = ds.load("ring_road", set=SHORT)
truth = ds.trace(scenario, seed=0)
detections = ds.estimate(scenario, ds.synthesize(scenario, truth, seed=0))
problem = ds.problem(scenario)
joint = ds.slam(problem, detections, ds.filters.Joint())
print(ds.evaluate(truth, ds.bound(problem, truth, detections), detections, joint=joint))

# %% Own detections: whatever measures delays and angles can be filtered ------------------------------------------------
# Here the estimator's own, with half of the paths thrown away and the covariances doubled: any arrays of these shapes do.
kept = np.arange(len(detections.delay)) % 2 == 0
counts = [int(kept[detections.rows(step)].sum()) for step in range(detections.steps)]
mine = replace(
    detections,
    offsets=np.concatenate([[0], np.cumsum(counts)]),
    covariance=2 * detections.covariance[kept],
    **{name: getattr(detections, name)[kept] for name in ("delay", "aoa", "aod", "radial_velocity", "gain", "snr")},
    **{name: getattr(detections, name)[kept] for name in ("anchor", "flags")},
)
thin = ds.slam(problem, mine, ds.filters.Joint())
print(ds.evaluate(truth, ds.bound(problem, truth, mine), thin=thin))


# %% An own filter: a frozen record with init and step ------------------------------------------------------------------
@dataclass(frozen=True)
class LineOfSight:
    """An extended Kalman filter that believes the earliest detection to be the line of sight, and ignores the others."""

    capabilities = ds.Capabilities(doppler=False)
    gate: float = 20.0

    def init(self, problem, rng):
        """The prior."""
        return problem, problem.mean, problem.covariance

    def step(self, state, scan, rng):
        """Predict, then update with the length of the earliest path."""
        problem, mean, covariance = state
        slope = transition_jacobian(mean, problem.motion)
        mean = propagate(mean, problem.motion)
        covariance = slope @ covariance @ slope.T + problem.motion.process_noise
        if len(scan.z):
            first = int(np.argmin(scan.z[:, 0]))
            away = np.array([*mean[:2], problem.height]) - problem.anchor
            h = np.array([*(away[:2] / np.linalg.norm(away)), 0.0, 1.0])
            innovation = scan.z[first, 0] - (np.linalg.norm(away) + mean[3])
            spread = h @ covariance @ h + scan.covariance[first, 0, 0]
            if innovation**2 < self.gate * spread:
                gain = covariance @ h / spread
                mean, covariance = mean + gain * innovation, covariance - spread * np.outer(gain, gain)
        return (problem, mean, covariance), ds.Info(ds.Estimate(mean, covariance))


sight = ds.slam(problem, detections, LineOfSight())
print(ds.evaluate(truth, ds.bound(problem, truth, detections), joint=joint, sight=sight))
# From the command line, on the same draws as ours: dopslam montecarlo ring_road --filter joint,scripts/tour.py:LineOfSight


# %% An own estimator: run(signal) -> estimation.Detections ------------------------------------------------------------
class Halved:
    """NOMP with half of the paths; a class of one's own gets the link and the options that its signature names."""

    def __init__(self, model, max_paths=30, max_speed=25.0, false_alarm_rate=0.01):
        options = {"max_paths": max(1, max_paths // 2), "max_speed": max_speed, "false_alarm_rate": false_alarm_rate}
        self.inner = Nomp(model, **options)

    def run(self, signal):
        """Detections of one snapshot."""
        return self.inner.run(signal)


signal = ds.synthesize(scenario, truth, seed=0)
estimator = Halved(signal_model(scenario), max_paths=8)
few = stack_detections(scenario, [estimator.run(signal.snapshot(step)) for step in range(signal.steps)], signal.time)
print(ds.evaluate(truth, ds.bound(problem, truth, few), few=ds.slam(problem, few, ds.filters.Joint())))
# In a scenario: [estimator] kind = "my_estimator.py:Halved"; every command then uses it.

# %% An own scene: a folder with a scenario.toml; the rest follows from what it says (see also: dopslam new) --------------
with tempfile.TemporaryDirectory() as folder:
    Path(folder, "scenario.toml").write_text(SCENE, encoding="utf-8")
    room = ds.load(folder)
print(room.name, "at", room.base_station.position, f"{room.radio.subcarriers} pilots")
inside = ds.trace(room, seed=0)
print(len(inside.landmarks), "landmarks,", len(inside.paths.tau), "paths in", inside.track.steps, "steps")
