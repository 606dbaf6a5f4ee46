"""``dopslam benchmark make`` and ``dopslam benchmark run``."""

from __future__ import annotations

import sys
from pathlib import Path

from cyclopts import App

from dopslam.cli.common import Filters, filter_names, told_of_compiling, worker_count

benchmark = App(name="benchmark", help="A frozen suite of detections: make it, run filters on it.")


@benchmark.command
def make(
    out: Path = Path("suite"),
    *,
    truth: Path | None = None,
    scenes: int = 1,
    seeds: int = 2,
    steps: int = 20,
    first: int | None = None,
    signal: bool = False,
    jobs: int | None = None,
) -> None:
    """Make a suite: scenes x drives x noise levels, detections as files with checksums, the truth in a folder apart.

    Parameters
    ----------
    out
        Folder of the suite; participants get this one.
    truth
        Folder of the truth; default <out>-truth.
    scenes
        Generated scenes of every kind (street, plaza, room, corridor, hall) in each of the splits develop and test.
    seeds
        Drives through every scene.
    steps
        Snapshots of a drive.
    first
        Seed of the first test scene. The default suite is the same for everyone, so that its truth can be remade by whoever
        has this program; a seed of your own, kept to yourself, makes a test half that nobody knows.
    signal
        The first drive through every scene with its received signal too, for estimators: about 25 MB a snapshot over the
        five kinds, in either split.
    jobs
        Worker processes; default one per core.
    """
    from rich.console import Console

    from dopslam.errors import ConfigError
    from dopslam.studies.challenge.cases import DEVELOP, FIRST_SCENE, TEST, plan
    from dopslam.studies.challenge.make import make as write

    if min(scenes, seeds, steps) < 1:
        raise ConfigError("--scenes, --seeds and --steps are whole numbers from 1")
    seeds_of = FIRST_SCENE if first is None else {DEVELOP: FIRST_SCENE[DEVELOP], TEST: first}
    apart = out.with_name(f"{out.name}-truth") if truth is None else truth
    with _bars() as progress:
        made = write(out, apart, plan(scenes, seeds, seeds_of), steps, worker_count(jobs), progress, signal)
    Console(highlight=False, soft_wrap=True, markup=False).print(
        f"{out}: {len(made['cases'])} cases; truth in {apart}; next: dopslam benchmark run {out} --filter joint"
    )


@benchmark.command
def run(
    suite: Path,
    *,
    filters: Filters = None,
    estimator: str | None = None,
    out: Path = Path("answers"),
    split: str | None = None,
) -> None:
    """Run filters or an estimator over the cases of a suite; leaves an answer (CSV) of each.

    Parameters
    ----------
    suite
        Folder made by 'dopslam benchmark make'.
    filters
        One or several, repeated or with commas, own ones as file.py:Class. Default joint.
    estimator
        Begin at the signals (a suite made with --signal): nomp, sage, … or one of your own as file.py:Class. Its detections are
        an answer, and with --filter the maps that the filters make of them.
    out
        Folder for <filter>.csv, <estimator>.csv, <estimator>+<filter>.csv.
    split
        develop or test alone; default both.
    """
    from rich.console import Console

    from dopslam.report.folder import safe_name, write_text
    from dopslam.store.place import refuse_unwritable
    from dopslam.studies.challenge.filtered import answers
    from dopslam.studies.challenge.signals import estimated

    refuse_unwritable(out / "joint.csv")
    console = Console(highlight=False, soft_wrap=True, markup=False)

    def leave(name: str, text: str) -> None:
        path = out / f"{safe_name(name)}.csv"
        write_text(path, text)
        console.print(f"written: {path}; next: dopslam score {path} --suite {suite}")

    every: dict[str, str] = {}
    if estimator is not None:
        with _bars() as progress:
            text, maps, every = estimated(suite, estimator, split, tuple(filter_names(filters)), progress)
        own = estimator.rpartition(":")[2]
        leave(own, text)
        for name, text in maps.items():
            leave(f"{own}+{name.rpartition(':')[2]}", text)
    else:
        for name in filter_names(filters) or ["joint"]:
            with _bars() as progress:
                text, failed = answers(suite, name, split, progress)
            every |= {f"{case}, {name}": why for case, why in failed.items()}
            leave(name.rpartition(":")[2], text)
    told_of_compiling(console, filter_names(filters) or ([] if estimator else ["joint"]))
    for case, why in every.items():
        console.print(f"failed: {case}: {why}")
    if every:
        sys.exit(1)


def _bars():
    from dopslam.cli.bars import timed_bars

    return timed_bars()
