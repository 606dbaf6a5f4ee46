#!/usr/bin/env python3
"""Estimator studies: tables on the terminal, numbers as JSON, figures as PNG.

python scripts/estimator_study.py --json study.json                       # accuracy of all estimators
python scripts/estimator_study.py --json study.json --study all --figures figures
python scripts/estimator_study.py --json study.json --study resolution --snapshots 40
python scripts/estimator_study.py --json study.json --study off_model --case clean "positions 0.01" --snapshots 50

Studies are added to those that the JSON file holds already, so that a long list can be run in pieces; --draw only draws.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

STUDIES = (
    "accuracy",
    "weak",
    "hybrid",
    "resolution",
    "false_alarms",
    "ambiguity",
    "speed",
    "search_loss",
    "swept",
    "random_links",
    "wrong_model",
    "off_model",
)


def main() -> None:
    """Run the chosen studies."""
    from estimation.estimators import ESTIMATORS

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, required=True, metavar="OUT", help="where the numbers go")
    parser.add_argument("--study", nargs="+", default=["accuracy"], choices=[*STUDIES, "all"])
    parser.add_argument("--estimator", nargs="+", default=list(ESTIMATORS), help="names, or module:Class of your own")
    parser.add_argument("--snapshots", type=int, default=10, help="bursts per point (100 for the published figures)")
    parser.add_argument(
        "--snr",
        nargs="+",
        type=float,
        default=[-20, -10, 0, 10, 20],
        help="per-sample SNR of the strongest path [dB]",
    )
    parser.add_argument("--case", nargs="+", help="of off_model; default all of estimation.offmodel.CASES")
    parser.add_argument("--figures", type=Path, help="folder for figures; none are drawn without it")
    parser.add_argument("--draw", action="store_true", help="run nothing, draw what the JSON file holds")
    options = parser.parse_args()
    if options.snapshots < 2:
        parser.error("--snapshots must be at least 2")
    results: dict = json.loads(options.json.read_text())["studies"] if options.json.exists() else {}
    chosen = STUDIES if "all" in options.study else options.study
    for name in [] if options.draw else chosen:
        result = run_study(name, options)
        show(name, result)
        # Estimators and cases may be run one at a time.
        results[name] = results.get(name, {}) | result if name in ("accuracy", "off_model") else result
    options.json.parent.mkdir(parents=True, exist_ok=True)
    # The accuracy figures of each estimator also stand at the top level, by its name.
    top = {
        name: {k: v for k, v in value.items() if k != "per_snr"} for name, value in results.get("accuracy", {}).items()
    }
    options.json.write_text(json.dumps(top | {"studies": results}, indent=1))
    if options.figures:
        from estimation import figures

        options.figures.mkdir(parents=True, exist_ok=True)
        for name, result in results.items():
            figures.draw(name, result, options.figures / f"estimator_{name}.png")


def run_study(name: str, options):
    """One study's numbers."""
    from estimation import studies

    count = options.snapshots
    if name == "accuracy":
        return {e: studies.accuracy(e, count, tuple(options.snr)) for e in options.estimator}
    if name == "weak":
        return studies.weak_paths(2 * count)
    if name == "hybrid":
        return studies.hybrid(count)
    if name == "resolution":
        from estimation.resolution import DIMENSIONS, resolution

        separations = (0.1, 0.2, 0.3, 0.5, 0.7)
        return {
            label: {f"{rho} dB": resolution(d, separations, rho, count) for rho in (30, 40)}
            for d, label in enumerate(DIMENSIONS)
        }
    if name == "false_alarms":
        return studies.false_alarms((0.3, 0.1, 0.03, 0.01), 4 * count)
    if name == "ambiguity":
        return studies.schedules()
    if name == "search_loss":
        return studies.search_loss(trials=2 * count)
    if name == "swept":
        return studies.swept(count)
    if name in ("random_links", "wrong_model"):
        from estimation import random_links

        return random_links.right_model(50, count) if name == "random_links" else random_links.wrong_model(count)
    if name == "off_model":
        from estimation.offmodel import CASES, off_model

        return off_model(range(1000, 1000 + count), options.case or CASES)
    return studies.speed()


def show(name: str, result) -> None:
    """A short table."""
    print(f"\n{name}")
    if name == "accuracy":
        for estimator, r in result.items():
            print(
                f"  {estimator:7s} RMSE/CRB "
                + " ".join(f"{v:.3f}" for v in r["rmse_over_crb"].values())
                + f"  NEES/6 {r['nees_over_6']:.3f}  false {r['false_per_snapshot']:.3f}  {r['ms_per_snapshot']:.0f} ms"
                + f"  ({r['associations']} associations)"
            )
            print(
                "          P_D "
                + "  ".join(f"{b} dB {v['p_detect']:.3f}/{v['model']:.3f}" for b, v in r["p_detect"].items())
            )
    elif name == "random_links":
        for r in result:
            print(
                f"  {r['link']:3d} {tuple(r['shape'])!s:22s} "
                + " ".join(f"{v:.2f}" for v in r["rmse_over_crb"].values())
                + f"  NEES/6 {r['nees_over_6']:.2f}  false {r['false_per_snapshot']:.3f}  found {r['found']:.3f}"
            )
    elif name == "off_model":
        for case, r in result.items():
            print(
                f"  {case:22s} ghosts {r['ghosts_per_snapshot']:5.2f} (most {r['most_ghosts']})  {r['seconds']:5.2f} s"
                f" (most {r['most_seconds']:.2f})  NEES/6 {r['nees_over_6']:5.2f} (median {r['nees_median']:.2f})"
                f"  found {r['found']:.3f}, strong ones {r['strong_found']:.3f}"
            )
    else:
        print("  " + json.dumps(result)[:1500])


if __name__ == "__main__":
    main()
