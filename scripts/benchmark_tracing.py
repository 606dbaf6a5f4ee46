"""Time and memory of tracing many positions on the ring road, beside the bare calls of the ray tracer in the
same run.

    python scripts/benchmark_tracing.py [POSITIONS …]

One line of JSON per number of positions (default 1000 and 10000), the second of two runs in one process:
warm. Seconds are wall-clock and of all threads of the process (``cpu``); ``overhead`` is what this package
adds to the tracer's calls.
"""

import json
import resource
import sys
import time
from pathlib import Path

import numpy as np

from dopslam.raytracing import ScatterPoints, SceneSource, Tracer, TraceSettings

SCENE = Path(__file__).parents[1] / "scenes" / "ring_road" / "scene.xml"
POINTS = ScatterPoints(
    ("east", "north", "west", "south"), [[99, 0, 10], [0, 99, 10], [-99, 0, 10], [0, -99, 10]], [100.0] * 4
)


class Stopwatch:
    """Wraps a callable and sums up the processor and wall time spent inside."""

    def __init__(self, function):
        self.function, self.cpu, self.wall = function, 0.0, 0.0

    def __call__(self, *arguments, **named):
        cpu, wall = time.process_time(), time.perf_counter()
        result = self.function(*arguments, **named)
        result.a[0].numpy()  # what the tracer has queued belongs to it
        self.cpu += time.process_time() - cpu
        self.wall += time.perf_counter() - wall
        return result


def measure(count: int, settings: TraceSettings) -> dict:
    """One run over ``count`` positions drawn uniformly between the walls."""
    rng = np.random.default_rng(0)
    receivers = np.column_stack([rng.uniform(-90, 90, (count, 2)), np.zeros(count)])
    velocities = np.column_stack([rng.normal(scale=10, size=(count, 2)), np.zeros(count)])
    cpu, wall = time.process_time(), time.perf_counter()
    tracer = Tracer(SceneSource(SCENE), 28e9, np.array([0.0, 0.0, 40.0]), POINTS, settings)
    watches = tracer._solver, tracer._radar = Stopwatch(tracer._solver), Stopwatch(tracer._radar)
    paths = sum(len(chunk.paths.a) for chunk in tracer.chunks(receivers, velocities))
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    bare = sum(watch.cpu for watch in watches)
    return {
        "positions": count, "paths": paths, "wall_s": round(wall, 2), "cpu_s": round(cpu, 2),
        "bare_wall_s": round(sum(watch.wall for watch in watches), 2), "bare_cpu_s": round(bare, 2),
        "overhead": round(cpu / bare - 1, 3),
        "peak_memory_gb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6, 3),
    }  # fmt: skip


if __name__ == "__main__":
    for positions in map(int, sys.argv[1:] or ("1000", "10000")):
        for _ in range(2):
            figures = measure(positions, TraceSettings(samples=20_000, chunk=400))
        print(json.dumps(figures))
