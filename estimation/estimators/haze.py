"""Energy that is no path: clusters of echoes too many and too close to be told apart.

Greedy fits would explain such a cluster by path after path, each about as strong as the next, and none of them there. What
gives it away is the crowd: several paths and candidates within a few delay bins that the other modes of the link do not tell
apart, of like energies. A crowd becomes a :class:`Haze`, the subspace that its members and their surroundings span; its
energy is taken out of the data, and what is found within must stand out of the mean of its members. So must the covariance
of a path in it allow for that much noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.stats import chi2

from ..signal.arrays import Complex
from ..signal.directions import Float
from ..signal.model import SignalModel, flat
from ..signal.paths import Geometry
from .floor import Floor, squared_coherences
from .refine import Linearization

NEAR = 6.0
"""Delay bins between neighbors of a crowd."""
ALIKE = 0.1
"""Squared coherence, over all modes but delay, from which on two are neighbors."""
CROWD = (4, 6)
"""Neighbors of the same directions and speed that make a crowd, one of them new at least: among weak ones, and among others.
Reflections of a room or corridor have up to five; a fit that explains all has none that is new."""
SAME = 0.7
"""Likewise what the core of a crowd has: a link cannot tell its members apart but by delay."""
LIKE = 10.0
"""Ratio of energies up to which two are alike; those of reflections fall from one to the next."""
STANDS_OUT = 16.0
"""Multiple of the mean energy of the weaker ones from which on a member is a path. Energies of a cluster's cells are
exponentially distributed about a profile, whose first bins are several times the mean."""
SKIRT = 3.0
"""The same of what may be left beside a haze: it fades with the coherence (not squared) and over :data:`NEAR` bins of delay."""
MARGIN = 2.0
"""Delay bins about its members that a haze takes up."""
WEAK = 20.0
"""Multiple of the threshold up to which a path is weak, and asked whether it smolders."""
BESIDE = (1.5, 7.5)
"""Delay bins either side of a path where a cluster shows; closer are what a merged pair leaves, and the path itself."""
FEWEST = 24
"""Pilots of a link that can tell."""
RATE = 1e-4
"""Probability that noise alone smolders."""
KEPT = 0.03
"""Singular values of a mode's vectors, relative to the largest, that a haze takes up."""
MOST = 60
"""Hazes of a burst."""


@dataclass(frozen=True, eq=False)
class Haze:
    """A cluster: its ``members``, their mean energy, and orthonormal bases (n, r) of what it takes up of each mode."""

    members: Geometry
    level: float
    bases: tuple[Complex, ...]

    @staticmethod
    def of(model: SignalModel, members: Geometry, level: float) -> Haze:
        """The haze of a crowd."""
        bin_width = 1 / model.waveform.bandwidth
        first, last = members.delay.min() - MARGIN * bin_width, members.delay.max() + MARGIN * bin_width
        delays = np.arange(first, last + bin_width / 2, bin_width / 2)
        vectors = [np.exp(-2j * np.pi * np.outer(delays, model.waveform.frequencies))]
        for mode in model.bands[0].modes[1:]:
            block = mode.evaluate(members).reshape(-1, mode.size)
            vectors.append(block / np.maximum(np.linalg.norm(block, axis=1, keepdims=True), 1e-300))
        return Haze(members, level, tuple(_basis(v) for v in vectors))

    def lifted(self, model: SignalModel, rest: Complex) -> Complex:
        """What is left of a residual (model.shape) without what lies in the haze."""
        core = flat(rest, model.bands[0])
        for axis, basis in enumerate(self.bases):
            core = np.moveaxis(np.tensordot(basis.conj().T.astype(np.complex64), core, axes=(1, axis)), 0, axis)
        for axis, basis in enumerate(self.bases):
            core = np.moveaxis(np.tensordot(basis.astype(np.complex64), core, axes=(1, axis)), 0, axis)
        return rest - core.reshape(rest.shape)


def _basis(vectors: Complex) -> Complex:
    left, values, _ = np.linalg.svd(vectors.T, full_matrices=False)
    return left[:, values > KEPT * values[0]]


def apart(model: SignalModel, first: Geometry, second: Geometry) -> tuple[Float, Float]:
    """Squared coherences (C, P) over all modes but delay, and distances (C, P) in delay bins."""
    alike = np.ones((len(first), len(second)))
    for mode in model.bands[0].modes[1:]:
        alike *= squared_coherences(mode.vector(first), mode.vector(second))
    gap = np.abs(first.delay[:, None] - second.delay)
    period = model.max_delay
    gap = np.minimum(gap, np.abs(period - gap)) if period else gap
    return alike, gap * model.waveform.bandwidth


def likeness(model: SignalModel, first: Geometry, second: Geometry) -> Float:
    """Squared coherences (C, P) over all modes but delay, 0 between delays that are not near."""
    alike, gap = apart(model, first, second)
    return alike * (gap < NEAR)


def swallowed(model: SignalModel, hazes: tuple[Haze, ...], paths: Geometry, strength: Float) -> np.ndarray:
    """(P,) which paths, of energies ``strength``, do not stand out of the hazes that they are in or beside."""
    lost = np.zeros(len(strength), bool)
    for haze in hazes:
        alike, gap = apart(model, paths, haze.members)
        inside = np.any((alike > ALIKE) & (gap < NEAR), axis=1)
        skirt = np.max(np.sqrt(alike) * np.exp(-gap / NEAR), axis=1)
        lost |= strength < haze.level * np.where(inside, STANDS_OUT, SKIRT * skirt)
    return lost


def gathered(
    model: SignalModel,
    hazes: tuple[Haze, ...],
    known: Geometry,
    worth: Float,
    found: Geometry,
    energy: Float,
    weak: float,
) -> tuple[tuple[Haze, ...], np.ndarray]:
    """New hazes among known paths and what is found beside them, and which of the known paths (P,) remain.

    Parameters
    ----------
    hazes : those there are
    known, worth : paths and their energies (P,)
    found, energy : candidates above the threshold and their energies (C,)
    weak : energy below which one is weak
    """
    everyone, strength = known.joined(found), np.concatenate([worth, energy])
    count = len(known)
    lost = swallowed(model, hazes, everyone, strength)
    near = likeness(model, everyone, everyone)
    label = connected_components(near > ALIKE, directed=False)[1]
    core = (near > SAME) & (strength < LIKE * strength[:, None]) & (strength[:, None] < LIKE * strength)
    core = (core.sum(axis=1) >= np.where(strength < weak, *CROWD)) & core[:, count:].any(axis=1)
    for crowd in np.unique(label[core]):
        own = np.flatnonzero(np.any(near[core & (label == crowd)] > ALIKE, axis=0))
        lost[own[_crowded(strength[own])]] = True
    new = []
    for crowd in np.unique(label[lost]):
        own = np.flatnonzero(lost & (label == crowd))
        new.append(Haze.of(model, everyone.take(own), float(strength[own].mean())))
    return tuple(new), np.flatnonzero(~lost[:count])


def _crowded(strength: Float) -> np.ndarray:
    """Those of energies (n,) that are one crowd: from the weakest up, until one stands out of the mean of those before."""
    order = np.argsort(strength)
    mean = np.cumsum(strength[order]) / np.arange(1, len(order) + 1)
    out = np.flatnonzero(strength[order][2:] > STANDS_OUT * mean[1:-1])
    return order[: 2 + out[0]] if len(out) else order


def smoldering(floor: Floor, lin: Linearization, variance: float, level: float) -> np.ndarray:
    """(P,) which of the known paths are the few of a weak cluster that exceed the threshold.

    Beside them, in delay, the fit leaves more than noise, and they do not stand out of its mean and their neighbors'.
    """
    model, worth = floor.data.model, lin.drop / variance
    gone = np.zeros(len(worth), bool)
    weak = np.flatnonzero(worth < WEAK * level)
    if not len(weak) or model.subbands > 1 or model.weight is not None or model.waveform.subcarriers < FEWEST:
        return gone
    near = likeness(model, lin.geometry, lin.geometry) - np.eye(len(worth))
    width = 1 / model.waveform.bandwidth
    offsets = np.arange(BESIDE[0], BESIDE[1] + 0.1) * width
    offsets = np.concatenate([-offsets, offsets])
    for path in weak:
        delays = lin.geometry.delay[path] + offsets
        basis = _basis(np.exp(-2j * np.pi * np.outer(delays, model.waveform.frequencies)))
        fiber = floor.along(lin.geometry.take([path]), 0, int(path))
        left = float(np.linalg.norm(basis.conj().T @ fiber) ** 2) / variance
        cells = basis.shape[1]
        if 2 * left > chi2.isf(RATE, 2 * cells):
            mean = (left + near[path] @ worth) / (cells + near[path].sum())
            gone[path] = worth[path] < STANDS_OUT * mean
    return gone


def raised(model: SignalModel, hazes: tuple[Haze, ...], paths: Geometry, variance: float) -> Float:
    """(P,) noise about paths over the noise of a sample, at least 1."""
    total = np.ones(len(paths))
    for haze in hazes:
        total += likeness(model, paths, haze.members).max(axis=1, initial=0.0) * haze.level / variance
    return total
