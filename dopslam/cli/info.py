"""``dopslam info``."""

from __future__ import annotations

from pathlib import Path


def info(dataset: Path) -> None:
    """Say what a dataset file holds.

    Parameters
    ----------
    dataset
        A file made by the other commands, or a folder made by 'dopslam dataset'.
    """
    from rich.console import Console
    from rich.table import Table

    from dopslam.store.file import describe

    if dataset.is_dir():
        _folder(dataset)
        return
    table = Table("group", "array", "shape", "type", "units", box=None)
    for row in describe(dataset):
        table.add_row(*row)
    Console(markup=False).print(table)


def _folder(folder: Path) -> None:
    from rich.console import Console
    from rich.table import Table

    from dopslam.datasets import read_manifest

    manifest = read_manifest(folder)
    plan, console = manifest.plan, Console(highlight=False, soft_wrap=True, markup=False)
    kinds = ["track", "steps", "landmarks", "paths", *["signal"] * plan.signal, *["detections"] * plan.detections]
    console.print(
        f"{plan.name}, seed {plan.seed}: {plan.positions} positions in {plan.shards} shards of {', '.join(kinds)}"
    )
    if not manifest.complete:
        console.print(f"not complete; go on with 'dopslam dataset … --out {folder} --resume'")
        return
    console.print(f"{len(manifest.landmarks)} landmarks: {', '.join(mark['name'] for mark in manifest.landmarks)}")
    table = Table("shard", "positions", "paths", "sha256", box=None)
    for entry in manifest.shards:
        table.add_row(entry.file, f"{entry.first}–{entry.first + entry.positions - 1}", str(entry.paths), entry.sha256)
    console.print(table)
    console.print(f"sha256 {manifest.sha256}")
