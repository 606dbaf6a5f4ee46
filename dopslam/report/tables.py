"""The table a run ends with, as a rich table and as text."""

from __future__ import annotations

import io

from rich.console import Console
from rich.table import Table


def run_table(summary: dict) -> Table:
    """Errors of every filter variant beside its bound.

    Parameters
    ----------
    summary : the content of ``summary.json``; its ``variants`` map a name to figures
    """
    table = Table(title=f"{summary['scenario']}, seed {summary['seed']}", title_justify="left", box=None, pad_edge=False)
    table.add_column("filter")
    for name in ("position m", "PEB m", "ratio", "heading °", "HEB °", "clock m", "CEB m", "NEES (4)",
                 "GOSPA VA m", "SP m", "VAs", "SPs"):  # fmt: skip
        table.add_column(name, justify="right")
    for name, v in summary["variants"].items():
        table.add_row(
            name,
            f"{v['position_rmse_m']:.4f}", f"{v['peb_m']:.4f}", f"{v['rmse_over_bound']['position']:.2f}",
            f"{v['heading_rmse_deg']:.4f}", f"{v['heb_deg']:.4f}", f"{v['clock_bias_rmse_m']:.4f}", f"{v['ceb_m']:.4f}",
            f"{v['nees']:.1f}", f"{v['gospa_va_m']:.2f}", f"{v['gospa_sp_m']:.2f}",
            f"{v['va_found']['found']}/{v['va_found']['of']}", f"{v['sp_found']['found']}/{v['sp_found']['of']}",
        )  # fmt: skip
    table.caption = (
        f"root mean squares over the steps; GOSPA and landmarks (within {summary['found_within_m']:g} m) at the last step"
    )
    table.caption_justify = "left"
    return table


def as_text(table: Table) -> str:
    """The table as plain text."""
    buffer = io.StringIO()
    Console(file=buffer, width=140, color_system=None).print(table)
    return buffer.getvalue()
