#!/usr/bin/env python3
"""Random generated scenes from signal to map with default keys: how many pass, and why the others do not.

python scripts/scene_study.py --seeds 0-9
python scripts/scene_study.py --kinds street hall --seeds 1000-1011 --jobs 2 --out results/scenes
python scripts/scene_study.py --seeds 0-9 --replay --set filter.gate=25     # filters again, from stored detections

A scene passes if RMSE/PEB <= 1.5, NEES <= 8, at least 80 % of the landmarks visible for 3 steps are in the final map within
1 m or 3 sigma, and false landmarks are at most 1 or 10 %. Seeds below 100 are for development; report others.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from joblib import Parallel, delayed  # noqa: E402

from dopslam.report.folder import write_json, write_text  # noqa: E402
from dopslam.scenes.generators import GENERATORS  # noqa: E402
from dopslam.studies import scenes  # noqa: E402
from dopslam.studies.scene_table import text  # noqa: E402


def numbers(spans: list[str]) -> list[int]:
    """``["0-3", "7"]`` → [0, 1, 2, 3, 7]."""
    ends = [[int(end) for end in span.split("-")] for span in spans]
    return [number for end in ends for number in range(end[0], end[-1] + 1)]


def line(result: dict) -> str:
    """One scene in one line."""
    if "error" in result:
        return f"{result['kind']:>9} {result['seed']:<5} no result  {result['cause']}"
    ratio = result["rmse_over_bound"]["position"]
    verdict = "pass" if not result["failures"] else f"{', '.join(result['failures'])}: {result['cause']}"
    return (
        f"{result['kind']:>9} {result['seed']:<5} {ratio:7.2f} x PEB  NEES {result['nees']:8.1f}  landmarks "
        f"{result['landmarks_found']:>2}/{result['landmarks_visible']:<2} ever {result['landmarks_ever']:<2} false "
        f"{result['false_landmarks']:<2} {verdict}"
    )


def main() -> None:
    """Run, print a line for every scene and the table at the end; results.json and table.txt."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", nargs="+", choices=list(GENERATORS), default=list(GENERATORS))
    parser.add_argument("--seeds", nargs="+", default=["0-4"], help="numbers and spans: 0-4 7")
    parser.add_argument("--filter", dest="density", default="joint", help="any that dopslam run takes")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("results/scenes"))
    parser.add_argument("--replay", action="store_true", help="filter again, from the detections that are there")
    parser.add_argument("--set", dest="settings", action="append", default=[])
    o = parser.parse_args()
    tasks = (
        delayed(scenes.run)(kind, seed, o.out, o.settings, o.density, o.replay)
        for seed in numbers(o.seeds)
        for kind in o.kinds
    )
    results = []
    for result in Parallel(n_jobs=o.jobs, return_as="generator")(tasks):
        results.append(result)
        print(line(result), flush=True)
    table = text(results)
    write_json(o.out / f"results-{o.density}.json", {"results": results})
    write_text(o.out / f"table-{o.density}.txt", table)
    print("\n" + table)


if __name__ == "__main__":
    main()
