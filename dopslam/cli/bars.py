"""Progress with the time left, for long work."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

Progress = Callable[[str, int, int], None]


@contextlib.contextmanager
def timed_bars() -> Iterator[Progress]:
    """A callback (stage, done, total) drawn as one bar per stage on standard error, with elapsed time and time left.

    Where standard error is no terminal, a log for instance, nothing is drawn.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars

    columns = (
        TextColumn("{task.description:<9}", markup=False), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left"),
        TimeRemainingColumn(),
    )  # fmt: skip
    console = Console(stderr=True, markup=False)
    with Bars(*columns, console=console, speed_estimate_period=600, disable=not console.is_terminal) as bars:
        tasks: dict = {}

        def report(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield report


FUNCTIONS = 150  # that the first filter compiles on its first run, about; what the time left is reckoned from


@contextlib.contextmanager
def compiling(progress: Progress) -> Iterator[None]:
    """Show a bar of its own while functions are compiled, which the first run on a machine does for about a minute.

    Nothing is shown where the machine code is on the disk already. The number of functions is not known beforehand: the bar
    ends when the work does.
    """
    from numba.core import event

    class Watch(event.Listener):
        done = 0

        def on_start(self, event: event.Event) -> None:
            progress("compile", self.done, max(FUNCTIONS, self.done + 1))

        def on_end(self, event: event.Event) -> None:
            self.done += 1

    watch = Watch()
    event.register("numba:compile", watch)
    try:
        yield
    finally:
        event.unregister("numba:compile", watch)
        if watch.done:
            progress("compile", watch.done, watch.done)
