#!/usr/bin/env python3
"""# 4. My filter, in the table

A filter is a frozen record with `init` and `step`. It runs in every command by the name of its file, on the same draws as the
others, and on the benchmark.
"""

# %% The filter
# This one believes the earliest detection to be the direct path, uses its length alone, and makes no map. What it is told is the
# problem; what it answers is an `Estimate` of the receiver (and of the map, if it has one).
from dataclasses import dataclass

import numpy as np

import dopslam as ds
from dopslam.models.motion import propagate, transition_jacobian


@dataclass(frozen=True)
class Earliest:
    """An extended Kalman filter on the length of the earliest detection."""

    gate: float = 20.0
    capabilities = ds.Capabilities(doppler=False)

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


# %% In the table
# Many draws, the same for both: ratios to the bound with their intervals.
if __name__ == "__main__":
    scenario = ds.load("ring_road", set=["track.steps=8", "source.kind=model"])
    study = ds.montecarlo(
        ds.world(scenario), ds.problem(scenario), {"joint": ds.filters.Joint(), "mine": Earliest()}, runs=5
    )
    print(study)

# %% On the benchmark
#     dopslam montecarlo ring_road --filter joint,docs/tutorials/4_my_filter.py:Earliest
#     dopslam benchmark make suite
#     dopslam benchmark run suite --filter docs/tutorials/4_my_filter.py:Earliest
#     dopslam score answers/Earliest.csv --suite suite --json Earliest.json
# A board of one's own from the result files of answers to one suite:
#     dopslam benchmark run suite --filter joint && dopslam score answers/joint.csv --suite suite --json joint.json
#     python scripts/board.py Earliest.json joint.json
