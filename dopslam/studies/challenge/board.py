"""What people read of scores: the table of one answer, and the board of many as Markdown."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from rich.table import Table

from dopslam.errors import DatasetError
from dopslam.studies.challenge.score import FIGURES

Rows = Sequence[tuple[str, Callable[[dict], str]]]  # labels, and what stands there of the figures of a split


def table(result: dict) -> Table:
    """One answer: a column for every split."""
    caption = "Medians over the cases, 95 % intervals. Bound: posterior Cramér–Rao, of what a step can know up to it."
    return table_of(result, _rows(True), caption)


def board(results: Sequence[dict]) -> str:
    """Tables of all answers in Markdown, a table for every split, the best median position first.

    Raises
    ------
    DatasetError
        If the answers are not to the same suite.
    """
    return board_of(results, _rows(False), lambda split: split["position_rmse_m"]["value"])


def table_of(result: dict, rows: Rows, caption: str) -> Table:
    """One answer of any track."""
    splits = {name: s for name, s in result["splits"].items() if s["answered"]}
    shown = Table("", *splits, box=None, pad_edge=False, title=result["method"], title_justify="left")
    for column in shown.columns[1:]:
        column.justify = "right"
    for label, cell in rows:
        shown.add_row(label, *(cell(s) for s in splits.values()))
    shown.caption_justify, shown.caption = "left", caption
    return shown


def board_of(results: Sequence[dict], rows: Rows, rank: Callable[[dict], float]) -> str:
    """Tables of all answers of one track in Markdown, a table for every split, the least `rank` of its figures first.

    Raises
    ------
    DatasetError
        If the answers are not to the same suite.
    """
    suites = {result["suite_sha256"] for result in results}
    if len(suites) != 1:
        raise DatasetError(f"board: answers to {len(suites)} different suites; score them on one")
    lines, titles = [], [label for label, _ in rows]
    for split in results[0]["splits"]:
        answered = [r for r in results if r["splits"][split]["answered"]]
        ranked = sorted(answered, key=lambda r: rank(r["splits"][split]))
        lines += [f"## {split}", "", f"| method | {' | '.join(titles)} |", f"|---|{'---|' * len(titles)}"]
        lines += [f"| {r['method']} | {' | '.join(cell(r['splits'][split]) for _, cell in rows)} |" for r in ranked]
        lines.append("")
    return "\n".join([*lines, f"Suite: sha256 of its suite.json `{suites.pop()}`."]) + "\n"


def _rows(intervals: bool) -> Rows:
    """Rows of the track detections to map, with all intervals or with that of the ratio to the bound alone."""

    def figure(key: str, digits: int, interval: bool):
        def cell(split: dict) -> str:
            found = split[key]
            if found is None or found["value"] is None:
                return "–"
            between = f" ({found['low']:.{digits}f}–{found['high']:.{digits}f})" if interval else ""
            return f"{found['value']:.{digits}f}{between}"

        return cell

    def found(split: dict) -> str:
        share = split["landmarks_found"]
        return "–" if share is None else f"{share['value']:.0%} of {split['landmarks_counted']}"

    def false(split: dict) -> str:
        return "–" if split["landmarks_false_per_case"] is None else f"{split['landmarks_false_per_case']:.1f}"

    return [
        ("answered", lambda split: f"{split['answered']} of {split['cases']}"),
        ("lost", lambda split: str(split["lost"])),
        *((title, figure(k, digits, intervals or title == "× bound")) for k, (title, digits) in FIGURES.items()),
        ("landmarks found", found),
        ("false a case", false),
    ]
