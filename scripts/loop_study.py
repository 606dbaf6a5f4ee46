"""Laps round a block of 200 landmarks: does the map stay whole, does it double, what does a step cost, is the filter consistent?

python scripts/loop_study.py --steps 10000 --seed 1000
python scripts/loop_study.py --coarse --steps 450 --objects 60 --seed 3000 --filter batch    # a drift that the loop takes back
"""

from __future__ import annotations

import argparse
import resource
import time

import numpy as np
from scipy.optimize import linear_sum_assignment

from dopslam.evaluate.metrics import nees, state_errors
from dopslam.filters import FILTERS
from dopslam.pipeline.problem import told
from dopslam.records import Kind
from dopslam.simulate.block import block, coarse, unsighted
from dopslam.simulate.world import draw_scans
from dopslam.slam.filter import run

LAP = 370  # steps, after which the first objects come into sight again


def main() -> None:
    """Print one figure a line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=1000, help="400 are a lap")
    parser.add_argument("--objects", type=int, default=190)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--filter", default="joint")
    parser.add_argument(
        "--coarse", action="store_true", help="objects alone, coarse delays and departures: the filter drifts"
    )
    options = parser.parse_args()
    rng, chosen = np.random.default_rng(options.seed), FILTERS[options.filter]()
    world, states = block(options.steps, options.objects, rng)
    world = coarse(world) if options.coarse else world
    scans = draw_scans(world, states, rng, rng)
    scans = unsighted(scans) if options.coarse else scans
    problem = told(world)
    run(problem, scans.take(list(range(5))), chosen)  # compiles
    start = time.process_time()
    history, _ = run(problem, scans, chosen)
    seconds = time.process_time() - start
    error = state_errors(history.mean, states)
    squares = nees(error[:, :4], history.covariance[:, :4, :4])
    print(
        f"detections a scan: {len(scans.z) / options.steps:.1f}; time a step: {seconds / options.steps * 1e3:.2f} ms of CPU"
    )
    print(f"memory at most: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3:.0f} MB")
    print(f"position RMSE: {np.sqrt(np.mean(np.sum(error[:, :2] ** 2, axis=1))):.4f} m")
    print(
        f"NEES (4 expected): {squares.mean():.2f}; by tenths of the run:",
        *np.round([p.mean() for p in np.array_split(squares, 10)], 2),
    )
    if options.coarse and options.steps > LAP:
        open_ = run(problem, scans.take(slice(0, LAP)), chosen)[0]
        far = slice(LAP // 2, LAP)
        before, after = (
            np.sqrt(np.mean(np.sum(state_errors(h.mean[far], states[far])[:, :2] ** 2, axis=1)))
            for h in (open_, history)
        )
        print(f"steps {LAP // 2} to {LAP}: {before:.3f} m before the first objects are seen again, {after:.3f} m after")
    assert scans.label is not None
    seen = np.unique(scans.label[scans.label >= 0])
    for kind in (Kind.VA, Kind.SP):
        true = world.position[seen[world.kind[seen] == kind]]
        mapped = history.reported(options.steps - 1, kind, 0.5)
        distance = np.linalg.norm(true[:, None] - mapped[None], axis=-1)
        rows, columns = linear_sum_assignment(distance)
        near = int(np.sum(distance[rows, columns] < 1.0))
        print(
            f"{kind.name}: {len(true)} seen, {near} in the final map within 1 m, {len(mapped) - near} others reported"
        )


if __name__ == "__main__":
    main()
