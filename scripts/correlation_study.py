#!/usr/bin/env python3
"""Belief propagation beside the joint filter, and what it gains from the correlation between agent and features: kept,
dropped, and paper B's form.

python scripts/correlation_study.py --runs 20
python scripts/correlation_study.py --runs 100 --cases aod paper --variants kept particles --out results/pedestrian
python scripts/correlation_study.py --scene ring_road --seeds 1000 1020 --out results/ring_road
python scripts/correlation_study.py --scene ring_road --seeds 1000 1040 --variants joint --fit --out results/ring_road
python scripts/correlation_study.py --scene ring_road --seeds 1000 1020 --noise estimator paper \\
    --variants particles kept joint --repeats 15 --out results/ring_road
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from dopslam.cli.common import progress_display, worker_count  # noqa: E402
from dopslam.config.scenario import load  # noqa: E402
from dopslam.report.folder import write_json  # noqa: E402
from dopslam.studies import known  # noqa: E402
from dopslam.studies.bp_cases import CASES  # noqa: E402
from dopslam.studies.correlation import COMPARED, VARIANTS, floating_map, synthetic, traced  # noqa: E402
from dopslam.studies.traced import NOISES  # noqa: E402


def main() -> None:
    """Write correlation.json and print one line per variant."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", help="a traced scene; without it the pedestrian experiment")
    parser.add_argument("--seeds", type=int, nargs=2, default=(0, 10), metavar=("FIRST", "END"))
    parser.add_argument("--noise", nargs="+", choices=list(NOISES), default=["estimator"])
    parser.add_argument("--runs", type=int, default=20, help="of the pedestrian experiment")
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=["aod"], help="of the pedestrian experiment")
    parser.add_argument("--variants", nargs="+", choices=COMPARED, default=list(VARIANTS))
    parser.add_argument("--repeats", type=int, default=1, help="of the first seed's runs, for the time of a step")
    parser.add_argument(
        "--fit", action="store_true", help="the whole run by least squares with the true association as well"
    )
    parser.add_argument("--out", type=Path, default=Path("results/correlation"))
    parser.add_argument("--jobs", type=int)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    result = pedestrian(options) if options.scene is None else scene(options)
    write_json(options.out / "correlation.json", result)


def pedestrian(options: argparse.Namespace) -> dict:
    """Paper B's experiment, drawn."""
    if "joint" in options.variants:
        raise SystemExit(
            "the pedestrian experiment has no velocity model of a turn: joint is for traced scenes, --scene"
        )
    result: dict = {"floating map, m": floating_map()}
    print(f"a receiver at ±0.5 m among walls it maps itself, after 30 steps: {result['floating map, m']}")
    for case in options.cases:
        result[case] = synthetic(options.runs, case=case, variants=options.variants)
        for name, figures in result[case].items():
            low, high = figures["rmse_over_bound_interval"]["position"]
            print(
                f"{case:6} {name:12} x PCRB {figures['rmse_over_bound']['position']:.2f} ({low:.2f}-{high:.2f})  "
                "NEES {:.1f} ({:.1f}-{:.1f}) of 3".format(figures["nees_mean"], *figures["nees_interval"]),
                f" lost {figures['diverged']}  found all {figures['found_all_runs']} of {figures['runs']}  "
                f"{1e3 * figures['seconds_per_step']:.2f} ms a step",
                flush=True,
            )
    return result


def scene(options: argparse.Namespace) -> dict:
    """A traced scene, signal to map."""
    scenario, seeds, result = load(options.scene), range(*options.seeds), {}
    for noise in options.noise:
        with progress_display() as progress:
            jobs = worker_count(options.jobs)
            result[noise] = traced(
                scenario, seeds, options.out, noise, jobs, progress, options.variants, options.repeats
            )
        for name, figures in result[noise].items():
            ratio, nees = figures["position_over_bound"], figures["nees"]
            print(
                f"{options.scene} {noise:9} {name:12} x PEB {ratio['mean']:.2f} ({ratio['low']:.2f}-{ratio['high']:.2f})  "
                f"NEES {nees['mean']:.1f} ({nees['low']:.1f}-{nees['high']:.1f}) of 4  {figures['found']} of {figures['of']} "
                f"landmarks, {figures['second_found']} of {figures['second_of']} second reflections, {figures['false']} false  "
                f"{figures['ms_per_step']:.2f} ms a step",
                flush=True,
            )
        if options.fit:
            result[f"fit, {noise}"] = found = known.traced(scenario, seeds, options.out, noise)
            print(
                f"{options.scene} {noise:9} known        NEES {found['nees']['mean']:.2f} ({found['nees']['low']:.2f}-"
                f"{found['nees']['high']:.2f}) of 4, cost per degree of freedom {found['cost_per_freedom']['mean']:.3f} "
                f"({found['cost_per_freedom']['low']:.3f}-{found['cost_per_freedom']['high']:.3f}), median "
                f"{found['cost_per_freedom_median']:.3f}; detections' NEES per row {found['detection_nees']:.3f}, without the "
                f"largest hundredth {found['detection_nees_trimmed']:.3f}, the largest {found['largest']:.0f}",
                flush=True,
            )
    return result


if __name__ == "__main__":
    main()
