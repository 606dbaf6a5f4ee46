"""What people read of scores: the table of one answer, and the board of many as Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from dopslam.errors import DatasetError
from dopslam.studies.challenge.score import FIGURES


def table(result: dict) -> Table:
    """One answer: a column for every split."""
    splits = {name: s for name, s in result["splits"].items() if s["answered"]}
    shown = Table("", *splits, box=None, pad_edge=False, title=result["method"], title_justify="left")
    for column in shown.columns[1:]:
        column.justify = "right"
    for label, cell in _rows():
        shown.add_row(label, *(cell(s, True) for s in splits.values()))
    shown.caption_justify = "left"
    shown.caption = (
        "Medians over the cases, 95 % intervals. Bound: posterior Cramér–Rao, of what a step can know up to it."
    )
    return shown


def _rows() -> list:
    def figure(key: str, digits: int):
        def cell(split: dict, interval: bool) -> str:
            found = split[key]
            if found is None or found["value"] is None:
                return "–"
            between = f" ({found['low']:.{digits}f}–{found['high']:.{digits}f})" if interval else ""
            return f"{found['value']:.{digits}f}{between}"

        return cell

    def answered(split: dict, interval: bool) -> str:
        return f"{split['answered']} of {split['cases']}"

    def found(split: dict, interval: bool) -> str:
        share = split["landmarks_found"]
        return "–" if share is None else f"{share['value']:.0%} of {split['landmarks_counted']}"

    def false(split: dict, interval: bool) -> str:
        return "–" if split["landmarks_false_per_case"] is None else f"{split['landmarks_false_per_case']:.1f}"

    return [
        ("answered", answered),
        ("lost", lambda split, interval: str(split["lost"])),
        *((title, figure(key, digits)) for key, (title, digits) in FIGURES.items()),
        ("landmarks found", found),
        ("false a case", false),
    ]


def board(results: Sequence[dict]) -> str:
    """Tables of all answers in Markdown, a table for every split, the best median position first.

    Raises
    ------
    DatasetError
        If the answers are not to the same suite.
    """
    suites = {result["suite_sha256"] for result in results}
    if len(suites) != 1:
        raise DatasetError(f"board: answers to {len(suites)} different suites; score them on one")
    lines = []
    for split in results[0]["splits"]:
        answered = [r for r in results if r["splits"][split]["answered"]]
        ranked = sorted(answered, key=lambda r: r["splits"][split]["position_rmse_m"]["value"])
        titles = [label for label, _ in _rows()]
        lines += [f"## {split}", "", f"| method | {' | '.join(titles)} |", f"|---|{'---|' * len(titles)}"]
        for result in ranked:
            cells = [cell(result["splits"][split], label == "× bound") for label, cell in _rows()]
            lines.append(f"| {result['method']} | {' | '.join(cells)} |")
        lines.append("")
    return "\n".join([*lines, f"Suite: sha256 of its suite.json `{suites.pop()}`."]) + "\n"
