#!/usr/bin/env python3
"""The figures of the README's traced study: several seeds of a traced scene, all filter variants, 95 % intervals.

python scripts/traced_study.py scenes/ring_road --seeds 10 --out results/ring_road
"""

from __future__ import annotations

import argparse
from pathlib import Path

from dopslam.cli.common import progress_display, worker_count
from dopslam.config import load
from dopslam.report.folder import write_json
from dopslam.report.tables import study_text
from dopslam.traced_study import study


def main() -> None:
    """Run the study and write study.json and study.txt."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="?", default="ring_road")
    parser.add_argument("--seeds", type=int, default=10, help="number of seeds, from 0")
    parser.add_argument("--out", type=Path, default=Path("results/traced_study"))
    parser.add_argument("--jobs", type=int)
    parser.add_argument("--set", dest="settings", action="append", default=[])
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    scenario = load(options.scene, options.settings)
    with progress_display() as progress:
        result = study(scenario, range(options.seeds), options.out, worker_count(options.jobs), progress)
    write_json(options.out / "study.json", result)
    text = study_text(result)
    (options.out / "study.txt").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
