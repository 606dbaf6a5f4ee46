"""Radio SLAM end to end: ray-traced multipath → channel estimation → SLAM filters → bounds.

The data flow is one direction: ``trace`` → :class:`~dopslam.records.Paths`, ``synthesize`` → signal, ``estimate`` →
:class:`~dopslam.records.DetectionSeries`, ``slam`` → history, ``evaluate`` → report. The verbs stand in
:mod:`dopslam.api`; nothing heavy is imported before one is used.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import Any

__version__ = "0.1.0"

_VERBS = (
    "load", "trace", "synthesize", "estimate", "problem", "slam", "bound", "evaluate", "simulate", "world", "montecarlo",
    "locate",
)  # fmt: skip
_NAMES = dict.fromkeys(_VERBS, "api") | {
    "Scenario": "config.scenario",
    "Track": "records", "Landmarks": "records", "BaseStations": "records", "Paths": "records", "DetectionSeries": "records",
    "Kind": "records",
    "Scans": "models.scans", "CoordinatedTurn": "models.motion",
    "Problem": "slam.filter", "Filter": "slam.filter", "Capabilities": "slam.filter", "Info": "slam.filter",
    "History": "slam.history", "Estimate": "slam.history", "Diagnostics": "slam.history",
    "DopslamError": "errors",
}  # fmt: skip
_ROOMS = ("filters", "records", "errors", "formats", "config")
__all__ = [*_NAMES, *_ROOMS, "__version__"]  # pyright: ignore[reportUnsupportedDunderAll]  # the stub lists them


class _Verb(ModuleType):
    """A room that is called like the verb it serves: ``dopslam.slam`` holds the filters, ``dopslam.slam(...)`` runs one."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        return getattr(importlib.import_module("dopslam.api"), self.__name__.rpartition(".")[2])(*arguments, **options)


class _Package(ModuleType):
    def __setattr__(self, name: str, value: Any) -> None:
        if name in _VERBS and isinstance(value, ModuleType):  # the import system hands a room to its package
            value.__class__ = _Verb
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> Any:
    if name in _ROOMS or name in ("slam", "evaluate", "simulate"):
        return importlib.import_module(f"dopslam.{name}")
    if name in _NAMES:
        return getattr(importlib.import_module(f"dopslam.{_NAMES[name]}"), name)
    raise AttributeError(f"module 'dopslam' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
