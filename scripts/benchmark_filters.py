#!/usr/bin/env python3
"""Time per step of the EK-PMB filter and its smoother, and how it grows with landmarks and detections.

python scripts/benchmark_filters.py
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace

from dopslam.simulate.world import section_v
from dopslam.slam.pmb.filters import Joint, Marginal, Smoother
from dopslam.studies.benchmark import growth, microseconds_per_step
from dopslam.studies.montecarlo import Study


def main() -> None:
    """Print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args().repeats
    plain, iterated = Joint(iterations=1), Joint(iterations=2)
    world = section_v()
    result = {
        "plain": microseconds_per_step(Study(world, plain), repeats),
        "iterated": microseconds_per_step(Study(world, iterated), repeats),
        "cubature": microseconds_per_step(Study(world, replace(iterated, linearization="cubature")), repeats),
        "marginal": microseconds_per_step(Study(world, Marginal(iterations=1)), repeats),
        "smoother": microseconds_per_step(Study(world, Smoother(iterations=2)), repeats),
        "growth": growth(repeats),
    }
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
