"""Tracks for large datasets: drives sampled from lines, circles, a polygon or the motion model, or read from a file.

Every drive depends on the seed and its own number only, so that any part of a dataset can be made alone. Positions in
the world
frame [m], headings [rad], speeds [m/s]; the clock bias walks as in eq. (1) of paper A.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dopslam.config.drives import CircleTracks, DatasetConfig, DriveTracks, FileTracks, LineTracks
from dopslam.config.scenario import Scenario
from dopslam.config.trackfile import STANDING, course_held, read_rows, rising
from dopslam.datasets.polygon import clearance
from dopslam.errors import ConfigError
from dopslam.models.measurement import wrap
from dopslam.pipeline import stages as pipeline
from dopslam.pipeline.stages import Component
from dopslam.records import Track

TRIES = 20_000  # random starts before a polygon counts as too narrow
TURNS = np.linspace(-1, 1, 41)  # turn rates that a drive chooses from, over the largest


@dataclass(frozen=True)
class Steps:
    """Which drive and step each position of a shard belongs to.

    Attributes
    ----------
    index : (K,) number of the position in the whole dataset
    drive : (K,) number of the drive
    step : (K,) step within the drive
    start : (K, 4) [x m, y m, heading rad, bias m], mean of what the receiver knows one period before its drive's first step
    """

    index: np.ndarray
    drive: np.ndarray
    step: np.ndarray
    start: np.ndarray


@dataclass(frozen=True)
class Tracks:
    """The positions of a whole dataset, made in any order and only where asked for.

    Attributes
    ----------
    scenario : its ``[dataset]``, ``[track]`` and receiver height are used
    seed : of everything drawn
    lengths : steps of every drive, or of all drives alike
    rows : content of a track file, or None
    """

    scenario: Scenario
    seed: int
    lengths: np.ndarray
    rows: dict[str, np.ndarray] | None = None
    ids: np.ndarray | None = None

    @property
    def limit(self) -> int | None:
        """Number of positions there are, None if there is no end."""
        return int(self.lengths.sum()) if self.rows is not None else None

    def part(self, first: int, count: int) -> tuple[Track, Steps]:
        """Positions ``first`` to ``first + count - 1`` of the dataset."""
        if self.rows is None:
            length = int(self.lengths[0])
            drives = range(first // length, (first + count - 1) // length + 1)
            begin = np.array([d * length for d in drives])
        else:
            edges = np.concatenate([[0], np.cumsum(self.lengths)])
            last = first + count - 1
            drives = range(*(int(np.searchsorted(edges, v, "right")) + e for v, e in ((first, -1), (last, 0))))
            begin = edges[:-1][drives.start : drives.stop]
        made = [self.drive(d) for d in drives]
        lengths = [track.steps for track in made]
        chosen = slice(first - int(begin[0]), first - int(begin[0]) + count)
        columns = {
            name: np.concatenate([getattr(track, name) for track in made])[chosen]
            for name in ("time", "position", "heading", "velocity", "bias")
        }
        start = np.repeat([track.start for track in made], lengths, axis=0)[chosen]
        numbers = np.array(drives) if self.ids is None else self.ids[drives.start : drives.stop]
        steps = Steps(
            index=np.arange(first, first + count),
            drive=np.repeat(numbers, lengths)[chosen],
            step=np.concatenate([np.arange(n) for n in lengths])[chosen],
            start=start,
        )
        return Track(**columns, start=start[0]), steps

    def drive(self, number: int) -> Track:
        """One whole drive."""
        config = _config(self.scenario).tracks
        if self.rows is not None:
            return self._from_file(number)
        rng = pipeline.generator(self.seed, Component.TRACK, number)
        steps = int(self.lengths[0])
        match config:
            case LineTracks():
                state, speed = _line(config, self.scenario, steps, rng)
            case CircleTracks():
                state, speed = _circle(config, self.scenario, steps, rng)
            case DriveTracks():
                state, speed = _drive(config, self.scenario, steps, rng)
            case _:
                return self._motion(steps, rng)
        return self._track(state[1:], np.full(steps, speed), _bias(self.scenario, steps, rng), state[0])

    def _motion(self, steps: int, rng: np.random.Generator) -> Track:
        state = pipeline.drawn_states(self.scenario, rng, steps)
        speed = np.full(steps, self.scenario.track.speed)
        return self._track(state[:, :3], speed, state[:, 3], np.array(self.scenario.track.start[:3]))

    def _track(self, state: np.ndarray, speed: np.ndarray, bias: np.ndarray, start: np.ndarray) -> Track:
        heading = state[:, 2]
        return Track(
            time=self.scenario.track.period * np.arange(1, len(state) + 1),
            position=np.column_stack([state[:, :2], np.full(len(state), self.scenario.receiver.height)]),
            heading=heading,
            velocity=speed[:, None] * np.column_stack([np.cos(heading), np.sin(heading), np.zeros(len(state))]),
            bias=bias,
            start=np.array([*start[:3], self.scenario.track.start[3]]),
        )

    def _from_file(self, number: int) -> Track:
        assert self.rows is not None
        edges = np.concatenate([[0], np.cumsum(self.lengths)])
        row = {name: column[edges[number] : edges[number + 1]] for name, column in self.rows.items()}
        bias = row.get("bias", np.full(len(row["time"]), self.scenario.track.start[3]))
        position = np.column_stack([row["x"], row["y"], row["z"]])
        velocity = np.column_stack([row["vx"], row["vy"], row["vz"]])
        # One step before the first: driven back by its own velocity and turn.
        lead = float(row["time"][1] - row["time"][0]) if len(bias) > 1 else self.scenario.track.period
        turned = float(wrap(row["heading"][1] - row["heading"][0])) if len(bias) > 1 else 0.0
        before = position[0, :2] - lead * velocity[0, :2]
        return Track(
            time=row["time"],
            position=position,
            heading=row["heading"],
            velocity=velocity,
            bias=bias,
            start=np.array([*before, wrap(row["heading"][0] - turned), bias[0]]),
        )


def _config(scenario: Scenario) -> DatasetConfig:
    return scenario.dataset or DatasetConfig()


def sampled(scenario: Scenario, seed: int) -> Tracks:
    """The tracks that a scenario's ``[dataset]`` describes.

    Raises
    ------
    ConfigError
        For a track file that is missing or malformed; sampling raises it for a polygon that is too narrow to turn in.
    """
    config = _config(scenario)
    if isinstance(config.tracks, FileTracks):
        return Tracks(scenario, seed, *_read(scenario, config.tracks))
    return Tracks(scenario, seed, np.array([config.steps or scenario.track.steps]))


def _bias(scenario: Scenario, steps: int, rng: np.random.Generator) -> np.ndarray:
    track = scenario.track
    walk = np.cumsum(rng.normal(size=steps) * track.process_std[3])
    return track.start[3] + track.start_std[3] * rng.normal() + walk


def _line(config: LineTracks, scenario: Scenario, steps: int, rng) -> tuple[np.ndarray, float]:
    a, b = map(np.array, config.ends)
    length, speed = float(np.hypot(*(b - a))), scenario.track.speed
    if not length:
        raise ConfigError(f"dataset.tracks.ends = {config.ends}: the two ends are the same place; give two")
    along = rng.uniform(0, 2 * length) + speed * scenario.track.period * np.arange(steps + 1)
    folded = along % (2 * length)
    back = folded >= length
    place = np.where(back, 2 * length - folded, folded)[:, None] / length
    azimuth = float(np.arctan2(*(b - a)[::-1]))
    return np.column_stack([a + place * (b - a), np.where(back, wrap(azimuth + np.pi), azimuth)]), speed


def _circle(config: CircleTracks, scenario: Scenario, steps: int, rng) -> tuple[np.ndarray, float]:
    speed, sense = scenario.track.speed, rng.choice([-1.0, 1.0])
    angle = rng.uniform(-np.pi, np.pi) + sense * speed / config.radius * scenario.track.period * np.arange(steps + 1)
    place = np.array(config.center) + config.radius * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.column_stack([place, wrap(angle + sense * np.pi / 2)]), speed


def _drive(config: DriveTracks, scenario: Scenario, steps: int, rng) -> tuple[np.ndarray, float]:
    """States (steps + 1, 3) of arcs whose turn rate walks; a full circle to the left or right always stays possible."""
    polygon = np.array(config.polygon)
    least, largest = config.speed or (scenario.track.speed, scenario.track.speed)
    speed, period = float(rng.uniform(min(least, largest), max(least, largest))), scenario.track.period
    radius = speed / config.turn_rate
    state = _free_start(config, polygon, radius, rng)
    states, rate = [state], 0.0
    rates = config.turn_rate * TURNS
    for _ in range(steps):
        rate += config.restlessness * np.sqrt(period) * rng.normal()
        rate = float(np.clip(rate, -config.turn_rate, config.turn_rate))
        # The wish first, then the others by distance from it; the safe circle's own rate is among them.
        wished = np.concatenate([[rate], rates[np.argsort(np.abs(rates - rate), kind="stable")]])
        ends = arc(state, speed, wished, period)
        along = np.concatenate([arc(state, speed, wished, part * period)[:, :2] for part in (0.25, 0.5, 0.75, 1.0)])
        inside = (clearance(polygon, along) > 0).reshape(4, -1).all(axis=0)
        good = np.flatnonzero(inside & _can_turn(polygon, ends, radius))
        if len(good):
            rate, state = float(wished[good[0]]), ends[good[0]]
        else:  # by rounding only: go on around the circle that is free
            sides = _circles(state[None], radius)[0]
            left = clearance(polygon, sides)[0] >= clearance(polygon, sides)[1]
            rate = config.turn_rate if left else -config.turn_rate
            state = arc(state, speed, np.array([rate]), period)[0]
        states.append(state)
    return np.array(states), speed


def _free_start(config: DriveTracks, polygon: np.ndarray, radius: float, rng) -> np.ndarray:
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    for _ in range(TRIES // 100):
        trial = np.column_stack([rng.uniform(low, high, (100, 2)), rng.uniform(-np.pi, np.pi, 100)])
        free = np.flatnonzero((clearance(polygon, trial[:, :2]) > 0) & _can_turn(polygon, trial, radius))
        if len(free):
            return trial[free[0]]
    raise ConfigError(
        f"dataset.tracks.polygon: no place to turn in with a radius of {radius:.1f} m (speed over turn rate); widen the "
        f"polygon, lower dataset.tracks.speed or raise dataset.tracks.turn_rate = {config.turn_rate:g}"
    )


def _circles(states: np.ndarray, radius: float) -> np.ndarray:
    """Centers (·, 2, 2) of the tightest circles to the left and right."""
    across = np.column_stack([-np.sin(states[:, 2]), np.cos(states[:, 2])])
    return states[:, None, :2] + radius * np.stack([across, -across], axis=1)


def _can_turn(polygon: np.ndarray, states: np.ndarray, radius: float) -> np.ndarray:
    room = clearance(polygon, _circles(states, radius).reshape(-1, 2)).reshape(-1, 2)
    return room.max(axis=1) > radius * (1 - 1e-9)


def arc(state: np.ndarray, speed: float, rate: np.ndarray, time: float) -> np.ndarray:
    """States [x, y, heading] after driving arcs of constant turn rate (rates of shape (R,)) for a time."""
    turned = rate * time
    chord = speed * time * np.sinc(turned / (2 * np.pi))
    course = state[2] + turned / 2
    return np.column_stack(
        [state[0] + chord * np.cos(course), state[1] + chord * np.sin(course), wrap(state[2] + turned)]
    )


def track_file(scenario: Scenario) -> Path | None:
    """The file with tracks of one's own, if the scenario names one."""
    config = _config(scenario).tracks
    if not isinstance(config, FileTracks):
        return None
    path = Path(config.file)
    return path if path.is_absolute() or scenario._folder is None else scenario._folder / path


def _read(scenario: Scenario, config: FileTracks) -> tuple[np.ndarray, dict[str, np.ndarray], np.ndarray]:
    path = track_file(scenario)
    assert path is not None
    rows = read_rows(path, "dataset.tracks.file")
    count = len(rows["time"])
    drive = rows.pop("drive", np.zeros(count))
    edges = np.flatnonzero(np.diff(drive)) + 1
    ids = drive[np.concatenate([[0], edges])]
    if len(np.unique(ids)) < len(ids) or np.any(ids != np.round(ids)) or np.any(ids < 0) or np.any(ids > 1e9):
        raise ConfigError(f"{path}: drives are whole numbers from 0, the rows of each together; got {ids.tolist()[:6]}")
    for part in np.split(rows["time"], edges):
        rising(path, part)
    return np.diff(np.array([0, *edges.tolist(), count])), _completed(rows, edges, scenario), ids.astype(np.int64)


def _completed(rows: dict[str, np.ndarray], edges: np.ndarray, scenario: Scenario) -> dict[str, np.ndarray]:
    """Height, velocity and heading where the file leaves them out: central differences within each drive."""
    rows = {"z": np.full(len(rows["time"]), scenario.receiver.height)} | rows
    for axis in "xyz":
        if f"v{axis}" not in rows:
            parts = zip(np.split(rows[axis], edges), np.split(rows["time"], edges), strict=True)
            rows[f"v{axis}"] = np.concatenate([_rate(place, time) for place, time in parts])
    if "heading" not in rows:
        course = np.arctan2(rows["vy"], rows["vx"])
        moving = np.hypot(rows["vx"], rows["vy"]) > STANDING
        rows["heading"] = np.concatenate(
            [course_held(*part) for part in zip(np.split(course, edges), np.split(moving, edges), strict=True)]
        )
    return rows


def _rate(place: np.ndarray, time: np.ndarray) -> np.ndarray:
    return np.gradient(place, time) if len(time) > 1 else np.zeros(1)
