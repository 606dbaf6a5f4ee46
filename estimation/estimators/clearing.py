"""What a search does about energy that is no path: noise of the ports (:mod:`~.colored`), crowds and tips of clusters
(:mod:`~.haze`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from ..signal.algebra import coherence, signal_of
from ..signal.model import SignalModel
from ..signal.paths import Geometry
from .colored import port_covariance
from .floor import Floor
from .haze import CROWD, MOST, WEAK, gathered, smoldering, swallowed
from .noise import Noise
from .projector import Bases, Projector
from .refine import Linearization, linearize
from .split import Fitter

LEAK = 0.3
"""Share of a candidate's energy that a stronger one may have put there."""


class Searcher(Fitter, Protocol):
    """What of :class:`~estimation.Nomp` is needed to clear its data."""

    @property
    def model(self) -> SignalModel: ...
    @property
    def dense_multipath(self) -> bool: ...
    @property
    def _basis(self) -> Bases: ...


def heard(model: SignalModel, white, lin: Linearization, noise: Noise) -> Noise:
    """The noise with the covariance of the ports, if what paths leave of a whitened signal is not white over them."""
    return replace(noise, ports=port_covariance(model, white - signal_of(model, lin.blocks, lin.gain)))


def cleared(
    nomp: Searcher, white, lin: Linearization | None, noise: Noise, found: Geometry, statistic
) -> tuple[Projector, Linearization | None, Noise] | None:
    """Data without what turns out to be a haze, the paths that remain and what is known of the noise; None where there is no
    new one among the paths and what is found beside them.
    """
    model, strong = nomp.model, np.flatnonzero(statistic > nomp.level)
    if lin is None or not len(strong) or len(noise.hazes) >= MOST or model.subbands > 1 or nomp.dense_multipath:
        return None
    strong = strong[_own(coherence(model, found.take(strong)), statistic[strong])]
    if not noise.hazes and len(lin.gain) + len(strong) < CROWD[0]:
        return None
    variance = noise.variance(lin)
    energy, weak = statistic[strong] * variance, WEAK * nomp.level * variance
    new, kept = gathered(model, noise.hazes, lin.geometry, lin.drop, found.take(strong), energy, weak)
    if not new:
        return None
    paths = linearize(Projector(model, white, nomp._basis), lin.geometry.take(kept)) if len(kept) else None
    signal = 0 if paths is None else signal_of(model, paths.blocks, paths.gain)
    rest, hazes = white - signal, noise.hazes + new
    for haze in hazes:
        rest = haze.lifted(model, rest)
    data = Projector(model, np.ascontiguousarray(rest + signal, np.complex64), nomp._basis)
    told = replace(noise, energy=float(np.vdot(data.signal, data.signal).real), hazes=hazes)
    return data, None if paths is None else nomp._eliminated(data, nomp._fit(data, paths.geometry, told), told), told


def _own(overlap, statistic) -> list[int]:
    """Those of candidates, strongest first, that are no side lobe of a stronger one and not the same peak."""
    kept: list[int] = []
    for candidate in range(len(statistic)):
        leak = overlap[candidate, kept] ** 2 * statistic[kept]
        if leak.max(initial=0.0) < LEAK * statistic[candidate]:
            kept.append(candidate)
    return kept


def standing_out(nomp: Searcher, data: Projector, lin: Linearization | None, noise: Noise) -> Linearization | None:
    """The paths without those that are the tips of weak clusters or do not stand out of a haze."""
    while lin is not None:
        variance = noise.variance(lin)
        gone = smoldering(Floor(data, lin, variance), lin, variance, nomp.level)
        gone |= swallowed(nomp.model, noise.hazes, lin.geometry, lin.drop)
        if not gone.any():
            return lin
        rest = np.flatnonzero(~gone)
        lin = nomp._eliminated(data, nomp._fit(data, lin.geometry.take(rest), noise), noise) if len(rest) else None
    return None
