#!/usr/bin/env python3
"""Time per step of the stacked belief-propagation engine: 1e5 particles, 20 features, 15 measurements, and its growth.

python scripts/benchmark_bp.py
"""

from __future__ import annotations

import argparse
import json

from dopslam.studies.bp_timing import growth, seconds_per_step


def main() -> None:
    """Print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--particles", type=int, default=100_000)
    parser.add_argument(
        "--backends", nargs="+", default=["drjit", "numpy"], help="drjit, numba, numpy; the first grows"
    )
    parser.add_argument("--no-growth", action="store_true")
    options = parser.parse_args()
    result: dict = {
        name: seconds_per_step(options.particles, 20, 15, name, options.repeats) for name in options.backends
    }
    first, last = options.backends[0], options.backends[-1]
    result["ratio"] = result[last]["median"] / result[first]["median"]
    if not options.no_growth:
        result["growth"] = growth(first, options.repeats)
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
