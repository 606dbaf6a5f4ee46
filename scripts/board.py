#!/usr/bin/env python3
"""The board: a page made from the result files of ``dopslam score … --json``.

python scripts/board.py docs/board/*.json > docs/board.md
"""

import json
import sys
from pathlib import Path

from dopslam.studies.challenge import detected
from dopslam.studies.challenge.board import board

HEAD = """# The board

Made from the files in [board/](board) by `python scripts/board.py docs/board/*.json > docs/board.md`; nothing is typed in. The
suite, how to take part and what the columns mean: [benchmark.md](benchmark.md). Medians over the cases of a split, with the
95 % interval for the ratio to the bound (of what a step can know up to it: methods that look back over the run may be below 1).

"""


def main() -> None:
    """Print the page."""
    results = [json.loads(Path(path).read_text(encoding="utf-8")) for path in sys.argv[1:]]
    if not results:
        sys.exit("board: name result files of 'dopslam score ANSWER --json FILE'")
    tracks: dict[str, list[dict]] = {}
    for result in results:
        tracks.setdefault(result.get("track", "detections to map"), []).append(result)
    pages = []
    for track, found in sorted(tracks.items()):
        page = detected.board(found) if track == detected.TRACK else board(found)
        pages.append(f"## {track[0].upper()}{track[1:]}\n\n" + page.replace("## ", "### "))
    sys.stdout.write(HEAD + "\n".join(pages))


if __name__ == "__main__":
    main()
