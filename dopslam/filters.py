"""The filters by name, and by class: ``dopslam.filters.Joint(iterations=1)``; and the motion models that they are told by name.
Nothing is imported before it is used.

A package installed beside adds its own by an entry point of the group ``dopslam.filters`` or ``dopslam.motions``.
"""

from __future__ import annotations

from typing import Any

from dopslam.errors import ConfigError
from estimation.plugins import Table

_OWN = {
    "joint": "dopslam.slam.pmb.filters:Joint",
    "marginal": "dopslam.slam.pmb.filters:Marginal",
    "smoother": "dopslam.slam.pmb.filters:Smoother",
    "lagged": "dopslam.slam.pmb.filters:Lagged",
    "mixture": "dopslam.slam.pmb.filters:Mixture",
    "bp": "dopslam.slam.belief.filter:Belief",
    "batch": "dopslam.slam.batch.filter:Batch",
    "interval": "dopslam.slam.batch.interval:Interval",
}
FILTERS = Table("filter", "dopslam.filters", _OWN, ConfigError)
"""The only place where the names of filters are spelled."""

MOTIONS = Table(
    "motion model",
    "dopslam.motions",
    {
        "known": "dopslam.models.motion:known",
        "unknown": "dopslam.models.motion:unknown",
        "walk": "dopslam.models.motion:walk",
    },
    ConfigError,
)
"""The only place where the names of motion models are spelled (:mod:`dopslam.models.motion`)."""

_CLASSES = {where.partition(":")[2]: name for name, where in _OWN.items()}


def __getattr__(name: str) -> Any:
    if name in _CLASSES:
        return FILTERS[_CLASSES[name]]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}; filters are {', '.join(_CLASSES)}")


def __dir__() -> list[str]:
    return ["FILTERS", *_CLASSES]
