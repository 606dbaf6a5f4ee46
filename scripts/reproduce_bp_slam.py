#!/usr/bin/env python3
"""Paper B (belief-propagation SLAM with virtual anchors and scatterers): Figs. 2 and 4 on the synthetic
experiment.

python scripts/reproduce_bp_slam.py --runs 100 --jobs 2 --out results/bp_slam

Cases can be run one after the other: results.json keeps those of earlier calls, and the figures show what it holds.
Fig. 4 over the traced courtyard: of one run by --dataset (a file with slam and bound done, as `dopslam run courtyard`
leaves it), over several seeds by scripts/traced_study.py.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from dopslam.pipeline import file as stages
from dopslam.report import study_figures
from dopslam.report.figures import errors_over_time as traced_errors
from dopslam.report.figures import save_all
from dopslam.report.folder import write_json
from dopslam.slam.belief.experiment import draw
from dopslam.studies import distance_only as range_study
from dopslam.studies.bp_cases import CASES, run_case
from dopslam.studies.bp_figures import association_errors, belief_map, errors_over_time, feature_names, type_beliefs
from dopslam.studies.bp_run import run
from dopslam.studies.bp_study import start_box, summary
from dopslam.studies.loopy import error_distribution


def main() -> None:
    """Write figures and results.json, print one line per case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1, help="worker processes; the numbers are the same for any")
    parser.add_argument("--particles", type=int, help="instead of each case's own number")
    parser.add_argument("--cases", nargs="*", choices=list(CASES), default=[n for n in CASES if n != "stacked"])
    parser.add_argument(
        "--range-only", type=int, default=0, metavar="RUNS", help="of the distance-only setting as well"
    )
    parser.add_argument("--out", type=Path, default=Path("results/bp_slam"))
    parser.add_argument("--dataset", type=Path, help="a traced dataset whose errors and map are drawn as well")
    options = parser.parse_args()
    started = time.perf_counter()
    options.out.mkdir(parents=True, exist_ok=True)
    stored = options.out / "results.json"
    tables = json.loads(stored.read_text(encoding="utf-8")) if stored.exists() else {}
    for name in options.cases:
        results = run_case(CASES[name], options.runs, options.seed, options.particles, jobs=options.jobs)
        tables[name] = line = summary(results)
        write_json(stored, tables)
        low, high = line["position_rmse_interval_m"]
        print(
            f"[{time.perf_counter() - started:6.0f} s] {name:10s} position {1e3 * line['position_rmse_m']:6.2f} mm "
            f"({1e3 * low:.2f}-{1e3 * high:.2f}, bound {1e3 * line['position_bound_m']:.2f})  "
            f"orientation {line['orientation_rmse_deg']:.3f}°  lost {line['diverged']}  ghosts {line['ghost_runs']}  "
            f"found all {line['found_all_runs']}/{line['runs']}  false {line['false_features']:.2f}  "
            f"types {min(line['type_belief_true']):.3f}  {1e3 * line['seconds_per_step']:.1f} ms/step",
            flush=True,
        )
    if options.range_only:
        found = range_study.study(options.range_only, options.seed, options.particles or range_study.PARTICLES)
        tables["range_only"] = line = range_study.summary(found)
        write_json(stored, tables)
        low, high = line["position_rmse_interval_m"]
        print(
            f"[{time.perf_counter() - started:6.0f} s] range_only position {line['position_rmse_m']:.4f} m "
            f"({low:.4f}-{high:.4f}, bound {line['position_bound_m']:.4f})  worst {line['worst_run_m']:.3f}  "
            f"found {line['features_found']:.1f} of {line['features']}, all in {line['found_all_runs']} runs  "
            f"false {line['false_features']:.2f}  {1e3 * line['seconds_per_step']:.1f} ms/step",
            flush=True,
        )
    loopy = error_distribution()
    write_json(options.out / "loopy.json", loopy.table())
    figures = {"loopy_errors": association_errors(loopy)}
    shown = {name: tables[name] for name in ("paper", "aod", "uniform") if name in tables}
    if shown:
        case = CASES[next(iter(shown))]
        data, own = (np.random.default_rng(s) for s in np.random.SeedSequence([options.seed, 0]).spawn(2))
        truth, scans, _ = draw(case.experiment, data)
        history = run(case.filter, own, scans, start_box(case.experiment), case.particles)
        figures |= {
            "fig2_type_beliefs": type_beliefs(feature_names(case.experiment), shown),
            "fig4ab_errors": errors_over_time(shown),
            "fig4c_map": belief_map(case.experiment, truth, history, case.types),
        }
    if options.dataset is not None:
        figures |= traced(options.dataset)
    save_all(options.out, figures)


def traced(path: Path) -> dict:
    """Fig. 4 of belief propagation on a traced dataset."""
    name = stages.variant_name("bp", False)
    _, evaluations = stages.evaluate(path)
    if name not in evaluations:
        raise SystemExit(f"{path}: no belief propagation in it; run dopslam slam {path} --filter bp first")
    track, landmarks, _, plan = stages.read_truth(path)
    return {
        "fig4ab_traced_errors": traced_errors(evaluations[name]),
        "fig4c_traced_map": study_figures.belief_map(plan, track, landmarks, stages.histories(path)[name]),
    }


if __name__ == "__main__":
    main()
