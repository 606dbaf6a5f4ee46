"""What a second worker brings, in estimation and in Monte Carlo studies; leave the machine alone meanwhile.

    python scripts/benchmark_parallel.py [--jobs 2] [--steps 80] [--runs 600]

Seconds of wall time with one worker and with several. ``start_s`` is what the workers take once to start, import and
load compiled code (the first call less a later one); ``speedup`` is that of a later call, ``speedup_with_start`` of the
first. The results of all calls are compared to the last bit. One line of JSON each.
"""

import argparse
import json
import time
from dataclasses import fields

import numpy as np
from threadpoolctl import threadpool_limits

from dopslam import build, geometry, pipeline
from dopslam.config import load
from dopslam.montecarlo import run_study
from dopslam.records import SPEED_OF_LIGHT, Landmarks, Paths, Track
from dopslam.studies import study


def timed(function, *arguments):
    """Result and seconds."""
    start = time.perf_counter()
    result = function(*arguments)
    return result, time.perf_counter() - start


def compare(name: str, work, jobs: int, same) -> dict:
    """One worker, several at first, several again."""
    work(1, True)  # compiles and calibrates
    alone, one = timed(work, 1, False)
    first, cold = timed(work, jobs, False)
    later, warm = timed(work, jobs, False)
    return {
        "what": name, "jobs": jobs, "one_s": round(one, 2), "first_s": round(cold, 2), "later_s": round(warm, 2),
        "start_s": round(cold - warm, 2), "speedup": round(one / warm, 2), "speedup_with_start": round(one / cold, 2),
        "same_result": same(alone, first) and same(alone, later),
    }  # fmt: skip


def estimation(jobs: int, steps: int) -> dict:
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

    return compare(f"estimation of {steps} snapshots", work, jobs, equal)


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


def montecarlo(jobs: int, runs: int) -> dict:
    """Runs of the joint filter on detections drawn from the model."""
    plan = study(load("ring_road"))

    def work(workers: int, warming: bool):
        return run_study(plan, 1 if warming else runs, 0, workers)

    def alike(left, right):
        return all(np.array_equal(a.nees, b.nees) for a, b in zip(left, right, strict=True))

    return compare(f"{runs} Monte Carlo runs", work, jobs, alike)


def equal(left, right) -> bool:
    """Whether two records are the same to the last bit."""
    return all(np.array_equal(getattr(left, f.name), getattr(right, f.name)) for f in fields(left))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--steps", type=int, default=80)
    parser.add_argument("--runs", type=int, default=600)
    options = parser.parse_args()
    with threadpool_limits(1):  # as in the workers and the command line
        print(json.dumps(estimation(options.jobs, options.steps)), flush=True)
        print(json.dumps(montecarlo(options.jobs, options.runs)))
