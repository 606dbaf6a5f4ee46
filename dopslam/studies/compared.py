"""The table, the figure and the words of a comparison (:mod:`dopslam.studies.compare`)."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from dopslam.evaluate.statistics import Interval
from dopslam.studies.compare import QUANTITIES, Comparison

DRAWN = ("position_rmse_m", "heading_rmse_deg", "clock_bias_rmse_m")
FIRST, OTHER, BETTER, WORSE = "#5b6674", "#0072B2", "#009E73", "#D55E00"


def _texts(found: Interval | None, digits: int, sign: bool = False) -> tuple[str, str]:
    """A figure and its interval."""
    if found is None or not np.isfinite(found.value):
        return "–", ""
    form = f"{'+' if sign else ''}.{digits}f"
    between = f"{found.low:{form}} to {found.high:{form}}" if np.isfinite(found.low) else ""
    return format(found.value, form), between


def table(found: Comparison) -> Table:
    """A block for every figure, in it a row for every entry, beside it the difference to the first."""
    shown = Table("", "", "95 %", "less the first", "95 %", box=None, pad_edge=False)
    for column in shown.columns[1:]:
        column.justify, column.no_wrap = "right", True
    first = found.entries[0]
    for quantity in found.quantities:
        title, digits, _ = QUANTITIES[quantity]
        shown.add_row(title, style="bold")
        for entry in found.entries:
            lost = f", {entry.diverged} lost" if entry.diverged else ""
            gap = entry.difference(first, quantity) if entry is not first else None
            beside = _texts(gap, digits, sign=True) if entry is not first else ("", "")
            shown.add_row(
                f"  {entry.name} ({len(entry.runs)}{lost})", *_texts(entry.interval(quantity), digits), *beside,
                style="red" if entry.diverged else None,
            )  # fmt: skip
    shown.caption, shown.caption_justify = words(found), "left"
    return shown


def words(found: Comparison) -> str:
    """What the figures and intervals mean."""
    first = found.entries[0]
    lines = [f"In brackets the number of runs. The first is {first.name}."]
    several = any(len(e.runs) > 1 for e in found.entries)
    if several:
        lines.append(
            "Of several runs: means over the runs, Student's intervals; differences are paired on the same seeds."
        )
    if any(len(e.runs) == 1 and e.steps for e in found.entries):
        lines.append(
            "Of a single run: root mean squares over its steps. Steps are not independent, so that the interval (blocks of "
            "steps drawn anew) says how much the figure hangs on single stretches of this run, and nothing about other runs."
        )
    apart = [e.name for e in found.entries[1:] if not found.shared(e)]
    if apart:
        lines.append(f"No seed in common with the first, no difference: {', '.join(apart)}.")
    changed = found.differing
    for key, values in list(changed.items())[:8]:
        lines.append(f"differs: {key} = {' | '.join(map(str, dict.fromkeys(map(str, values))))}")
    if len(changed) > 8:
        lines.append(f"and {len(changed) - 8} more keys")
    return "\n".join(lines)


def figure(found: Comparison) -> Figure:
    """Figures of every entry on the left, differences to the first on the right, with their intervals."""
    names, rows = [e.name for e in found.entries], list(range(len(found.entries)))
    quantities = [q for q in DRAWN if q in found.quantities] or found.quantities[:3]
    drawn = Figure(figsize=(9.5, (0.9 + 0.42 * len(names)) * len(quantities)))
    panels = drawn.subplots(len(quantities), 2, squeeze=False, width_ratios=(1, 1))
    for (left, right), quantity in zip(panels, quantities, strict=True):
        for row, entry in zip(rows, found.entries, strict=True):
            color = FIRST if row == 0 else OTHER
            _whisker(left, row, entry.interval(quantity), color)
            gap = entry.difference(found.entries[0], quantity) if row else None
            if gap is not None:
                clear = np.isfinite(gap.low) and gap.low * gap.high > 0
                _whisker(right, row, gap, (BETTER if gap.value < 0 else WORSE) if clear else FIRST)
        left.set(xlabel=QUANTITIES[quantity][0], yticks=rows, yticklabels=names)
        left.set_xlim(left=0)
        right.axvline(0.0, color="#000000", linewidth=0.8)
        right.set(xlabel=f"{QUANTITIES[quantity][0]}, less {names[0]}", yticks=rows, yticklabels=[])
        for axes in (left, right):
            axes.set_ylim(len(names) - 0.5, -0.5)
            axes.tick_params(axis="y", length=0)
    panels[0, 0].set_title("Root mean square errors, 95 % intervals")
    panels[0, 1].set_title("Differences on the same seeds (colored: not zero)")
    return drawn


def _whisker(axes, row: int, found: Interval, color: str) -> None:
    if np.isfinite(found.value):
        axes.plot(found.value, row, "o", color=color, markersize=6)
    if np.isfinite(found.low):
        axes.plot([found.low, found.high], [row, row], color=color, linewidth=2, solid_capstyle="round")
