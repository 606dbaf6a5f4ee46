#!/usr/bin/env python3
"""# 5. My estimator and my channel measurements

An estimator is a class with `run(signal)`; a channel measurement is an array of complex numbers (pilots, symbols, receive elements).
"""

# %% A channel measurement
# The link says how many pilots, which beams and arrays. Here two paths make the signal; a measurement of one's own would be an
# array of the same shape, and `noise` the variance of a sample.
from types import SimpleNamespace

import numpy as np

import dopslam as ds
from dopslam.pipeline.link import noise_variance, signal_model
from dopslam.pipeline.stages import stack_detections
from estimation import Nomp, PathTable, synthesize

scenario = ds.load("ring_road", set=["track.steps=2"])
link, noise = signal_model(scenario), noise_variance(scenario)
paths = PathTable(
    delay=[1.2e-6, 1.35e-6],
    aoa=[[0.3, 0.5], [-1.2, 0.2]],
    aod=[[-2.8, -0.5], [1.0, -0.2]],
    radial_velocity=[12.0, -3.0],
    gain=np.sqrt(noise) * np.array([0.6j, 0.3]),
)
rng = np.random.default_rng(0)
snapshots = [synthesize(link, paths, noise_variance=noise, rng=rng) for _ in range(2)]
print("a snapshot is", np.shape(snapshots[0]), "complex numbers")


# %% An estimator
# It gets the link and those options that its signature names. This one is ours with a quarter of the paths.
class Few:
    """NOMP that looks for few paths."""

    def __init__(self, model, max_paths=30, max_speed=25.0, false_alarm_rate=0.01):
        self.inner = Nomp(
            model, max_paths=max(1, max_paths // 4), max_speed=max_speed, false_alarm_rate=false_alarm_rate
        )

    def run(self, signal):
        """Detections of one snapshot."""
        return self.inner.run(signal)


# %% What it finds
# Every detection has a covariance. As a record (`stack_detections`) they go into `ds.slam` like any others.
if __name__ == "__main__":
    found = [Few(link, max_paths=12).run(snapshot) for snapshot in snapshots]
    for delay, covariance in zip(found[0].delay, found[0].covariance, strict=True):
        print(f"  delay {delay * 1e6:.5f} µs ± {1e12 * np.sqrt(covariance[0, 0]):.1f} ps")
    series = stack_detections(scenario, found, np.array([0.5, 1.0]))
    print(series.steps, "snapshots,", len(series.delay), "detections")

# %% In a scenario, and with whole measurements
#     [estimator]
#     kind = "docs/tutorials/5_my_estimator.py:Few"
#
# makes every command use it. Channel measurements of one's own are anything with `steps`, `time` and `snapshot(k)`:
measured = SimpleNamespace(steps=2, time=np.array([0.5, 1.0]), snapshot=lambda step: snapshots[step])
if __name__ == "__main__":
    print(len(ds.estimate(scenario, measured).delay), "detections by the scenario's own estimator")
