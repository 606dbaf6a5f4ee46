"""Making a large dataset: shard after shard, resumable at any moment, shared by any number of processes."""

from __future__ import annotations

import contextlib
import shutil
from pathlib import Path
from typing import Any

from dopslam.config.scenario import Scenario
from dopslam.datasets import tracks
from dopslam.datasets.locks import FOLDER as LOCKS
from dopslam.datasets.locks import claim
from dopslam.datasets.manifest import FILE, Manifest, ShardEntry, read_manifest, write_manifest
from dopslam.datasets.plan import Plan, shard_file
from dopslam.datasets.shard import WORK, ShardTracer, inspect_shard, make_shard
from dopslam.errors import DatasetError
from dopslam.pipeline.stages import Progress, quiet
from dopslam.records import Landmarks


def generate(
    folder: str | Path, plan: Plan, scenario: Scenario, resume: bool = False, jobs: int = 1, progress: Progress = quiet
) -> Manifest:
    """Make the dataset of a plan, or what is missing of it.

    Parameters
    ----------
    folder : made if missing
    plan : see :func:`dopslam.datasets.plan.make_plan`
    scenario : the one the plan was made from
    resume : go on with a dataset that was begun, or help another process with it; whole shards are verified and kept,
    damaged
        ones are made again
    jobs : worker processes of the estimation, if detections are asked for
    progress : callback (stage, done, total) with positions

    Returns
    -------
    Manifest
        Complete, and the same to the last bit for any number of processes, workers and interruptions.

    Raises
    ------
    DatasetError
        For a folder that holds something else, another plan, or cannot be written. Finished shards stay.
    """
    folder = Path(folder)
    _enter(folder, plan, resume)
    source = tracks.sampled(scenario, plan.seed)
    maker = _Maker(folder, plan, scenario, source, jobs, progress)
    entries: dict[int, tuple[ShardEntry, Landmarks]] = {}
    # First whatever nobody else is at, then wait for the others: a shard whose maker died is free again.
    for wait in (False, True):
        for number in range(plan.shards):
            if number in entries:
                continue
            with claim(folder, number, wait) as mine:
                if mine:
                    entries[number] = maker.entry(number)
                    progress("dataset", sum(entry.positions for entry, _ in entries.values()), plan.positions)
    manifest = Manifest(
        plan,
        tuple(entries[number][0] for number in range(plan.shards)),
        _united([entries[number][1] for number in range(plan.shards)]),
    ).sealed()
    write_manifest(folder, manifest)
    for name in (WORK, LOCKS):
        shutil.rmtree(folder / name, ignore_errors=True)
    return manifest


class _Maker:
    """Keeps the tracer between shards, and loads it only if a shard has to be made."""

    def __init__(
        self, folder: Path, plan: Plan, scenario: Scenario, source: tracks.Tracks, jobs: int, progress: Progress
    ):
        self.folder, self.plan, self.scenario, self.source = folder, plan, scenario, source
        self.jobs, self.progress = jobs, progress
        self.tracer: ShardTracer | None = None

    def entry(self, number: int) -> tuple[ShardEntry, Landmarks]:
        """The entry of a shard, which is made if it is missing or damaged. Its lock must be held."""
        if shard_file(self.folder, number).exists():
            with contextlib.suppress(DatasetError):
                return inspect_shard(self.folder, self.plan, number)
        for left in (self.folder / WORK).glob(f"{number:05d}-*"):  # by a process that was killed
            shutil.rmtree(left, ignore_errors=True)
        self.tracer = self.tracer or ShardTracer(self.scenario, self.plan.seed)
        first, _ = self.plan.span(number)

        def estimated(stage: str, done: int, total: int) -> None:
            self.progress("estimate", first + done, self.plan.positions)

        make_shard(self.folder, self.plan, number, self.scenario, self.source, self.tracer, self.jobs, estimated)
        return inspect_shard(self.folder, self.plan, number, verify=False)


def _enter(folder: Path, plan: Plan, resume: bool) -> None:
    """Make the folder and its first manifest, or check that what is there is this very dataset."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # A process killed in its first moments leaves hidden files only.
        strangers = [p.name for p in folder.iterdir() if not p.name.startswith(".") and p.name != FILE]
    except OSError as error:
        raise DatasetError(f"{folder}: cannot be made or read ({error.strerror}); give another folder") from error
    if (folder / FILE).exists():
        if not resume:
            raise DatasetError(
                f"{folder}: holds a dataset already; add --resume to go on with it, or give another folder"
            )
        difference = read_manifest(folder).plan.difference(plan)
        if difference:
            raise DatasetError(
                f"{folder}: holds another dataset: {difference}; give the same options or another folder"
            )
        return
    if strangers:
        raise DatasetError(
            f"{folder}: is not empty ({sorted(strangers)[0]}, …) and holds no dataset; give another folder"
        )
    try:
        write_manifest(folder, Manifest(plan), fresh=True)
    except DatasetError:
        if not (resume and (folder / FILE).exists()):
            raise
        _enter(folder, plan, resume)  # another process was faster


def _united(parts: list[Landmarks]) -> tuple[dict[str, Any], ...]:
    """Every landmark of the shards once: BS, virtual anchors by order and name, scatter points in the scenario's
    order."""
    found: dict[str, dict[str, Any]] = {}
    rank: dict[str, tuple] = {}
    for marks in parts:
        for i, name in enumerate(marks.name.tolist()):
            kind, order = int(marks.kind[i]), int(marks.order[i])
            found[name] = {"name": name, "kind": kind, "order": order, "position": marks.position[i].tolist()}
            points = [n for n, k in zip(marks.name.tolist(), marks.kind.tolist(), strict=True) if k == 2]
            rank[name] = (kind, order, points.index(name) if kind == 2 else 0, name)
    return tuple(found[name] for name in sorted(found, key=rank.__getitem__))
