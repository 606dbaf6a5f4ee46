"""The table a run ends with, as a rich table and as text."""

from __future__ import annotations

import io

from rich.console import Console
from rich.table import Table


def run_table(summary: dict) -> Table:
    """Figures of every filter variant, one column each.

    Parameters
    ----------
    summary : the content of ``summary.json``; its ``variants`` map a name to figures
    """
    variants = summary["variants"]
    table = Table(title=f"{summary['scenario']}, seed {summary['seed']}", title_justify="left", box=None, pad_edge=False)
    table.add_column("")
    for name in variants:
        table.add_column(name.replace(", ", "\n"), justify="right")
    for label, text in _ROWS:
        table.add_row(label, *(text(v) for v in variants.values()))
    table.caption = (
        "RMSE: root mean square over the steps; in brackets its ratio to the bound's (PEB, HEB, CEB).\n"
        f"GOSPA, and landmarks found within {summary['found_within_m']:g} m, at the last step. VA: virtual anchor, SP: scatter point."
    )
    table.caption_justify = "left"
    return table


def _with_ratio(key: str, part: str):
    return lambda v: f"{v[key]:.4f} ({v['rmse_over_bound'][part]:.2f})"


_ROWS = (
    ("position RMSE, m", _with_ratio("position_rmse_m", "position")),
    ("heading RMSE, °", _with_ratio("heading_rmse_deg", "heading")),
    ("clock bias RMSE, m", _with_ratio("clock_bias_rmse_m", "clock")),
    ("NEES (expect 4)", lambda v: f"{v['nees']:.1f}"),
    ("GOSPA of VAs, m", lambda v: f"{v['gospa_va_m']:.2f}"),
    ("GOSPA of SPs, m", lambda v: f"{v['gospa_sp_m']:.2f}"),
    ("VAs found", lambda v: f"{v['va_found']['found']} of {v['va_found']['of']}"),
    ("SPs found", lambda v: f"{v['sp_found']['found']} of {v['sp_found']['of']}"),
)


def as_text(table: Table) -> str:
    """The table as plain text."""
    buffer = io.StringIO()
    Console(file=buffer, width=100, color_system=None).print(table)
    return buffer.getvalue()
