"""``dopslam view``: the report of a run in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def view(results: Path = Path("runs/latest"), *, open_: Annotated[bool, Parameter(name="--open")] = True) -> None:
    """Open report.html of a results folder, made anew from its dataset where it is missing.

    Parameters
    ----------
    results
        Results folder, report.html, or a dataset file that holds a filter's history and its bound.
    open_
        Show it in the browser; --no-open only makes it and prints its path.
    """
    import webbrowser

    from dopslam.errors import DatasetError
    from dopslam.pipeline import file as stages

    page = results / "report.html" if results.is_dir() else results
    if page.suffix != ".html" or not page.exists():
        data = results / "dataset.h5" if results.is_dir() else results
        if data.suffix == ".html" or not data.exists():
            raise DatasetError(
                f"{results}: neither a results folder with report.html or dataset.h5 nor a dataset; 'dopslam run' makes one"
            )
        page = data.with_name("report.html")
        stages.report(data, data.parent, *stages.evaluate(data))
    print(f"report: {page.resolve()}")
    if open_:
        webbrowser.open(page.resolve().as_uri())
