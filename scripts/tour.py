"""The tutorials in one go: own detections, own filter, own estimator, and with --all also a first run and an own scene.

Each is a script in cells of its own, docs/tutorials/<number>_<what>.py, to be read and copied; this runs them as they stand.
"""

from __future__ import annotations

import argparse
import runpy
from pathlib import Path

TUTORIALS = Path(__file__).resolve().parent.parent / "docs" / "tutorials"
QUICK = ("2", "4", "5")  # those that trace nothing


def main() -> None:
    """Run them in their order."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--all", action="store_true", help="those that trace as well, a few minutes more")
    everything = parser.parse_args().all
    for script in sorted(TUTORIALS.glob("[0-9]_*.py")):
        if everything or script.name.startswith(QUICK):
            print(f"\n=== {script.relative_to(TUTORIALS.parent.parent)}")
            runpy.run_path(str(script), run_name="__main__")


if __name__ == "__main__":
    main()
