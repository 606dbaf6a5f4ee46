"""What a format is asked for, and what it gives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from inspect import signature
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from dopslam.config.scenario import Scenario
from dopslam.datasets.parts import Part
from dopslam.errors import DatasetError
from dopslam.formats import FORMATS
from dopslam.records import DetectionSeries, Track
from estimation.plugins import blamed


@dataclass(frozen=True, slots=True)
class Opened:
    """A foreign file of detections, opened.

    Attributes
    ----------
    detections : of a scenario (its carrier and the orientation of its base station) and the true track, if it is known; in
        seconds and radians, AOAs in the receiver's frame
    period : s between snapshots, as the file's time stamps say; None where they are only counted
    doppler : whether radial velocities were measured
    snr : whether strengths were measured
    remarks : what was made of the file that its owner may not have meant
    """

    detections: Callable[[Scenario, Track | None], DetectionSeries]
    period: float | None = None
    doppler: bool = True
    snr: bool = True
    remarks: tuple[str, ...] = ()


@runtime_checkable
class Format(Protocol):
    """A format writes, reads, or both; what it does not do it need not have."""

    @property
    def writes(self) -> bool: ...
    @property
    def reads(self) -> bool: ...


@runtime_checkable
class Writer(Format, Protocol):
    """A format that writes."""

    def write(self, parts: list[Part], out: Path) -> None:
        """A dataset into a new folder."""
        ...


@runtime_checkable
class Reader(Format, Protocol):
    """A format that reads."""

    def read(self, path: Path, mapping: Path | None) -> Opened:
        """Open a file; `mapping` is one that says what its columns mean, if it was given."""
        ...


def writer(name: str, **options: Any) -> Writer:
    """The format of a name that writes, made with its options; DatasetError naming those that do, or that have an option."""
    given = {key: value for key, value in options.items() if value is not None}
    for option in given:
        if option not in signature(FORMATS[name]).parameters:
            having = [n for n, format in FORMATS.sound().items() if option in signature(format).parameters]
            raise DatasetError(f"--{option} goes with --to {' or '.join(having)} only")
    return _able(name, "writes", Writer, "written", given)  # pyright: ignore[reportAbstractUsage]


def reader(name: str) -> Reader:
    """The format of a name that reads; DatasetError naming those that do."""
    return _able(name, "reads", Reader, "read", {})  # pyright: ignore[reportAbstractUsage]


def opened(name: str, path: Path, mapping: Path | None) -> Opened:
    """A file through the format of a name that reads; DatasetError if that gives nothing of the kind."""
    chosen = reader(name)
    with blamed(chosen, f"format {name!r}: read", DatasetError):
        found = chosen.read(path, mapping)
    if not isinstance(found, Opened):
        raise DatasetError(
            f"format {name!r}: read must return dopslam.formats.contract.Opened, got {type(found).__name__}"
        )
    return found


def _able(name: str, what: str, kind: type, done: str, options: dict[str, Any]):
    with blamed(FORMATS[name], f"format {name!r} cannot be made", DatasetError):
        found = FORMATS[name](**options)
    if not (getattr(found, what, False) and isinstance(found, kind)):
        others = ", ".join(other for other, format in FORMATS.sound().items() if getattr(format, what, False))
        raise DatasetError(f"format {name!r} cannot be {done}; those that can: {others}, or 'module:Class' of your own")
    return found
