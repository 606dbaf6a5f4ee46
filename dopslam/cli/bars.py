"""Progress with the time left, for long work."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from dopslam.cli.common import Progress


@contextlib.contextmanager
def timed_bars() -> Iterator[Progress]:
    """A callback (stage, done, total) drawn as one bar per stage on standard error, with elapsed time and time left."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars

    columns = (
        TextColumn("{task.description:<9}", markup=False), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left"),
        TimeRemainingColumn(),
    )  # fmt: skip
    with Bars(*columns, console=Console(stderr=True, markup=False), speed_estimate_period=600) as bars:
        tasks: dict = {}

        def report(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield report
