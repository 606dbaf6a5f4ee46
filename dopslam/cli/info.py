"""``dopslam info``."""

from __future__ import annotations

from pathlib import Path


def info(dataset: Path) -> None:
    """Say what a dataset file holds.

    Parameters
    ----------
    dataset
        A file made by the other commands.
    """
    from rich.console import Console
    from rich.table import Table

    from dopslam.dataset import describe

    table = Table("group", "array", "shape", "type", "units", box=None)
    for row in describe(dataset):
        table.add_row(*row)
    Console().print(table)
