"""Single drives of a large dataset, each as a dataset file that ``estimate``, ``slam``, ``bound`` and ``evaluate`` take.

What the filters are told about a drive comes from the scenario, from what the dataset says the receiver knows at its
start, and from its odometry: its number of steps and its speed. The turn rate of random drives walks between the limits
that ``[dataset.tracks]`` states; the filter is told its middle and a process noise that covers those limits.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from dopslam.config.drives import CircleTracks, DatasetConfig, DriveTracks, FileTracks, LineTracks
from dopslam.config.scenario import Scenario, override
from dopslam.datasets.parts import Part, scenario_of
from dopslam.errors import DatasetError
from dopslam.models.measurement import wrap
from dopslam.models.motion import CoordinatedTurn, paced, propagate
from dopslam.pipeline.problem import base_stations
from dopslam.raytracing.traced import Traced, join
from dopslam.records import DetectionSeries, Kind, Landmarks, Paths, Track
from dopslam.store import file as dataset


def drives_of(parts: Sequence[Part]) -> dict[int, list[tuple[Part, int, int]]]:
    """Of every drive the parts that hold it, each with the first and last (exclusive) of its positions there."""
    found: dict[int, list[tuple[Part, int, int]]] = {}
    for part in parts:
        drive = part.steps.drive
        edges = [0, *(np.flatnonzero(np.diff(drive)) + 1).tolist(), len(drive)]
        for first, last in itertools.pairwise(edges):
            if last > first:
                found.setdefault(int(drive[first]), []).append((part, first, last))
    return found


def write_drive(parts: Sequence[Part], number: int, path: Path) -> None:
    """Write one drive of a dataset as a dataset file of its own.

    Raises
    ------
    DatasetError
        When there is no such drive, or the file cannot be written.
    """
    drives = drives_of(parts)
    if number not in drives:
        raise DatasetError(f"{parts[0].path}: there is no drive {number}; there are {_listed(drives)}")
    _write(parts, drives[number], number, path)


def write_drives(parts: Sequence[Part], folder: Path) -> None:
    """Write every drive of a dataset into ``drive-00000.h5`` …"""
    for number, places in drives_of(parts).items():
        _write(parts, places, number, folder / f"drive-{number:05d}.h5")


def _write(parts: Sequence[Part], places: list[tuple[Part, int, int]], number: int, path: Path) -> None:
    track = _track(places)
    landmarks, paths = _paths(places)
    scenario = told(scenario_of(parts), track)
    records: dict = {
        "base_stations": base_stations(scenario), "track": track, "landmarks": landmarks, "paths": paths,
    }  # fmt: skip
    have = places[0][0].groups
    if "detections" in have:
        cut = [part.read("detections", DetectionSeries).take(slice(*span)) for part, *span in places]
        records["detections"] = replace(DetectionSeries.join(cut), time=track.time)
    _, seed = dataset.read_root(parts[0].path)
    own_seed = int(np.random.SeedSequence(seed, spawn_key=(number,)).generate_state(1)[0])
    dataset.write_records(path, records, scenario.to_toml(), own_seed, {"drive": number, "dataset_seed": seed})
    if "signal" in have:
        dataset.write_signal(path, _snapshots(places), track.steps)


def told(scenario: Scenario, track: Track) -> Scenario:
    """The scenario as the filter of one drive is told it; see the module's text."""
    config, period = (scenario.dataset or DatasetConfig()).tracks, scenario.track.period
    speed = float(np.linalg.norm(track.velocity, axis=1).mean())
    settings = {"steps": track.steps, "start": [float(v) for v in track.start]}
    x, y, _, bias = scenario.track.process_std
    if config.kind != "motion":
        settings["speed"] = speed
    if isinstance(config, FileTracks):
        settings |= _of_a_file(track, scenario, speed)
    elif isinstance(config, LineTracks):
        settings["turn_rate"] = 0.0
    elif isinstance(config, CircleTracks):
        middle = np.array(config.center) - track.start[:2]
        left = np.cos(track.start[2]) * middle[1] - np.sin(track.start[2]) * middle[0] > 0
        settings["turn_rate"] = (1.0 if left else -1.0) * speed / config.radius
    elif isinstance(config, DriveTracks):
        turn = config.turn_rate * period / np.sqrt(3)  # standard deviation of a turn anywhere within the limits
        aside = speed * period * turn / 2
        settings["turn_rate"] = 0.0
        settings["process_std"] = [float(np.hypot(x, aside)), float(np.hypot(y, aside)), float(turn), bias]
    return override(scenario, [f"track.{name}={value!r}" for name, value in settings.items()])


def _of_a_file(track: Track, scenario: Scenario, speed: float) -> dict:
    """Period, mean turn rate and process noise that fit a drive from a file.

    The filters' motion model is a coordinated turn of known speed and turn rate, with noise; a drive of one's own is told
    as the turn nearest to it, with noise as large as its departures (never less than the scenario's). Its time stamps
    decide: the period is their median difference, and the filters step by the stamps of the detections.
    """
    gaps = np.diff(track.time)
    if not len(gaps):
        return {}
    period = float(np.median(gaps))
    if np.ptp(gaps) < 0.02 * period:
        period = float(np.mean(gaps))
    pace, turned = gaps / period, wrap(np.diff(track.heading))
    rate = float(np.sum(turned) / np.sum(gaps))
    model = CoordinatedTurn(period, np.eye(4), speed, rate)
    predicted = np.array([propagate(s, paced(model, float(p))) for s, p in zip(track.state[:-1], pace, strict=True)])
    off = np.sqrt(np.mean((track.position[1:, :2] - predicted[:, :2]) ** 2 / pace[:, None], axis=0))
    turns = float(np.sqrt(np.mean((turned - rate * gaps) ** 2 / pace)))
    x, y, heading, bias = np.array(scenario.track.process_std) * np.sqrt(period / scenario.track.period)
    noise = (max(x, off[0]), max(y, off[1]), max(heading, turns), bias)
    return {"period": period, "turn_rate": rate, "process_std": [float(v) for v in noise]}


def _track(places: list[tuple[Part, int, int]]) -> Track:
    cut = [(part.track, part.steps, slice(first, last)) for part, first, last in places]
    names = ("time", "position", "heading", "velocity", "bias")
    columns = {name: np.concatenate([getattr(track, name)[rows] for track, _, rows in cut]) for name in names}
    return Track(**columns, start=cut[0][1].start[places[0][1]])


def _paths(places: list[tuple[Part, int, int]]) -> tuple[Landmarks, Paths]:
    """Landmarks that a path of this drive leads over, and all scatter points, as when it is traced alone."""
    chunks = []
    for part, first, last in places:
        landmarks, paths = part.landmarks, part.paths.take(slice(first, last))
        seen = (landmarks.kind != Kind.VA) | np.isin(np.arange(len(landmarks)), paths.landmark)
        kept = Landmarks(**{f.name: getattr(landmarks, f.name)[seen] for f in fields(Landmarks)})
        paths = replace(paths, landmark=(np.cumsum(seen) - 1)[paths.landmark])
        chunks.append(Traced(kept, paths, np.zeros((len(paths.landmark), 2, 2))))
    joined = join(chunks)
    return joined.landmarks, joined.paths


def _snapshots(places: list[tuple[Part, int, int]]) -> Iterator[np.ndarray]:
    for part, first, last in places:
        for step in range(first, last):
            yield dataset.read_snapshot(part.path, step)


def _listed(numbers: Iterable[int]) -> str:
    """Numbers in words, runs of them as first to last: "1, 4 to 7, 9"."""
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and number == runs[-1][-1] + 1:
            runs[-1][1:] = [number]
        else:
            runs.append([number])
    said = [str(run[0]) if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs]
    return ", ".join(said[:8]) + (", …" if len(said) > 8 else "")
