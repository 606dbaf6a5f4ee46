"""``dopslam evaluate``."""

from __future__ import annotations

from pathlib import Path

from dopslam.cli.common import Settings, leave_if_lost, overrides


def evaluate(dataset: Path, *, out: Path | None = None, align: bool = False, settings: Settings = None) -> None:
    """Compare track and map with the truth and the bound: table, summary.json, figures.

    Parameters
    ----------
    dataset
        A file with the truth, detections, at least one filter history and its bound.
    out
        Folder for summary.json, table.txt and the figures; by default the dataset's own.
    align
        Move track and map rigidly onto the truth first, for a truth in a frame of its own; no bound is set beside them.
    settings
        Override a scenario key, for instance --set evaluation.found_radius=1.
    """
    from rich.console import Console

    from dopslam.errors import DatasetError
    from dopslam.pipeline import file as stages
    from dopslam.report import tables
    from dopslam.store.place import refuse_unwritable

    target = out or dataset.resolve().parent
    if target.is_file():
        raise DatasetError(f"{target}: is a file; name a folder with --out")
    refuse_unwritable(target)
    summary, evaluations = stages.evaluate(dataset, overrides(settings), align=align)
    console = Console(markup=False)
    console.print(tables.run_table(summary))  # first: what a full disk cannot take back
    stages.report(dataset, target, summary, evaluations, align)
    leave_if_lost(summary, console)
