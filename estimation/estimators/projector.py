"""Inner products of path signatures with the data, cheap to repeat.

A refinement evaluates the same few paths many times at slightly different delays. Over a window of about one
delay bin the delay vectors span only a handful of dimensions, so the data are compressed once per window, ``Z
= U^H Y`` (r, rest), and every later inner product works on Z instead of Y; likewise the symbols of a digital
link, whose vectors depend on the speed alone. Windows are kept for the whole burst: a path that stays within
one costs nothing more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..signal.algebra import Blocks, project, project_rest
from ..signal.arrays import Complex
from ..signal.model import SignalModel
from ..signal.paths import Geometry

HALF_WIDTH = 0.5
"""Half the width of a window in bins."""
ACCURACY = 1e-5
"""Relative size of what a window's subspace leaves out."""
C64 = np.complex64


@dataclass(frozen=True, eq=False)
class Basis:
    """Orthonormal basis (n, r) of the vectors ``exp(rate * x)`` for x within ``half`` of 0, ``rate`` (n,)."""

    rate: Complex
    half: float
    vectors: Complex

    @staticmethod
    def build(rate: Complex) -> Basis:
        """Basis over :data:`HALF_WIDTH` bins either way."""
        half = HALF_WIDTH * 2 * np.pi / np.ptp(rate.imag)
        offset = np.linspace(-1, 1, 81) * half
        left, values, _ = np.linalg.svd(np.exp(np.outer(rate, offset)), full_matrices=False)
        return Basis(rate, half, left[:, : int(np.sum(values > ACCURACY * values[0]))])

    def compressors(self, centers) -> np.typing.NDArray[C64]:
        """(W, r, n): conjugated bases of the windows about ``centers`` (W,)."""
        vectors = np.exp(np.outer(centers, self.rate))
        return (vectors[:, None] * self.vectors.T).conj().astype(C64)

    def inside(self, offset) -> Complex:
        """Coordinates (P, 2, r) of the vectors at ``offset`` (P,) from a window's center and of their derivatives.

        d/dx of v(c) o v(x - c) is rate * v: the factor is common to both forms.
        """
        vector = np.exp(self.rate * offset[:, None])
        return np.stack([vector, self.rate * vector], axis=1) @ self.vectors.conj()


@dataclass(frozen=True, eq=False)
class Bases:
    """Bases of the windows of a link: over pilots, and over symbols if it is digital."""

    delay: Basis
    time: Basis | None

    @staticmethod
    def build(model: SignalModel) -> Bases | None:
        """None where compression does not pay."""
        waveform = model.waveform
        if model.subbands > 1 or waveform.subcarriers < 24:
            return None
        delay = Basis.build(-2j * np.pi * waveform.frequencies)
        digital = model.schedule.precoders is None and model.schedule.combiners is None
        times = model.schedule.times
        if not digital or len(times) < 12 or np.ptp(times) == 0:
            return Bases(delay, None)
        return Bases(delay, Basis.build(2j * np.pi / waveform.wavelength * times))


class Projector:
    """Projections on one whitened signal; holds its compressed windows (a cache, the only state)."""

    def __init__(self, model: SignalModel, signal, bases: Bases | None) -> None:
        self.model, self.signal = model, signal
        self._bases = bases
        self._delays, self._speeds = np.empty(0), np.empty(0)
        self._windows: list[np.ndarray] = []

    def inner(self, geometry: Geometry, blocks: Blocks):
        """``<d_a s_p, y>`` (P, 7) of signatures (``a = 0``) and their six derivatives."""
        bases = self._bases
        if bases is None:
            return project(self.model, self.signal, blocks)
        window = self._window_of(geometry, bases)
        inside = bases.delay.inside(geometry.delay - self._delays[window]).conj().astype(C64)
        partial = np.empty((*inside.shape[:2], self._windows[0].shape[1]), C64)
        for p, w in enumerate(window):
            np.matmul(inside[p], self._windows[w], out=partial[p])
        modes = blocks[0]
        if bases.time is not None:
            modes = [modes[0], bases.time.inside(geometry.speed - self._speeds[window]), *modes[2:]]
        return project_rest(self.model, partial, modes)

    def _window_of(self, geometry: Geometry, bases: Bases):
        window = np.empty(len(geometry), int)
        fresh = len(self._delays)
        for p, (delay, speed) in enumerate(zip(geometry.delay, geometry.speed, strict=True)):
            known = np.abs(self._delays - delay) / bases.delay.half
            if bases.time is not None:
                known = np.maximum(known, np.abs(self._speeds - speed) / bases.time.half)
            if not len(known) or known.min() > 1:
                self._delays, self._speeds = np.append(self._delays, delay), np.append(self._speeds, speed)
                window[p] = len(self._delays) - 1
            else:
                window[p] = int(np.argmin(known))
        if fresh < len(self._delays):
            matrix = bases.delay.compressors(self._delays[fresh:])
            block = matrix.reshape(-1, matrix.shape[2]) @ self.signal.reshape(len(self.signal), -1)
            block = block.reshape(*matrix.shape[:2], -1)
            if bases.time is not None:
                matrix = bases.time.compressors(self._speeds[fresh:])
                block = np.matmul(matrix[:, None], block.reshape(*block.shape[:2], matrix.shape[2], -1))
            self._windows.extend(block.reshape(*block.shape[:2], -1))
        return window
