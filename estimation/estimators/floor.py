"""The floor of a model's errors near strong paths, measured on each burst.

An element that is off, a gain that drifted, a phase that wanders from symbol to symbol: each leaves of a strong path what
looks like it in all modes but one, and is spread over that one. So the data are contracted with the strong path's own
vectors in the other modes. What is left of this fiber once the known paths and a candidate are taken out is noise if the
model is right, and more if it is not; a candidate must stand out of *that*, not of the noise alone. A true path is one
vector in the fiber and leaves nothing behind.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.stats import chi2

from ..signal.directions import Float
from ..signal.model import flat
from ..signal.modes import TimeMode
from ..signal.paths import Geometry
from .parts import Part, parts_of
from .projector import Projector
from .refine import Linearization

LARGEST = 10**-1.5
"""What holds more than this share of a path's energy is not an error of its model."""
CANDIDATE = -1
"""Number of a path that is not known (yet), where several of its fibers are wanted."""
RATE = 1e-3
"""Probability that noise alone makes a mode look wrong."""
FITTED = 3
"""Dimensions of a fiber that fits have taken out: the strong path itself, and a candidate with its place."""
PAIR = 4
"""The same of two close paths: both, and a place for each."""


@dataclass(eq=False)
class Floor:
    """Errors about known paths of a burst; fibers are computed when asked for, and kept.

    Attributes
    ----------
    data, known : the burst and its fit
    variance : of the noise
    share : of a path's energy that its model's error is taken to have in each mode, whatever the data say
    """

    data: Projector
    known: Linearization | None
    variance: float
    share: float = 0.0
    _fibers: dict[tuple[int, int], Float] = field(default_factory=dict, repr=False)
    _heads: dict[int, np.ndarray] = field(default_factory=dict, repr=False)

    def over(self, candidates: Geometry, statistic: Float) -> Float:
        """(C,) by how much the noise about candidates of that statistic is raised, at least 1."""
        model, known = self.data.model, self.known
        raised = np.ones(len(candidates))
        if known is None or not len(candidates) or model.subbands > 1 or model.weight is not None:
            return raised
        strength = known.drop / self.variance
        blocks = [mode[:, 0] for mode in model.evaluate(candidates)[0]]
        overlap = [squared_coherences(own, other[:, 0]) for own, other in zip(blocks, known.blocks[0], strict=True)]
        for mode, own in enumerate(blocks):
            if own.shape[1] <= FITTED:
                continue
            rest = [o for m, o in enumerate(overlap) if m != mode]
            alike = np.prod(rest, axis=0) if rest else np.ones_like(overlap[0])
            # (C, P) the most that a path's error could have here, in noise variances.
            could = LARGEST * alike * strength
            weaker = statistic[:, None] < LARGEST * strength
            raised = np.maximum(raised, 1 + np.max(self.share * alike * strength * weaker, axis=1))
            for c, p in np.argwhere((could > 1) & weaker):
                strong = known.blocks[0][mode][p, 0]
                # What of the candidate the strong path does not explain anyway.
                fresh = own[c] - strong * (np.vdot(strong, own[c]) / max(np.vdot(strong, strong).real, 1e-300))
                fiber = self._fiber(int(p), mode)
                level = left_of(fiber, fresh) / self.variance
                raised[c] = max(raised[c], 1 + alike[c, p] * (min(level, could[c, p]) - 1))
                for part in self._parts if mode == 1 else ():
                    own_part = part.sums(fresh, strong)
                    inside = np.vdot(own_part, own_part).real / max(np.vdot(fresh, fresh).real, 1e-300)
                    level = left_of(part.sums(fiber, strong), own_part) / self.variance
                    raised[c] = max(raised[c], 1 + alike[c, p] * inside * (min(level, could[c, p]) - 1))
        return raised

    @cached_property
    def _parts(self) -> list[Part]:
        modes = self.data.model.bands[0].modes
        return parts_of(modes[1], FITTED) if len(modes) > 1 and isinstance(modes[1], TimeMode) else []

    def about(self, path: Geometry) -> float:
        """Noise that is left along the worst mode of a path (one) that others have taken the place of, 1 unless it is
        significantly more: what these must stand out of.
        """
        model, raised = self.data.model, 1.0
        if model.subbands > 1 or model.weight is not None:
            return raised
        for mode, part in enumerate(model.bands[0].modes):
            fiber = self.along(path, mode)
            fibers = [fiber]
            if mode == 1 and self._parts:
                own = part.vector(path)[0]
                fibers += [p.sums(fiber, own) for p in self._parts]
            for left in fibers:
                free = len(left) - PAIR
                if free > 1:
                    energy = float(np.linalg.norm(left) ** 2) / self.variance
                    if 2 * energy > chi2.isf(RATE, 2 * free):
                        raised = max(raised, energy / free)
        return raised

    def errors(self) -> Float:
        """(modes,) energy of the model's error along each mode, relative to a path's, from the strongest path; 0 where it is
        within what noise does.
        """
        model, known = self.data.model, self.known
        sizes = np.array([mode.shape[2] for mode in known.blocks[0]]) if known is not None else np.zeros(0, int)
        share = np.zeros(len(sizes))
        if known is None or model.subbands > 1 or model.weight is not None:
            return share
        strongest = int(np.argmax(known.drop))
        strength = known.drop[strongest] / self.variance
        for mode in np.flatnonzero(sizes > FITTED):
            energy = np.linalg.norm(self._fiber(strongest, int(mode))) ** 2 / self.variance
            # Of the fiber the path itself and its place along the mode have been fitted.
            free = sizes[mode] - 2
            if 2 * energy > chi2.isf(RATE, 2 * free):
                share[mode] = (energy - free) / strength
        return share

    def spread(self, errors: Float) -> Float:
        """(6,) error per dimension of the mode, or the part of it, that tells each parameter, from those (modes,) of
        :meth:`errors`: how far it moves a path.
        """
        model, known, share = self.data.model, self.known, np.zeros(6)
        for mode, error in zip(model.bands[0].modes, errors, strict=True):
            for parameter in mode.parameters:
                share[parameter] = max(share[parameter], error / max(mode.size - 2, 1))
        if known is None or not len(errors) or model.subbands > 1 or model.weight is not None or not self._parts:
            return share
        strongest = int(np.argmax(known.drop))
        strength = known.drop[strongest] / self.variance
        fiber, own = self._fiber(strongest, 1), known.blocks[0][1][strongest, 0]
        for part in self._parts:
            energy = np.linalg.norm(part.sums(fiber, own)) ** 2 / self.variance
            free = part.size - 2
            if 2 * energy > chi2.isf(RATE, 2 * free):
                for parameter in part.parameters:
                    share[parameter] = max(share[parameter], (energy - free) / (free * strength))
        return share

    def _contracted(self, unit, mode: int, number: int | None):
        data, last = flat(self.data.signal, self.data.model.bands[0]), len(unit) - 1
        if mode == last or number is None:
            return contracted(data, unit, mode).astype(complex)
        # All other fibers of a path begin alike, with the pass over the data that costs most.
        if number not in self._heads:
            self._heads[number] = data @ unit[last].conj().astype(np.complex64)
        return contracted(self._heads[number], unit[:last], mode).astype(complex)

    def _fiber(self, path: int, mode: int) -> Float:
        if (path, mode) not in self._fibers:
            assert self.known is not None
            self._fibers[path, mode] = self.along(self.known.geometry.take([path]), mode, path)
        return self._fibers[path, mode]

    def along(self, path: Geometry, mode: int, number: int | None = None):
        """Residual (n,) along ``mode`` in what the other modes of ``path`` (one) see, at the noise of a sample; that of a
        known path has its ``number``.
        """
        model, known = self.data.model, self.known
        own = [m[0, 0] for m in model.evaluate(path)[0]]
        unit = [v / max(np.linalg.norm(v), 1e-300) for v in own]
        fiber = self._contracted(unit, mode, number)
        if known is None:
            return fiber
        vectors = [m[:, 0] for m in known.blocks[0]]
        others = [v @ u.conj() for m, (v, u) in enumerate(zip(vectors, unit, strict=True)) if m != mode]
        return fiber - (known.gain * np.prod(others, axis=0)) @ vectors[mode]


def left_of(fiber, fresh) -> float:
    """Energy per dimension that is left of a fiber (n,) without a candidate of vector ``fresh`` (n,)."""
    along = abs(np.vdot(fresh, fiber)) ** 2 / max(np.vdot(fresh, fresh).real, 1e-300)
    return (np.vdot(fiber, fiber).real - along) / (len(fiber) - FITTED)


def contracted(data, unit, mode: int):
    """Data with an axis per mode times the conjugates of unit vectors in all modes but one, (n,)."""
    single = [u.conj().astype(np.complex64) for u in unit]
    for axis in range(len(single) - 1, mode, -1):
        data = data.reshape(-1, data.shape[-1]) @ single[axis]
        data = data.reshape([len(u) for u in single[:axis]])
    for axis in range(mode):
        data = single[axis] @ data.reshape(len(data), -1)
        data = data.reshape([len(u) for u in single[axis + 1 : mode + 1]])
    return data


def squared_coherences(first, second) -> Float:
    """Squared coherences (C, P) of vectors (C, n) and (P, n)."""
    norms = np.linalg.norm(first, axis=1)[:, None] * np.linalg.norm(second, axis=1)
    return np.abs(first.conj() @ second.T) ** 2 / np.maximum(norms, 1e-150) ** 2
