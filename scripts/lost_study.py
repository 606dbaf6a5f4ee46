#!/usr/bin/env python3
"""Lost receivers in drawn worlds: the share that is recognized without the truth, and the good runs that are suspected.

python scripts/lost_study.py --worlds 40 --seed 3000 --filters joint smoother
"""

from __future__ import annotations

import argparse

from joblib import Parallel, delayed

from dopslam.filters import FILTERS
from dopslam.studies.lost import shares, verdicts


def main() -> None:
    """One line a filter, and the runs that were judged wrongly."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=40, help="each driven five times")
    parser.add_argument("--seed", type=int, default=1000, help="of the first world")
    parser.add_argument("--filters", nargs="+", default=["joint"])
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.worlds)
    for name in options.filters:
        parts = Parallel(n_jobs=options.jobs)(delayed(verdicts)(seed, FILTERS[name]()) for seed in seeds)
        found = [verdict for part in parts for verdict in part]
        told = shares(found)
        print(
            f"{name}: {told['recognized']} of {told['lost']} lost runs recognized "
            f"({100 * told['recognized'] / max(told['lost'], 1):.0f} %), {told['suspected']} of {told['good']} good runs "
            f"suspected ({100 * told['suspected'] / max(told['good'], 1):.1f} %), {told['failed']} ended with an error"
        )
        for verdict in found:
            if verdict.lost != bool(verdict.said) and (verdict.lost or not verdict.wrong):
                print(f"  seed {verdict.seed}, {verdict.name}: {verdict.said or 'lost, and nothing was said'}")


if __name__ == "__main__":
    main()
