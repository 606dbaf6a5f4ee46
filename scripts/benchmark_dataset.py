"""Time, memory and reading speed of large datasets of the ring road.

    python scripts/benchmark_dataset.py [POSITIONS …]

One line of JSON per number of positions (default 1000 and 10000), each from a process of its own with warm kernels
(the first,
small run is thrown away). ``cpu_s`` counts all threads; ``overhead_…`` is what the dataset adds to the tracer's own
calls for the same positions in the same run. The last line gives the speed of reading a large file with its sha256
verified, on two threads and on one, and of HDF5's own reading, beside that of sha256 alone and of the file as bytes.
"""

import hashlib
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

SETTINGS = ["trace.samples=20000"]


def measure(positions: int) -> dict:
    """One dataset, made and thrown away."""
    from dopslam.config.scenario import load
    from dopslam.datasets import generate, make_plan, maker, shard

    bare = {"cpu": 0.0, "wall": 0.0}

    class Watched(shard.ShardTracer):
        """Counts what is spent in the two solvers of the tracer."""

        def __init__(self, *arguments):
            super().__init__(*arguments)
            self.tracer._solver, self.tracer._radar = map(self._watch, (self.tracer._solver, self.tracer._radar))

        @staticmethod
        def _watch(solver):
            def call(*arguments, **named):
                cpu, wall = time.process_time(), time.perf_counter()
                result = solver(*arguments, **named)
                result.a[0].numpy()
                bare["cpu"] += time.process_time() - cpu
                bare["wall"] += time.perf_counter() - wall
                return result

            return call

    maker.ShardTracer = Watched
    scenario = load("ring_road", SETTINGS)
    with tempfile.TemporaryDirectory() as place:
        generate(Path(place) / "warm", make_plan(scenario, 400, 1), scenario)
        bare.update(cpu=0.0, wall=0.0)
        cpu, wall = time.process_time(), time.perf_counter()
        manifest = generate(Path(place) / "d", make_plan(scenario, positions, 0), scenario)
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        size = sum(p.stat().st_size for p in (Path(place) / "d").iterdir())
    return {
        "positions": positions, "paths": sum(e.paths for e in manifest.shards), "wall_s": round(wall, 2), "cpu_s": round(cpu, 2),
        "bare_cpu_s": round(bare["cpu"], 2), "bare_wall_s": round(bare["wall"], 2),
        "overhead_cpu": round(cpu / bare["cpu"] - 1, 3), "overhead_wall": round(wall / bare["wall"] - 1, 3),
        "peak_memory_gb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6, 3), "megabytes": round(size / 1e6, 1),
    }  # fmt: skip


def reading(rows: int = 1_000_000) -> dict:
    """Speeds in MB/s of wall time, the best of several, of a file that lies in the memory of the operating system."""
    import h5py

    from dopslam.records import Paths
    from dopslam.store import columns as module
    from dopslam.store import file as dataset

    rng = np.random.default_rng(0)
    columns = {n: rng.normal(size=rows) for n in ("tau", "theta_t", "phi_t", "theta_r", "phi_r", "doppler")}
    record = Paths(
        np.array([0, rows]), np.zeros(rows, int), rng.normal(size=rows) + 0j, vertex_offsets=np.arange(rows + 1),
        vertices=rng.normal(size=(rows, 3)), **columns,
    )  # fmt: skip

    def hdf5(path):
        with h5py.File(path) as file:
            return [file["paths"][name][()] for name in vars(record)]

    def single(path):
        most, module.OVERLAP = module.OVERLAP, 1 << 62
        dataset.read_record(path, "paths", Paths)
        module.OVERLAP = most

    ways = {
        "verified": lambda path: dataset.read_record(path, "paths", Paths),
        "verified_one_thread": single,
        "hdf5_with_fletcher32": hdf5,
        "sha256_alone": lambda path: [hashlib.sha256(np.ascontiguousarray(c)).digest() for c in vars(record).values()],
        "bytes": Path.read_bytes,
    }
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "d.h5"
        dataset.write_record(path, "paths", record)
        size = path.stat().st_size / 1e6
        result = {"file_mb": round(size)}
        for name, way in ways.items():
            seconds = []
            for _ in range(7):
                start = time.perf_counter()
                way(path)
                seconds.append(time.perf_counter() - start)
            result[f"{name}_mb_s"] = round(size / min(seconds))
    return result


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        print(json.dumps(measure(int(sys.argv[2]))))
        sys.exit()
    for count in sys.argv[1:] or ("1000", "10000"):
        subprocess.run([sys.executable, __file__, "--one", count], check=True)
    print(json.dumps(reading()))
