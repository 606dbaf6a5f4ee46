"""Random free drives (cars and walkers that stop, brake and steer at once), speed and turn rate unknown, default keys.

python scripts/drive_study.py --seeds 1000-1049
python scripts/drive_study.py --seeds 0-19 --filter bp --set filter.turn_rate_walk=0.02
"""

from __future__ import annotations

import argparse

from dopslam.simulate.drives import KINDS
from dopslam.studies.drives import judged, passes, summarize


def main() -> None:
    """Print one line per kind of receiver, and one per drive that does not pass."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--seeds", default="1000-1019", help="a span; below 100 are for development")
    parser.add_argument("--filter", default="joint")
    parser.add_argument("--set", action="append", default=[], dest="settings")
    options = parser.parse_args()
    first, _, last = options.seeds.partition("-")
    for kind in options.kinds:
        runs = [
            judged(kind, seed, options.filter, options.settings) for seed in range(int(first), int(last or first) + 1)
        ]
        print(kind, summarize(runs))
        for run in runs:
            if not passes(run):
                print("  ", run)


if __name__ == "__main__":
    main()
