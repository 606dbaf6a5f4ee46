"""Which candidates of a pass become paths."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ..signal.algebra import coherence
from ..signal.model import SignalModel
from ..signal.paths import Geometry
from .search import distinct

FREE = 0.15
"""Coherence with known paths up to which a candidate is taken beside a stronger one: the fit of that may move what is left."""


class Chooser(Protocol):
    """What of :class:`~estimation.Nomp` decides."""

    @property
    def model(self) -> SignalModel: ...
    @property
    def level(self) -> float: ...
    @property
    def dynamic_range(self) -> float: ...


def accepted_of(nomp: Chooser, found: Geometry, statistic, known: Geometry | None = None) -> tuple[Geometry, bool]:
    """Candidates to take beside ``known`` paths, and whether others may hide behind them (then one more pass is worth its
    time).
    """
    if not len(statistic):
        return found, False
    least = max(nomp.level, statistic[0] * 10 ** (-nomp.dynamic_range / 10))
    strong = np.flatnonzero(statistic > least)
    if not len(strong):
        return found.take(strong), False
    overlap = coherence(nomp.model, found)
    taken = strong[distinct(overlap[np.ix_(strong, strong)], statistic[strong], len(strong), limit=0.25)]
    if known is not None and len(taken) > 1:
        met = coherence(nomp.model, found.take(taken).joined(known))[: len(taken), len(taken) :].max(axis=1)
        taken = taken[(met < FREE) | (np.arange(len(taken)) == 0)]
    # Another peak may rise above the threshold once a path it overlaps with is gone; coherence
    # near one is the same peak.
    leak = np.where(overlap[:, taken] < 0.8, overlap[:, taken] ** 2 * statistic[taken], -np.inf).min(axis=1)
    leak[taken] = -np.inf
    # A strong path keeps weak ones off the list of candidates altogether.
    crowded = statistic[0] > 10 * nomp.level or statistic[-1] > nomp.level
    return found.take(taken), bool(crowded or np.any(statistic + leak > nomp.level))
