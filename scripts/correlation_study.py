#!/usr/bin/env python3
"""What belief propagation gains from the correlation between agent and features: kept, dropped, and paper B's form.

python scripts/correlation_study.py --runs 20
python scripts/correlation_study.py --scene ring_road --seeds 1000 1020 --out results/ring_road
"""

from __future__ import annotations

import argparse
from pathlib import Path

from dopslam.cli.common import progress_display, worker_count
from dopslam.config.scenario import load
from dopslam.report.folder import write_json
from dopslam.studies.correlation import floating_map, synthetic, traced
from dopslam.studies.traced import NOISES


def main() -> None:
    """Write correlation.json and print one line per variant."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", help="a traced scene; without it the pedestrian experiment")
    parser.add_argument("--seeds", type=int, nargs=2, default=(0, 10), metavar=("FIRST", "END"))
    parser.add_argument("--noise", choices=list(NOISES), default="estimator")
    parser.add_argument("--runs", type=int, default=20, help="of the pedestrian experiment")
    parser.add_argument("--out", type=Path, default=Path("results/correlation"))
    parser.add_argument("--jobs", type=int)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    if options.scene is None:
        result = {"floating map, m": floating_map(), **synthetic(options.runs)}
        print(f"a receiver at ±0.5 m among walls it maps itself, after 30 steps: {result['floating map, m']}")
        for name, figures in list(result.items())[1:]:
            low, high = figures["rmse_over_bound_interval"]["position"]
            print(f"{name:12} x PCRB {figures['rmse_over_bound']['position']:.2f} ({low:.2f}-{high:.2f})", end="  ")
            print("NEES {:.1f} ({:.1f}-{:.1f}) of 3".format(figures["nees_mean"], *figures["nees_interval"]))
    else:
        scenario = load(options.scene)
        with progress_display() as progress:
            seeds, jobs = range(*options.seeds), worker_count(options.jobs)
            result = traced(scenario, seeds, options.out, options.noise, jobs, progress)
        for name, figures in result.items():
            ratio, nees = figures["position_over_bound"], figures["nees"]
            print(f"{name:12} x PEB {ratio['mean']:.2f} ({ratio['low']:.2f}-{ratio['high']:.2f})", end="  ")
            print(f"NEES {nees['mean']:.1f} ({nees['low']:.1f}-{nees['high']:.1f}) of 4", end="  ")
            print(f"{figures['found']} of {figures['of']} landmarks")
    write_json(options.out / "correlation.json", result)


if __name__ == "__main__":
    main()
