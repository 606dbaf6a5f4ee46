"""How long a step takes, and how that grows with the number of landmarks and of detections.

The least of several repetitions, CPU time without compilation.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dopslam.models.measurement import BS, SP, VA
from dopslam.simulate.world import FixedNoise, Situation, section_v, simulate
from dopslam.slam.filter import run as run_filter
from dopslam.slam.pmb.density import compile_model, initial_density
from dopslam.slam.pmb.ek_pmb import filter_scans, scan_arrays
from dopslam.slam.pmb.filters import Joint
from dopslam.studies.montecarlo import Study

Array = NDArray[np.float64]


def microseconds_per_step(study: Study, repeats: int = 5, seed: int = 0) -> dict[str, float]:
    """Least time per step [µs]: `recursion` (the filter's compiled loop over the scans) and `run` (with the smoother, if
    there is one, and with the records).
    """
    world, problem, chosen = study.situation, study.told, study.chosen
    assert isinstance(chosen, Joint)
    _, scans = simulate(world, seed, 0)
    parameters = chosen.parameters(problem, scans)
    model = compile_model(parameters, world.motion, world.bs, world.height)
    start = initial_density(world.prior_mean, world.prior_covariance)
    arrays = scan_arrays(scans, parameters.doppler, world.motion.interval)
    calls = {
        "recursion": lambda: filter_scans(*arrays, start, model, np.zeros(1, np.int64)),
        "run": lambda: run_filter(problem, scans, chosen),
    }
    result = {}
    for name, call in calls.items():
        call()
        times = []
        for _ in range(repeats):
            started = time.thread_time()
            call()
            times.append(time.thread_time() - started)
        result[name] = float(min(times) / scans.steps * 1e6)
    return result


def crowded(landmarks: int, detections: int | None = None, seed: int = 0) -> Situation:
    """Paper A's road with `landmarks` landmarks, two of seven of them VAs; on average `detections` are seen.

    Walls stand 100 to 180 m from the BS, scatter points anywhere on the plan; all are visible everywhere.
    """
    rng = np.random.default_rng(seed)
    base = section_v()
    anchors = max(1, round(2 * landmarks / 7))
    bearing = rng.uniform(0, 2 * np.pi, anchors)
    normal = np.column_stack([np.cos(bearing), np.sin(bearing), np.zeros(anchors)])
    va = base.bs + 2 * rng.uniform(100, 180, anchors)[:, None] * normal
    sp = rng.uniform([-150, -150, 1], [150, 150, 30], (landmarks - anchors, 3))
    probability = 0.9 if detections is None else min(0.98, detections / (landmarks + 1))
    return replace(
        base,
        kind=np.array([BS] + [VA] * anchors + [SP] * (landmarks - anchors), dtype=np.int64),
        position=np.vstack([base.bs, va, sp]),
        noise=FixedNoise(base.noise.std, probability, None) if isinstance(base.noise, FixedNoise) else base.noise,
    )


def dense_scene() -> Situation:
    """8 VAs and 20 SPs; SPs seen within 50 m."""
    world = crowded(28)
    noise: Any = section_v().noise
    return replace(world, noise=replace(noise, sp_range=50.0))


STEPS = 12  # of the runs that growth is measured on: enough to fill the map
LANDMARKS, DETECTIONS, CLUTTER = (8, 16, 32, 64, 128, 160), (5, 10, 20, 40), (25, 50, 100, 200, 400)


def cluttered(count: float) -> Situation:
    """Paper A's road with 8 landmarks and on average `count` false detections per step, spread over 300 m."""
    return replace(crowded(8), clutter_count=count)


def exponents(sizes, times) -> list[float]:
    """Exponent of growth between each size and the next: 1 where twice the size takes twice the time."""
    return (np.diff(np.log(times)) / np.diff(np.log(sizes))).tolist()


def growth(
    repeats: int = 3, landmarks=LANDMARKS, detections=DETECTIONS, clutter=CLUTTER, steps: int = STEPS
) -> dict[str, Any]:
    """Time per step [µs] over landmarks (8 detections), detections (64 landmarks) and false detections (8 landmarks).

    Each with the exponents from one size to the next.
    """

    def measured(world: Situation) -> float:
        return microseconds_per_step(Study(replace(world, steps=steps), Joint(iterations=2)), repeats)["recursion"]

    def table(sizes, world_of) -> dict[str, Any]:
        times = [measured(world_of(size)) for size in sizes]
        return {"sizes": list(sizes), "us_per_step": times, "exponents": exponents(sizes, times)}

    return {
        "landmarks": table(landmarks, lambda n: crowded(n, 8)),
        "detections": table(detections, lambda m: crowded(64, m)),
        "clutter": table(clutter, cluttered),
        "dense_scene_us": measured(dense_scene()),
    }
