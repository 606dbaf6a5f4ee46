#!/usr/bin/env python3
"""The whole-run smoother on paper A's detections: time over the length of a run, and a clock that jumps beside a steady one.

python scripts/batch_study.py --steps 40 400 4000 10000 --runs 20 --seed 1000
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

from dopslam.evaluate.metrics import state_errors
from dopslam.filters import FILTERS
from dopslam.models.scans import Scans
from dopslam.pipeline.problem import told
from dopslam.simulate.world import section_v, simulate
from dopslam.slam.filter import Problem, run

JUMP = 30.0  # m, standard deviation of the clock bias drawn anew at every scan
ANYTHING = 1e4  # m, process noise of a clock that may be anything


def seconds(steps: int, seed: int) -> tuple[float, float]:
    """CPU time [s] of batch over a run, and detections a scan."""
    world = section_v(steps=steps)
    _, scans = simulate(world, seed, 0)
    start = time.process_time()
    run(told(world), scans, FILTERS["batch"]())
    return time.process_time() - start, len(scans.z) / steps


def squares(problem: Problem, scans: Scans, truth: np.ndarray) -> float:
    """Mean square error of the position [m²]."""
    history, _ = run(problem, scans, FILTERS["batch"]())
    return float(np.mean(np.sum(state_errors(history.mean[:, :4], truth)[:, :2] ** 2, axis=1)))


def jumping(seed: int) -> tuple[float, float]:
    """Mean square errors [m²] with a steady clock and, on the same detections otherwise, with one that jumps."""
    world = section_v()
    truth, scans = simulate(world, seed, 0)
    problem, noise = told(world), world.motion.process_noise.copy()
    noise[3, 3] = ANYTHING**2
    free = replace(problem, motion=replace(world.motion, process_noise=noise))
    late = scans.z.copy()
    late[:, 0] += np.random.default_rng(seed).normal(0, JUMP, scans.steps)[scans.step_of_row]
    return squares(problem, scans, truth), squares(free, replace(scans, z=late), truth)


def main() -> None:
    """Print one figure a line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, nargs="*", default=[40, 400, 4000, 10000], help="lengths that are timed")
    parser.add_argument("--runs", type=int, default=20, help="of the comparison of clocks")
    parser.add_argument("--seed", type=int, default=1000, help="of the first run")
    options = parser.parse_args()
    if options.steps:
        seconds(10, options.seed)  # compiles
    for steps in options.steps:
        spent, count = seconds(steps, options.seed)
        print(f"{steps} steps of {count:.1f} detections: {spent:.2f} s of CPU, {spent / steps * 1e3:.2f} ms a step")
    both = np.array([jumping(seed) for seed in range(options.seed, options.seed + options.runs)])
    if len(both):
        steady, jumped = np.sqrt(both.mean(axis=0))
        print(
            f"position RMSE: {steady:.4f} m with a steady clock, {jumped:.4f} m with one that jumps: × {jumped / steady:.2f}"
        )


if __name__ == "__main__":
    main()
