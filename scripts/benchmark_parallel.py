"""What a second worker brings, in estimation and in Monte Carlo studies; leave the machine alone meanwhile.

    python scripts/benchmark_parallel.py [--jobs 2] [--steps 80] [--runs 300] [--rounds 3]

Median seconds of wall time with one worker and with several. ``start_s`` is what the workers take once to start, import
and load compiled code. ``limit`` is the speed-up of processes that have nothing to do with each other, each doing the
whole work at the same time as the others: what the machine gives. The results of all calls are compared to the last bit.
One line of JSON each.
"""

import argparse
import json
import time
from dataclasses import fields

import numpy as np
from joblib import Parallel, delayed
from threadpoolctl import threadpool_limits

from dopslam.config.scenario import load
from dopslam.pipeline import problem as build
from dopslam.pipeline import stages as pipeline
from dopslam.raytracing import images as geometry
from dopslam.records import SPEED_OF_LIGHT, Landmarks, Paths, Track
from dopslam.studies.montecarlo import run_study
from dopslam.studies.summary import study


def timed(function, *arguments):
    """Result and seconds."""
    start = time.perf_counter()
    result = function(*arguments)
    return result, time.perf_counter() - start


def compare(name: str, work, jobs: int, same, rounds: int) -> dict:
    """One worker, several, and as many single ones side by side; in turn, since a shared machine changes its pace."""
    work(1, True)  # compiles and calibrates
    _, cold = timed(work, jobs, False)
    beside = Parallel(n_jobs=jobs)
    one, several, apart, alike = [], [], [], True
    for _ in range(rounds):
        alone, seconds = timed(work, 1, False)
        one.append(seconds)
        together, seconds = timed(work, jobs, False)
        several.append(seconds)
        alike &= same(alone, together)
        apart.append(max(beside(delayed(seconds_of)(work) for _ in range(jobs))))
    median = {"one_s": np.median(one), "several_s": np.median(several), "side_by_side_s": np.median(apart)}
    return {
        "what": name, "jobs": jobs, "rounds": rounds, **{k: round(float(v), 2) for k, v in median.items()},
        "start_s": round(cold - float(median["several_s"]), 2),
        "speedup": round(float(median["one_s"] / median["several_s"]), 2),
        "limit": round(float(jobs * median["one_s"] / median["side_by_side_s"]), 2),
        "same_result": alike,
    }  # fmt: skip


def seconds_of(work) -> float:
    """Seconds of the whole work done by one worker, in the process that this is called in."""
    with threadpool_limits(1):
        work(1, True)
        return timed(work, 1, False)[1]


def estimation(jobs: int, steps: int, rounds: int) -> dict:
    """Detections of every snapshot of a ring road with its paths in closed form."""
    scenario = load("ring_road", [f"track.steps={steps}", "source.kind=traced"])
    short = load("ring_road", ["track.steps=2", "source.kind=traced"])
    track = pipeline.draw_track(scenario, 0)
    paths = line_of_sight_and_points(scenario, track)
    signal = pipeline.SyntheticSignal(scenario.to_toml(), track, paths, 0)

    def work(workers: int, warming: bool):
        if warming:
            little = pipeline.draw_track(short, 0)
            return pipeline.estimate(
                scenario,
                pipeline.SyntheticSignal(scenario.to_toml(), little, line_of_sight_and_points(short, little), 0),
            )
        return pipeline.estimate(scenario, signal, workers)

    return compare(f"estimation of {steps} snapshots", work, jobs, equal, rounds)


def line_of_sight_and_points(scenario, track: Track) -> Paths:
    """Nine paths a step: line of sight, the four walls' reflections and the scatter points, by the image method."""
    marks: Landmarks = build.model_landmarks(scenario)
    bs, count = np.array(scenario.base_station.position), len(marks)
    parts = []
    for kind, place in zip(marks.kind.tolist(), marks.position, strict=True):
        if kind == 2:
            parts.append(geometry.scattered_paths(bs, track.position, place))
        else:  # a virtual anchor's wall stands halfway
            apart = np.linalg.norm(place - bs)
            depth = int(apart > 0)
            normal = np.zeros((depth, 3)) + (place - bs) / (apart or 1.0)
            parts.append(geometry.reflected_paths(bs, track.position, normal, normal @ (place + bs) / 2))
    length = np.stack([part.length for part in parts], axis=1).reshape(-1)
    departure, arrival = (
        np.stack([getattr(part, name) for part in parts], axis=1).reshape(-1, 3) for name in ("departure", "arrival")
    )
    theta_t, phi_t = geometry.zenith_azimuth(departure)
    theta_r, phi_r = geometry.zenith_azimuth(arrival)
    wavelength = SPEED_OF_LIGHT / scenario.radio.carrier_frequency
    velocity = np.repeat(track.velocity, count, axis=0)
    loss = np.tile(np.where(marks.kind == 0, 1.0, np.where(marks.kind == 1, 0.3, 0.02)), track.steps)
    return Paths(
        offsets=count * np.arange(track.steps + 1), landmark=np.tile(np.arange(count), track.steps),
        a=(loss * wavelength / (4 * np.pi * length)).astype(complex), tau=length / SPEED_OF_LIGHT,
        theta_t=theta_t, phi_t=phi_t, theta_r=theta_r, phi_r=phi_r,
        doppler=np.sum(velocity * arrival, axis=1) / wavelength,
        vertex_offsets=np.zeros(len(length) + 1, int), vertices=np.zeros((0, 3)),
    )  # fmt: skip


def montecarlo(jobs: int, runs: int, rounds: int) -> dict:
    """Runs of the joint filter on detections drawn from the model."""
    plan = study(load("ring_road"))

    def work(workers: int, warming: bool):
        return run_study(plan, 1 if warming else runs, 0, workers)

    def alike(left, right):
        return all(np.array_equal(a.nees, b.nees) for a, b in zip(left, right, strict=True))

    return compare(f"{runs} Monte Carlo runs", work, jobs, alike, rounds)


def equal(left, right) -> bool:
    """Whether two records are the same to the last bit."""
    return all(np.array_equal(getattr(left, f.name), getattr(right, f.name)) for f in fields(left))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--steps", type=int, default=80)
    parser.add_argument("--runs", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    with threadpool_limits(1):  # as in the workers and the command line
        print(json.dumps(estimation(options.jobs, options.steps, options.rounds)), flush=True)
        print(json.dumps(montecarlo(options.jobs, options.runs, options.rounds)))
