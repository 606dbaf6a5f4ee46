"""Everything that can be verified about a dataset folder or file, and what is wrong where."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from dopslam.config.scenario import parse
from dopslam.datasets import plausible
from dopslam.datasets.manifest import FILE, Manifest, read_manifest
from dopslam.datasets.plan import shard_file
from dopslam.datasets.shard import inspect_shard
from dopslam.datasets.tracks import Steps
from dopslam.errors import ConfigError, DatasetError, DopslamError
from dopslam.evaluate.bounds import Bound
from dopslam.evaluate.walls import Walls
from dopslam.pipeline.preflight import Finding
from dopslam.pipeline.stages import Progress, quiet
from dopslam.records import SPEED_OF_LIGHT, BaseStations, DetectionSeries, FloorPlan, Landmarks, Mesh, Paths, Track
from dopslam.records.consistency import misfits
from dopslam.slam.history import History
from dopslam.store import file as dataset
from dopslam.store.schema import UNSAID, unit_of

RECORDS = (Track, Steps, Landmarks, BaseStations, Paths, DetectionSeries, History, Bound, FloorPlan, Mesh, Walls)
TYPES = {kind.__name__: kind for kind in RECORDS}
LENGTH_TOLERANCE = 1e-6  # m, between a delay and the length along its interaction points


def check(path: str | Path, progress: Progress = quiet) -> list[Finding]:
    """Validate a dataset folder or a dataset file.

    Verified are: the manifest, that every shard is there and belongs to it, checksums and content hashes of every
    array, schema
    and shapes, finite values, and physics: each delay is the length along its interaction points, angles are those of
    its first
    and last legs, indices exist, covariances are positive definite.

    Returns
    -------
    list of Finding
        Empty if all is well.
    """
    path = Path(path)
    if path.is_dir():
        return list(_folder(path, progress))
    return list(_file(path))


def _folder(folder: Path, progress: Progress) -> Iterator[Finding]:
    try:
        manifest = read_manifest(folder)
    except DatasetError as error:
        yield Finding(FILE, str(error))
        return
    if manifest.complete and len(manifest.shards) != manifest.plan.shards:
        yield Finding(FILE, f"lists {len(manifest.shards)} shards of {manifest.plan.shards}")
    if not manifest.complete:
        done = len(list(folder.glob("shard-*.h5")))
        todo = f"{done} of {manifest.plan.shards} shards are there"
        yield Finding(FILE, f"the dataset is not complete ({todo}); go on with 'dopslam dataset … --resume'")
    expected = {shard_file(folder, number).name for number in range(manifest.plan.shards)} | {FILE}
    for stranger in sorted(p.name for p in folder.iterdir() if not p.name.startswith(".") and p.name not in expected):
        yield Finding(stranger, "is no part of this dataset")
    for number in range(manifest.plan.shards):
        progress("check", number, manifest.plan.shards)
        if manifest.complete or shard_file(folder, number).exists():
            yield from _shard(folder, manifest, number)
    progress("check", manifest.plan.shards, manifest.plan.shards)


def _shard(folder: Path, manifest: Manifest, number: int) -> Iterator[Finding]:
    path = shard_file(folder, number)
    try:
        entry, landmarks = inspect_shard(folder, manifest.plan, number)
    except DopslamError as error:
        yield Finding(path.name, str(error))
        return
    if manifest.complete:
        if number < len(manifest.shards) and manifest.shards[number] != entry:
            yield Finding(path.name, "is whole but not the shard that the manifest lists; make it again with --resume")
        known = {mark["name"]: mark for mark in manifest.landmarks}
        for name, kind, position in zip(landmarks.name.tolist(), landmarks.kind, landmarks.position, strict=True):
            mark = known.get(name)
            if mark is None or mark["kind"] != kind or mark["position"] != position.tolist():
                yield Finding(path.name, f"landmark {name!r} is not that of the manifest")
    yield from _file(path, hashed=True)


def _file(path: Path, hashed: bool = False) -> Iterator[Finding]:
    try:
        names, attributes, shapes = dataset.groups(path), dataset.root_attributes(path), dataset.describe(path)
        kinds = {group: dataset.record_type(path, group) for group in names}
    except DopslamError as error:
        yield Finding(path.name, str(error))
        return
    for group, name, _, _, stated in shapes:
        right = unit_of(kinds[group], name)
        if stated not in ("", UNSAID, right):
            yield Finding(f"{path.name}:{group}/{name}", f"is said to be in {stated!r}; this program reads {right!r}")
    records = {}
    for group in names:
        try:
            if not hashed:
                dataset.verify_group(path, group)
            kind = TYPES.get(kinds[group])
            if kind is not None:
                records[group] = dataset.read_record(path, group, kind)
        except DopslamError as error:
            yield Finding(f"{path.name}:{group}", str(error))
    scenario = None
    if "scenario" in attributes:
        try:
            scenario = parse(str(attributes["scenario"]), source=f"{path.name}: its scenario")
        except ConfigError as error:
            yield Finding(path.name, str(error))
    try:
        for where, what in _physics(records, scenario):
            yield Finding(f"{path.name}:{where}", what)
    except (IndexError, ValueError, DopslamError) as error:
        yield Finding(path.name, f"its records do not fit one another ({error})")


def _physics(records: dict, scenario) -> Iterator[tuple[str, str]]:
    track, landmarks, paths = (records.get(name) for name in ("track", "landmarks", "paths"))
    found = misfits(records)
    yield from found
    station = None if found or scenario is None else np.array(scenario.base_station.position)
    if station is not None and track is not None and landmarks is not None and paths is not None:
        yield from _geometry(track, landmarks, paths, station) if len(paths.landmark) else ()
    for group, record in records.items():
        for name, what in plausible.faults(record):
            yield f"{group}/{name}", what


def _geometry(track: Track, landmarks: Landmarks, paths: Paths, bs: np.ndarray) -> Iterator[tuple[str, str]]:
    """Each path's delay and angles against the polyline BS → interaction points → receiver."""
    count = np.diff(paths.vertex_offsets)
    if np.any(count != landmarks.order[paths.landmark]):
        yield "paths/vertex_offsets", "does not give each path as many interaction points as its landmark has bounces"
        return
    receiver = np.repeat(track.position, np.diff(paths.offsets), axis=0)
    length, previous, last = np.zeros(len(count)), np.broadcast_to(bs, receiver.shape).copy(), np.empty_like(receiver)
    first = receiver.copy()
    for bounce in range(int(count.max(initial=0))):
        rows = np.flatnonzero(count > bounce)
        point = paths.vertices[paths.vertex_offsets[rows] + bounce]
        length[rows] += np.linalg.norm(point - previous[rows], axis=1)
        if bounce == 0:
            first[rows] = point
        previous[rows] = point
    last = previous
    length += np.linalg.norm(receiver - last, axis=1)
    wrong = np.abs(length - SPEED_OF_LIGHT * paths.tau) > LENGTH_TOLERANCE
    if np.any(wrong):
        row = int(np.argmax(wrong))
        yield "paths/tau", f"{wrong.sum()} delays are not the length along the interaction points (first: row {row})"
    for ends, zenith, azimuth, toward in (("t", paths.theta_t, paths.phi_t, first - bs), ("r", paths.theta_r, paths.phi_r, last - receiver)):  # fmt: skip
        unit = toward / np.linalg.norm(toward, axis=1, keepdims=True)
        said = np.column_stack([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)])
        wrong = np.linalg.norm(unit - said, axis=1) > 1e-6
        if np.any(wrong):
            row = int(np.argmax(wrong))
            yield (
                f"paths/theta_{ends}, phi_{ends}",
                f"{wrong.sum()} directions do not follow the path (first: row {row})",
            )
