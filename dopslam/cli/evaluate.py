"""``dopslam evaluate``."""

from __future__ import annotations

from pathlib import Path

from dopslam.cli.common import Settings, leave_if_lost, overrides


def evaluate(dataset: Path, *, out: Path | None = None, settings: Settings = None) -> None:
    """Compare track and map with the truth and the bound: table, summary.json, figures.

    Parameters
    ----------
    dataset
        A file with the truth, detections, at least one filter history and its bound.
    out
        Folder for summary.json, table.txt and the figures; by default the dataset's own.
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
    summary, evaluations = stages.evaluate(dataset, overrides(settings))
    console = Console(markup=False)
    console.print(tables.run_table(summary))  # first: what a full disk cannot take back
    stages.report(dataset, target, summary, evaluations)
    leave_if_lost(summary, console)
