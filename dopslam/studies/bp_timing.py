"""Time of one step of the stacked engine in a crowded, reproducible situation, and how it grows."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from dopslam.slam.belief.experiment import Experiment, draw_scan, draw_track, true_amplitudes
from dopslam.slam.belief.motion import particles
from dopslam.slam.belief.records import PAPER, Form, Scan
from dopslam.slam.belief.stacked.backends import backend
from dopslam.slam.belief.stacked.stacked import Stacked, StackedState
from dopslam.studies.bp_study import motion_of

_STANDARD = {"particles": 100_000, "features": 20, "measurements": 15}


def crowded_step(
    size: int, features: int, measurements: int, likelihoods: str = "drjit", seed: int = 0
) -> tuple[Stacked, StackedState, Scan]:
    """A filter, its converged state over ``features`` features of two types and a scan of ``measurements`` paths.

    Half of the features are virtual anchors; the scan holds the line of sight, two false alarms if there is room, and
    features' paths.
    """
    rng = np.random.default_rng(seed)
    anchors = features // 2
    bearing = rng.uniform(-np.pi, np.pi, features)
    reach = np.where(np.arange(features) < anchors, rng.uniform(15, 40, features), rng.uniform(5, 12, features))
    places = np.column_stack([reach * np.cos(bearing), reach * np.sin(bearing), np.zeros(features)])
    experiment = Experiment(
        features=places,
        forms=(Form.VA_AOD,) * anchors + (Form.PS,) * (features - anchors),
        amplitudes=(30.0, *(20.0,) * features),
        distances=(10.0, *(20.0,) * features),
        false_alarm_rate=float(measurements),
        steps=1,
    )
    truth = draw_track(experiment, rng)
    scan, source = draw_scan(experiment, truth.position[0], float(truth.heading[0]), 0, rng)
    true, false = np.flatnonzero(source >= 0), np.flatnonzero(source < 0)
    true = true[np.argsort(source[true])][: measurements - min(2, measurements - 1)]
    chosen = np.concatenate([true, false])[:measurements]
    parameters = replace(experiment.parameters, types=PAPER, false_alarm_rate=2.0)
    filter_ = Stacked(parameters, motion_of(experiment), experiment.radio, backend(likelihoods))
    spread = rng.standard_normal((2, size))
    agent = particles(
        np.column_stack([*(experiment.start[:2, None] + 0.005 * spread), np.zeros(size)]),
        np.column_stack([*(truth.velocity[0, :2, None] + 0.003 * rng.standard_normal((2, size))), np.zeros(size)]),
    )
    amplitude = true_amplitudes(experiment, truth.position[0])
    cloud = np.empty((2, 3, features, size), np.float32)
    for k in range(features):
        cloud[:, :2, k] = places[k, :2, None] + 0.02 * rng.standard_normal((2, 2, size))
        cloud[:, 2, k] = amplitude[1 + k] + 0.5 * rng.standard_normal((2, size))
    weight = np.tile([0.5, 0.5], (features, 1)) * 0.99
    sight = (amplitude[0] + 0.5 * rng.standard_normal(size)).astype(np.float32)
    state = StackedState(agent, np.zeros(size), cloud, np.arange(features), weight, 0.99, sight, features)
    return filter_, state, scan.select(chosen)


def seconds_per_step(
    size: int, features: int, measurements: int, likelihoods: str = "drjit", repeats: int = 5
) -> dict[str, float]:
    """Least and median time by the clock and least CPU time of a step [s], without compilation."""
    filter_, state, scan = crowded_step(size, features, measurements, likelihoods)
    rng = np.random.default_rng(1)
    filter_.step(rng, state, scan)
    wall, cpu = [], []
    for _ in range(repeats):
        clock, spent = time.perf_counter(), time.process_time()
        filter_.step(rng, state, scan)
        wall.append(time.perf_counter() - clock)
        cpu.append(time.process_time() - spent)
    return {"least": min(wall), "median": float(np.median(wall)), "cpu": min(cpu)}


def growth(likelihoods: str = "drjit", repeats: int = 5) -> dict[str, dict]:
    """Least time at a quarter, half, once and twice each of particles, features and measurements, and the exponent.

    The exponent is the slope of ln time over ln number over the last two doublings: 1 is linear growth, less has a constant part.
    """
    result = {}
    for name, number in _STANDARD.items():
        sizes = [number // 4, number // 2, number, 2 * number]
        times = []
        for value in sizes:
            case = _STANDARD | {name: value}
            arguments = case["particles"], case["features"], case["measurements"]
            times.append(seconds_per_step(*arguments, likelihoods, repeats)["least"])
        slope = float(np.polyfit(np.log(sizes[1:]), np.log(times[1:]), 1)[0])
        result[name] = {"sizes": sizes, "seconds": times, "exponent": slope}
    return result
