"""One shard: traced, synthesized and estimated as asked for, and put in its place whole."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dopslam.config.scenario import Scenario, parse
from dopslam.datasets.manifest import ShardEntry, sync_folder
from dopslam.datasets.plan import Plan, shard_file
from dopslam.datasets.tracks import Steps, Tracks
from dopslam.errors import DatasetError
from dopslam.pipeline import stages as pipeline
from dopslam.pipeline.problem import base_stations
from dopslam.pipeline.stages import Progress, quiet
from dopslam.records import BaseStations, Landmarks, Paths, Track
from dopslam.report.folder import versions
from dopslam.store import file as dataset

RECORDS = {"base_stations": BaseStations, "track": Track, "steps": Steps, "landmarks": Landmarks, "paths": Paths}


@dataclass(frozen=True)
class ShardSignal:
    """Snapshots of a shard, made when asked for; noise depends on the number of the position in the whole dataset."""

    scenario_toml: str
    track: Track
    paths: Paths
    seed: int
    first: int
    time = None  # several drives, each with a time of its own

    @property
    def steps(self) -> int:
        """Number of snapshots."""
        return self.paths.steps

    def snapshot(self, step: int) -> np.ndarray:
        """Received signal of one position, eq. (2): complex64 (subcarriers, symbols, receive elements) in √W."""
        scenario = parse(self.scenario_toml)
        return pipeline.synthesize_snapshot(scenario, self.track, self.paths, step, self.seed, self.first + step)


class ShardTracer:
    """Loads the scene once and traces shard after shard with one compiled kernel."""

    def __init__(self, scenario: Scenario, seed: int):
        from dopslam import raytracing

        source, points, settings = pipeline.tracing_inputs(scenario, seed)
        place = np.array(scenario.base_station.position)
        self.tracer = raytracing.Tracer(source, scenario.radio.carrier_frequency, place, points, settings)
        self.unit, self.together = self.tracer.receivers_per_call, 1

    def trace(self, track: Track) -> tuple[Landmarks, Paths]:
        """Landmarks and paths of a shard's positions."""
        from dopslam import raytracing

        # Another number of receivers in a call would compile another kernel: fill up to whole calls.
        extra = -track.steps % self.unit
        position = np.concatenate([track.position, np.repeat(track.position[-1:], extra, axis=0)])
        velocity = np.concatenate([track.velocity, np.repeat(track.velocity[-1:], extra, axis=0)])
        self.together = max(self.together, len(position) // self.unit)
        joined = raytracing.join(list(self.tracer.chunks(position, velocity, self.together)))
        return joined.landmarks, joined.paths.take(slice(track.steps))


def make_shard(
    folder: Path,
    plan: Plan,
    number: int,
    scenario: Scenario,
    source: Tracks,
    tracer: ShardTracer,
    jobs: int = 1,
    progress: Progress = quiet,
) -> None:
    """Make one shard and move it into place.

    Raises
    ------
    DatasetError
        When it cannot be written; then there is no shard and nothing half of one.
    """  # fmt: skip
    first, count = plan.span(number)
    track, steps = source.part(first, count)
    landmarks, paths = tracer.trace(track)
    records: dict[str, Any] = {
        "base_stations": base_stations(scenario), "track": track, "steps": steps, "landmarks": landmarks, "paths": paths,
    }  # fmt: skip
    signal = ShardSignal(plan.scenario, track, paths, plan.seed, first)
    with _workplace(folder, number) as part:
        if plan.detections:
            records["detections"] = pipeline.estimate(scenario, signal, jobs, progress)
        notes = {"shard": number, "versions": json.dumps(versions())}
        dataset.write_records(part, records, plan.scenario, plan.seed, notes)
        if plan.signal:
            dataset.write_signal(part, map(signal.snapshot, range(count)), count)
        try:
            os.replace(part, shard_file(folder, number))
            sync_folder(folder)
        except OSError as error:
            raise DatasetError(f"{shard_file(folder, number)}: cannot be written ({error.strerror})") from error


@contextlib.contextmanager
def _workplace(folder: Path, number: int) -> Iterator[Path]:
    """A file name in a new folder beside the shards, on the same file system; the folder goes in any case."""
    try:
        place = Path(tempfile.mkdtemp(prefix=f"{number:05d}-", dir=_made(Path(folder) / WORK)))
    except OSError as error:
        raise DatasetError(
            f"{folder}: cannot be written ({error.strerror}); make room or give another folder"
        ) from error
    try:
        yield place / "shard.h5"
    finally:
        shutil.rmtree(place, ignore_errors=True)


WORK = ".work"


def _made(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    return folder


def shard_hash(hashes: dict[str, str]) -> str:
    """sha256 of a shard's content from those of its groups."""
    text = "".join(f"{group}:{hashes[group]};" for group in sorted(hashes))
    return hashlib.sha256(text.encode()).hexdigest()


def expected_groups(plan: Plan) -> set[str]:
    """Groups that every shard of a plan holds."""
    return set(RECORDS) | ({"signal"} if plan.signal else set()) | ({"detections"} if plan.detections else set())


def inspect_shard(folder: Path, plan: Plan, number: int, verify: bool = True) -> tuple[ShardEntry, Landmarks]:
    """A shard's entry in the manifest, and its landmarks.

    Parameters
    ----------
    verify : read everything and recompute its hashes instead of believing those in the file

    Raises
    ------
    DatasetError
        When the shard is missing, damaged, or not one of this plan.
    """
    path = shard_file(folder, number)
    hashes = dataset.stored_hashes(path)
    if set(hashes) != expected_groups(plan):
        raise DatasetError(
            f"{path}: holds {', '.join(hashes)} where {', '.join(sorted(expected_groups(plan)))} are expected"
        )
    if verify:
        hashes = {group: dataset.verify_group(path, group) for group in hashes}
    if dataset.read_root(path) != (plan.scenario, plan.seed) or dataset.root_attributes(path).get("shard") != number:
        raise DatasetError(f"{path}: was made from another scenario, seed or number; remove it and add --resume")
    first, count = plan.span(number)
    index = dataset.read_record(path, "steps", Steps).index
    shapes = {(group, name): shape for group, name, shape, *_ in dataset.describe(path)}
    right = np.array_equal(index, np.arange(first, first + count)) and shapes["track", "time"] == str(count)
    if not right:
        raise DatasetError(
            f"{path}: does not hold the positions {first} to {first + count - 1}; remove it and add --resume"
        )
    return ShardEntry(path.name, first, count, int(shapes["paths", "tau"]), shard_hash(hashes)), dataset.read_record(
        path, "landmarks", Landmarks
    )
