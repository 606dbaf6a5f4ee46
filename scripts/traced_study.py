#!/usr/bin/env python3
"""Several seeds of traced scenes, every filter on the same detections, 95 % intervals; figures as paper B's Fig. 4.

python scripts/traced_study.py ring_road --seeds 10 --out results/ring_road
python scripts/traced_study.py ring_road --first 1000 --seeds 20 --filters batch --noise estimator --told filter.start=snapshot
python scripts/traced_study.py courtyard --seeds 5 --estimators nomp sage --noise estimator --out results/courtyard
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from dopslam.cli.common import progress_display, worker_count
from dopslam.config.scenario import load
from dopslam.pipeline import file as stages
from dopslam.pipeline import stages as pipeline
from dopslam.report import figures, study_figures
from dopslam.report.folder import write_json, write_text
from dopslam.report.tables import study_text
from dopslam.studies.traced import COMPARED, NOISES, study

DRAWN = ("joint", "marginal", "bp, no Doppler")


def main() -> None:
    """Write study_<estimator>.json and .txt, the errors over the steps and the map of the first seed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="?", default="ring_road")
    parser.add_argument("--seeds", type=int, default=10, help="number of seeds")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--filters", nargs="+", default=list(COMPARED))
    parser.add_argument("--told", action="append", default=[], metavar="KEY=VALUE", help="what only the filters read")
    parser.add_argument("--estimators", nargs="+", help="nomp, sage, esprit; by default the scenario's")
    parser.add_argument("--noise", nargs="+", choices=list(NOISES), default=list(NOISES))
    parser.add_argument("--out", type=Path, default=Path("results/traced_study"))
    parser.add_argument("--jobs", type=int)
    parser.add_argument("--set", dest="settings", action="append", default=[])
    options = parser.parse_args()
    kinds = options.estimators or [load(options.scene, options.settings).estimator.kind]
    results = {}
    for kind in kinds:
        scenario = load(options.scene, [*options.settings, f"estimator.kind={kind}"])
        data = options.out / kind
        data.mkdir(parents=True, exist_ok=True)
        with progress_display() as progress:
            seeds = range(options.first, options.first + options.seeds)
            jobs = worker_count(options.jobs)
            result = study(scenario, seeds, data, jobs, progress, options.noise, options.filters, options.told)
        results[kind] = result
        write_json(options.out / f"study_{kind}.json", result)
        write_text(options.out / f"study_{kind}.txt", study_text(result))
        print(study_text(result))
    if set(DRAWN) <= set(results[kinds[0]][options.noise[0]]):
        draw(options.out, results, options.noise[0], options.out / kinds[0] / f"{scenario.name}-{options.first}.h5")


def draw(folder: Path, results: dict[str, dict], noise: str, path: Path) -> None:
    """Errors of every estimator and filter over the steps; the map of one dataset by belief propagation."""
    curves = {
        f"{name.removesuffix(', no Doppler')}, {kind.upper()}": result[noise][name]["steps"]
        for name in DRAWN
        for kind, result in results.items()
    }
    scenario, seed = stages.scenario_of(path)
    track, landmarks, _, plan = stages.read_truth(path)
    history = pipeline.slam(scenario, stages.read_detections(path), "bp", False, seed)
    sight = np.array(next(iter(results.values()))["line_of_sight"])
    with figures.house_style():
        drawn = {
            "errors": study_figures.errors_over_runs(curves, sight),
            "map": study_figures.belief_map(plan, track, landmarks, history),
        }
        figures.save_all(folder, drawn)


if __name__ == "__main__":
    main()
