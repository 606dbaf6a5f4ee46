"""What the verbs share: option types, the progress display."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator, Sequence
from typing import Annotated

from cyclopts import Parameter

from dopslam.cli.bars import Progress, compiling, timed_bars


def _seed(_: type, value: int) -> None:
    if not 0 <= value < 2**63:
        raise ValueError(f"a seed is a whole number from 0 to 2^63 - 1, not {value}")


def _runs(_: type, value: int) -> None:
    if not 1 <= value <= LARGEST_RUNS:
        raise ValueError(f"a number of runs is a whole number from 1 to {LARGEST_RUNS}, not {value}")


LARGEST_JOBS = 1024
LARGEST_RUNS = 1_000_000
Runs = Annotated[int, Parameter(validator=_runs)]
Seed = Annotated[int, Parameter(validator=_seed)]
Settings = Annotated[list[str] | None, Parameter(name="--set", negative=())]
Filters = Annotated[list[str] | None, Parameter(name="--filter", negative=())]


def overrides(settings: list[str] | None, **flags: str | None) -> list[str]:
    """``--set`` texts plus the flags that are shorthand for scenario keys."""
    return [*(settings or []), *(f"{key.replace('__', '.')}={value}" for key, value in flags.items() if value)]


def filter_names(chosen: list[str] | None) -> list[str]:
    """Names of filters from ``--filter``, repeated or with commas; all are known."""
    from dopslam.errors import ConfigError
    from dopslam.filters import FILTERS

    names = [name.strip() for text in chosen or () for name in text.split(",") if name.strip()]
    if chosen and not names:
        raise ConfigError(f"--filter {','.join(chosen)!r} names no filter; known are {', '.join(FILTERS)}")
    for name in names:
        FILTERS[name]
    return list(dict.fromkeys(names))


def positive(text: str, option: str, remedy: str) -> float:
    """A positive finite number from the command line; ``remedy`` ends the message if it is none."""
    from dopslam.errors import ConfigError

    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 < value < float("inf"):
        raise ConfigError(f"{option} {text!r}: {remedy}")
    return value


def derived_text(derived: dict[str, dict]) -> str:
    """The values that a scenario left to follow from the others, as a person would have written them."""

    def value(v) -> str:
        return (
            f"[{', '.join(map(value, v))}]" if isinstance(v, tuple | list) else v if isinstance(v, str) else f"{v:.6g}"
        )

    return ", ".join(f"{section}.{key} = {value(v)}" for section, keys in derived.items() for key, v in keys.items())


def doppler_choice(text: str | None) -> tuple[bool, float | None]:
    """``--doppler-std``: whether Doppler is used, and its standard deviation [m/s] if one is given."""
    if text is None:
        return True, None
    if text.lower() == "none":
        return False, None
    return True, positive(text, "--doppler-std", "give a positive number in m/s, or none")


def worker_count(jobs: int | None) -> int:
    """Number of worker processes: the one asked for, or one for each core that this process may use."""
    from dopslam.errors import ConfigError

    if jobs is not None and not 1 <= jobs <= LARGEST_JOBS:
        raise ConfigError(f"--jobs {jobs}: give a number of worker processes from 1 to {LARGEST_JOBS}")
    return jobs or len(os.sched_getaffinity(0))


@contextlib.contextmanager
def progress_display() -> Iterator[Progress]:
    """A callback (stage, done, total) drawn as one bar per stage on standard error, with the time left; the first run's
    compiling has one of its own."""
    with timed_bars() as progress, compiling(progress):
        yield progress


REMEDY = (
    'check start, motion and covariances; --set filter.start="snapshot" starts from the detections alone, --filter batch '
    "looks at all of them at once"
)


def restarted_text(variant: str, why: str) -> str:
    """That a filter lost its receiver and was started anew."""
    return f"restarted: {variant}: {why}; started anew from the scans (filter.restart)"


def told_of_compiling(console, names: Sequence[str]) -> None:
    """Say that filters ran interpreted and that their compilation goes on, where that is so."""
    from dopslam.pipeline import ahead

    if ahead.missing(names):
        console.print(
            "note: the filters ran interpreted; they are being compiled in the background, which takes a minute or two, once",
            highlight=False,
        )


def leave_if_lost(summary: dict, console) -> None:
    """Name every filter that was started anew or diverged; leave with 3 if the leading one did diverge."""
    for name, figures in summary["variants"].items():
        if figures.get("restarted"):
            console.print(restarted_text(name, figures["restarted"]))
    lost = [name for name, figures in summary["variants"].items() if figures.get("diverged")]
    if lost:
        console.print(f"diverged: {', '.join(lost)}; do not use these tracks ({REMEDY})", style="bold red")
        for name in lost:
            if "lost" in summary["variants"][name]:
                console.print(f"{name}: {summary['variants'][name]['lost']}")
    if summary["filter"] in lost:
        sys.exit(3)
