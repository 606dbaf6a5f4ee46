"""``dopslam check``."""

from __future__ import annotations

from pathlib import Path


def check(path: Path) -> None:
    """Validate a dataset folder or file and say what is wrong where; exit code 2 if anything is.

    Parameters
    ----------
    path
        Folder made by 'dopslam dataset', or a dataset file.
    """
    from rich.console import Console

    from dopslam.cli.bars import timed_bars
    from dopslam.datasets import check as validate
    from dopslam.errors import DatasetError

    with timed_bars() as progress:
        findings = validate(path, progress)
    console = Console(highlight=False, soft_wrap=True, markup=False)
    for finding in findings:
        console.print(f"{finding.where}: {finding.what}")
    if findings:
        raise DatasetError(f"{path}: {len(findings)} fault{'s' if len(findings) > 1 else ''} found, listed above")
    console.print(f"{path}: all is well")
