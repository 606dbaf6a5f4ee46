"""Filters on drawn measurement campaigns (`measured_hall`) from no prior: lost runs, RMSE over the bound, NEES.

python scripts/hall_study.py --runs 20 --seed 1000 --filters batch joint
"""

from __future__ import annotations

import argparse

from joblib import Parallel, delayed

from dopslam.filters import FILTERS
from dopslam.studies.hall import judged, summarize


def main() -> None:
    """Print one line per filter."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1000, help="of the first run")
    parser.add_argument("--filters", nargs="+", default=["batch"])
    parser.add_argument("--noise", choices=["given", "scaled"], default="scaled", help="of batch")
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.runs)
    for name in options.filters:
        chosen = FILTERS[name](**({"noise": options.noise} if name == "batch" else {}))
        runs = Parallel(n_jobs=options.jobs)(delayed(judged)(seed, chosen) for seed in seeds)
        for seed, r in zip(seeds, runs, strict=True):
            if r.lost or r.said:
                print(
                    f"  seed {seed}, {'lost' if r.lost else 'suspected'}: {r.failure or r.said or 'nothing was said'}"
                )
        print(name, summarize(list(runs)), flush=True)


if __name__ == "__main__":
    main()
