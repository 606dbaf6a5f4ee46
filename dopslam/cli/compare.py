"""``dopslam compare``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def compare(
    results: list[Path],
    /,
    *,
    filters: Annotated[list[str] | None, Parameter(name="--filter", negative=())] = None,
    out: Path = Path("comparison"),
) -> None:
    """Put several runs beside each other: one table, one figure, differences on the same seeds.

    The first entry is the one that the others are compared with. Runs pair by scenario name and seed.

    Parameters
    ----------
    results
        Results folders, folders that hold several (one for each seed), or JSON files of montecarlo and of the traced study.
    filters
        Only this variant, for instance "joint" or "joint, no Doppler"; may be repeated. Default all.
    out
        Folder for comparison.txt, comparison.json and comparison.png.
    """
    from rich.console import Console

    from dopslam.errors import DatasetError
    from dopslam.report import tables
    from dopslam.report.figures import house_style
    from dopslam.report.folder import write_json, write_text
    from dopslam.store.place import refuse_unwritable
    from dopslam.studies import compare as comparing
    from dopslam.studies import compared

    if out.is_file():
        raise DatasetError(f"{out}: is a file; name a folder with --out")
    refuse_unwritable(out / "comparison.png")
    found = comparing.read(results, filters or ())
    Console(markup=False).print(compared.table(found))
    write_text(out / "comparison.txt", tables.as_text(compared.table(found), width=120))
    write_json(out / "comparison.json", found.tree())
    with house_style():
        compared.figure(found).savefig(out / "comparison.png")
    Console(highlight=False, soft_wrap=True, markup=False).print(f"written: {out / 'comparison.png'}")
