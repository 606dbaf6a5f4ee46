"""Whether a fit is fit to be added to.

Where strong paths are closer than the link resolves, the strongest peak of what a first path leaves is at none of them: a
greedy search puts a second one where two together left a peak, and weaker ones about it, and no later move finds out. So
before weaker paths are added to a fit, paths that more is left about than those would explain are taken in two, and paths
that turned out weaker than what is left to find are taken out again.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from .noise import Noise
from .pairs import nearest
from .projector import Projector
from .refine import Linearization
from .split import Fitter

OVERLAP = 0.1
"""Coherence with another path up to which a path's place and worth are its own."""


class Resolver(Fitter, Protocol):
    """What of :class:`~estimation.Nomp` mends fits."""

    @property
    def resolve(self) -> bool: ...


def early(lin: Linearization, energy: float) -> np.ndarray:
    """(P,) which paths were put in their places too early: they explain less than the strongest candidate, of ``energy``,
    would, and overlap with others. Taken out, they are found again if they are there.
    """
    return (lin.drop < energy) & (lin.overlap > OVERLAP)


def sounder(
    nomp: Resolver, data: Projector, lin: Linearization, noise: Noise, strongest: float, height: float
) -> tuple[Linearization | None, float]:
    """A fit to go on with before candidates, the ``strongest`` statistic of which is given, are added to this one, None if
    it is sound; and what the fit explained when paths were last taken out of one: ``height`` is the same of before, and each
    time it must be more, lest the search goes round.
    """
    variance = noise.variance(lin)
    pair = nearest(nomp, data, lin, noise, max(nomp.level, strongest)) if nomp.resolve else None
    if pair is not None:
        grown = nomp._eliminated(data, pair, noise)
        return (grown if nomp._better(grown, lin, noise) else None), height
    again = early(lin, strongest * variance)
    if strongest <= nomp.level or not again.any() or again.all() or lin.explained <= height + nomp.level * variance:
        return None, height
    rest = lin.geometry.take(np.flatnonzero(~again))
    return nomp._eliminated(data, nomp._fit(data, rest, noise), noise), lin.explained


def pruned(nomp: Resolver, data: Projector, lin: Linearization | None, noise: Noise) -> Linearization | None:
    """Backward elimination against re-optimized models: a component's worth at fixed frequencies is not
    enough for close pairs.
    """
    while lin is not None:
        less = None if noise.clock.over else _smaller(nomp, data, lin, noise)
        if less is None:
            return lin
        lin = nomp._eliminated(data, less, noise)
    return None


def _smaller(nomp: Resolver, data: Projector, lin: Linearization, noise: Noise) -> Linearization | None:
    """A refitted model with one component less that loses less than the threshold, if there is one."""
    variance = noise.variance(lin)
    worth = lin.drop / variance
    overlap = lin.overlap
    for index in np.argsort(worth):
        # A component without overlap keeps its worth, and a strong one with little overlap nearly so.
        if overlap[index] < OVERLAP or worth[index] * (1 - overlap[index] ** 2) > 30 * nomp.level:
            continue
        rest = np.delete(np.arange(len(worth)), index)
        without = nomp._fit(data, lin.geometry.take(rest), noise)
        if lin.explained - without.explained < nomp.level * variance:
            return without
    return None
