"""Inner products of path signatures with the data, cheap to repeat.

A refinement evaluates the same few paths many times at slightly different delays. Over a window of about one
delay bin the delay vectors span only a handful of dimensions, so the data are compressed once per window, ``Z
= U^H Y`` (r, rest), and every later inner product works on Z instead of Y; likewise the symbols of a digital
link, whose vectors depend on the speed alone. Windows are kept for the whole burst: a path that stays within
one costs nothing more. All of this happens in folded coordinates (:mod:`~.folding`), where U is real.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..signal.algebra import Blocks, contract_rest, project
from ..signal.arrays import Complex
from ..signal.directions import Float
from ..signal.model import SignalModel
from ..signal.paths import Geometry
from .folding import Folding, Matrix, Pairs, Planes, joined, product, project_planes
from .pool import Pool

HALF_WIDTH = 0.2
"""Half the width of a window in bins."""
ACCURACY = 1e-5
"""Relative size of what a window's subspace leaves out."""
C64 = np.complex64


@dataclass(frozen=True, eq=False)
class Basis:
    """Orthonormal basis (n, r) of the vectors ``exp(rate * x)`` for x within ``half`` of 0, ``rate`` (n,), whose samples
    fold in ``pairs``.
    """

    rate: Complex
    half: float
    vectors: Complex
    pairs: Pairs

    @staticmethod
    def build(rate: Complex, pairs: Pairs) -> Basis:
        """Basis over :data:`HALF_WIDTH` bins either way."""
        half = HALF_WIDTH * 2 * np.pi / np.ptp(np.imag(rate))
        offset = np.linspace(-1, 1, 81) * half
        left, values, _ = np.linalg.svd(np.exp(np.outer(rate, offset)), full_matrices=False)
        left = left[:, : int(np.sum(values > ACCURACY * values[0]))]
        if pairs.real:
            # Each vector folds to a real one but for a phase of its own.
            left = left * np.exp(-1j * common_phase(pairs.fold(left.T)))
        return Basis(rate, half, left, pairs)

    def compressors(self, centers) -> Matrix:
        """(W, r, n): conjugated bases of the windows about ``centers`` (W,), folded."""
        vectors = np.exp(np.outer(centers, self.rate))
        return self.pairs.steering(vectors[:, None] * self.vectors.T).conj()

    def coordinates(self, offset) -> Matrix:
        """Coordinates (..., r) of the vectors at ``offset`` (...,) from a window's center, real if the samples fold."""
        inside = np.exp(self.rate * offset[..., None]) @ self.vectors.conj()
        return inside.real.astype(np.float32) if self.pairs.real else inside.astype(C64)

    def inside(self, offset) -> Matrix:
        """Coordinates (P, 2, r) of the vectors at ``offset`` (P,) from a window's center and of their derivatives, real if
        the samples fold.

        d/dx of v(c) o v(x - c) is rate * v: the factor is common to both forms.
        """
        vector = np.exp(self.rate * offset[:, None])
        inside = np.stack([vector, self.rate * vector], axis=1) @ self.vectors.conj()
        return np.real(inside).astype(np.float32) if self.pairs.real else inside.astype(C64)


def common_phase(vectors: Complex):
    """Phases (r,) that vectors (r, n), real but for them, have in common."""
    return 0.5 * np.angle(np.sum(vectors**2, axis=-1))


@dataclass(frozen=True, eq=False)
class Bases:
    """How a link's data fold, and bases of their windows: over pilots, and over symbols if it is digital; None where
    compression does not pay.
    """

    folding: Folding
    delay: Basis | None
    time: Basis | None
    pool: Pool = field(default_factory=Pool, repr=False)

    @staticmethod
    def build(model: SignalModel) -> Bases:
        """Bases of a link."""
        waveform, folding = model.waveform, Folding.build(model)
        if model.subbands > 1 or waveform.subcarriers < 24:
            return Bases(folding, None, None)
        delay = Basis.build(-2j * np.pi * waveform.frequencies, folding.axes[0])
        digital = model.schedule.precoders is None and model.schedule.combiners is None
        times = model.schedule.times
        if not digital or len(times) < 12 or np.ptp(times) == 0:
            return Bases(folding, delay, None)
        return Bases(folding, delay, Basis.build(2j * np.pi / waveform.wavelength * times, folding.axes[1]))


class Projector:
    """Projections on one whitened signal; holds its planes and compressed windows (caches, the only state)."""

    def __init__(self, model: SignalModel, signal, bases: Bases | None) -> None:
        self.model: SignalModel = model
        self.signal = signal
        self._bases = bases
        self._delays, self._speeds = np.empty(0), np.empty(0)
        self._windows: list[np.ndarray] = []

    @cached_property
    def planes(self) -> Planes:
        """Planes (2, K, N, R, T) of the folded signal."""
        if self._bases is None:
            folding = Folding.build(self.model)
            return folding.planes(self.signal, np.empty(folding.shape, np.float32))
        folding = self._bases.folding
        return folding.planes(self.signal, self._bases.pool.lend(self, folding.shape))

    def inner(self, geometry: Geometry, blocks: Blocks):
        """``<d_a s_p, y>`` (P, 7) of signatures (``a = 0``) and their six derivatives."""
        bases = self._bases
        if bases is None or bases.delay is None:
            return project(self.model, self.signal, blocks)
        window = self._window_of(geometry, bases, bases.delay)
        inside = bases.delay.inside(geometry.delay - self._delays[window]).conj()
        partial = np.empty((2, *inside.shape[:2], self._windows[0].shape[2]), np.float32)
        for p, w in enumerate(window):
            product(inside[p], self._windows[w], partial[:, p])
        frequency, time, *rest = blocks[0]
        if bases.time is None:
            time = bases.folding.axes[1].steering(time)
        else:
            time = bases.time.inside(geometry.speed - self._speeds[window])
        folded = [axis.steering(mode) for axis, mode in zip(bases.folding.arrays, rest, strict=True)]
        return project_planes(self.model, partial, [frequency, time, *folded])

    def about(self, geometry: Geometry, steps: list[Float], vectors: list[Complex]) -> Complex:
        """Inner products (P, c_0, c_1, ...) of the data with all outer products of vectors (P, c, n), one of each mode:
        those at ``steps`` (P, c, 6) from paths, within a bin of them.

        A window's subspace leaves out a thousandth of a vector half a bin from its center.
        """
        bases = self._bases
        folding = Folding.build(self.model) if bases is None else bases.folding
        first, time, *rest = vectors
        modes = [axis.steering(v) for axis, v in zip(folding.arrays, rest, strict=True)]
        if bases is None or bases.delay is None:
            matrix = folding.axes[0].steering(first).conj()
            count, points, pilots = matrix.shape
            partial = product(matrix.reshape(-1, pilots), self.planes.reshape(2, pilots, -1))
            partial = partial.reshape(2, count, points, -1)
        else:
            window = self._window_of(geometry, bases, bases.delay)
            inside = bases.delay.coordinates((geometry.delay - self._delays[window])[:, None] + steps[0][..., 0]).conj()
            partial = np.empty((2, *inside.shape[:2], self._windows[0].shape[2]), np.float32)
            for p, w in enumerate(window):
                product(inside[p], self._windows[w], partial[:, p])
            if bases.time is not None:
                time = bases.time.coordinates((geometry.speed - self._speeds[window])[:, None] + steps[1][..., 5])
        if bases is None or bases.time is None:
            time = folding.axes[1].steering(time)
        if any(np.iscomplexobj(mode) for mode in (time, *modes)):
            return contract_rest(joined(partial), [first, time, *modes]).astype(complex)
        real, imag = contract_rest(partial, [first, time, *modes])
        return real + 1j * imag.astype(float)

    def _window_of(self, geometry: Geometry, bases: Bases, basis: Basis):
        window = np.empty(len(geometry), int)
        fresh = len(self._delays)
        for p, (delay, speed) in enumerate(zip(geometry.delay, geometry.speed, strict=True)):
            known = np.abs(self._delays - delay) / basis.half
            if bases.time is not None:
                known = np.maximum(known, np.abs(self._speeds - speed) / bases.time.half)
            if not len(known) or known.min() > 1:
                self._delays, self._speeds = np.append(self._delays, delay), np.append(self._speeds, speed)
                window[p] = len(self._delays) - 1
            else:
                window[p] = int(np.argmin(known))
        if fresh < len(self._delays):
            planes, matrix = self.planes, basis.compressors(self._delays[fresh:])
            count, rank, pilots = matrix.shape
            block = product(matrix.reshape(-1, pilots), planes.reshape(2, pilots, -1))
            if bases.time is not None:
                matrix = bases.time.compressors(self._speeds[fresh:])[:, None]
                block = product(matrix, block.reshape(2, count, rank, matrix.shape[-1], -1))
            self._windows.extend(np.moveaxis(block.reshape(2, count, rank, -1), 1, 0))
        return window
