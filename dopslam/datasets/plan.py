"""What a large dataset consists of, decided before anything is made."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from dopslam.config.drives import DatasetConfig
from dopslam.config.scenario import Scenario
from dopslam.datasets import tracks
from dopslam.errors import ConfigError, DatasetError
from dopslam.pipeline import link as radio

LARGEST_SHARDS = 100_000


@dataclass(frozen=True)
class Plan:
    """A dataset that is to be made.

    Attributes
    ----------
    name : of the scenario
    scenario : its effective TOML text
    seed : of everything random
    positions : number of positions N
    shard_positions : positions of every shard but the last
    signal, detections : whether those are stored beside track, landmarks and paths
    tracks_sha256 : of the file the tracks come from, empty if they are sampled
    """

    name: str
    scenario: str
    seed: int
    positions: int
    shard_positions: int
    signal: bool = False
    detections: bool = False
    tracks_sha256: str = ""

    @property
    def shards(self) -> int:
        """Number of shards."""
        return -(-self.positions // self.shard_positions)

    def span(self, shard: int) -> tuple[int, int]:
        """First position and number of positions of a shard."""
        first = shard * self.shard_positions
        return first, min(self.shard_positions, self.positions - first)

    def difference(self, other: Plan) -> str:
        """What differs from another plan, in words; empty if nothing does."""
        if self == other:
            return ""
        for name in ("name", "seed", "positions", "shard_positions", "signal", "detections", "tracks_sha256"):
            mine, its = getattr(self, name), getattr(other, name)
            if mine != its:
                return f"{name} is {mine!r} there and {its!r} here"
        lines = zip(self.scenario.splitlines(), other.scenario.splitlines(), strict=False)
        mine, its = next(((a, b) for a, b in lines if a != b), ("", "more lines"))
        return f"the scenario has {mine!r} there and {its!r} here"


def shard_file(folder: Path, shard: int) -> Path:
    """Where a shard lies."""
    return Path(folder) / f"shard-{shard:05d}.h5"


def make_plan(
    scenario: Scenario, positions: int | None, seed: int, signal: bool = False, detections: bool = False
) -> Plan:
    """Plan a dataset; shards are bounded by ``dataset.shard_positions`` and, with signal, ``dataset.shard_megabytes``.

    Parameters
    ----------
    positions : number of positions; None: the whole track file, or one drive of sampled tracks

    Raises
    ------
    ConfigError
        For a number of positions that is not positive or more than a track file holds, or a bad track file.
    """
    source = tracks.sampled(scenario, seed)
    count = positions if positions is not None else int(source.lengths.sum())
    if count < 1:
        raise ConfigError(f"--positions {count}: give at least 1")
    if source.limit is not None and count > source.limit:
        raise ConfigError(
            f"--positions {count}: the track file holds {source.limit}; give at most that or leave it out"
        )
    if seed < 0:
        raise ConfigError(f"--seed {seed}: give a whole number from 0")
    config = scenario.dataset or DatasetConfig()
    most = config.shard_positions
    if signal:
        model = radio.signal_model(scenario)
        snapshot = scenario.radio.subcarriers * model.schedule.symbols * model.receiver.elements * 8
        most = max(1, min(most, int(config.shard_megabytes * 1e6 // snapshot)))
    if -(-count // most) > LARGEST_SHARDS:
        raise ConfigError(
            f"--positions {count}: {-(-count // most)} shards of {most} positions, at most {LARGEST_SHARDS} are possible; "
            "ask for fewer, or raise dataset.shard_positions (with --signal dataset.shard_megabytes)"
        )
    file = tracks.track_file(scenario)
    try:
        digest = hashlib.sha256(file.read_bytes()).hexdigest() if file is not None else ""
    except OSError as error:
        raise DatasetError(f"{file}: cannot be read ({error.strerror})") from error
    return Plan(scenario.name, scenario.to_toml(), seed, count, min(most, count), signal, detections, digest)
