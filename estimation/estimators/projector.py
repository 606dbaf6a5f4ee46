"""Inner products of path signatures with the data, cheap to repeat.

A refinement evaluates the same few paths many times at slightly different delays. Over a window of about one
delay bin the delay vectors span only a handful of dimensions, so the data are compressed once per window, ``Z
= U^H Y`` (r, rest), and every later inner product works on Z instead of Y. Windows are kept for the whole
burst: a path that stays within one costs nothing more.
"""

from __future__ import annotations

import numpy as np

from ..signal.algebra import Blocks, project, project_rest
from ..signal.model import SignalModel
from ..signal.paths import Geometry

HALF_WIDTH = 0.75
"""Half the width of a window in delay bins."""
ACCURACY = 3e-6
"""Relative size of what a window's subspace leaves out."""


class Projector:
    """Projections on one whitened signal; holds its compressed windows (a cache, the only state)."""

    def __init__(self, model: SignalModel, signal, basis) -> None:
        self.model, self.signal = model, signal
        self._basis = basis
        self._centers = np.empty(0)
        self._windows: list[np.ndarray] = []

    def inner(self, geometry: Geometry, blocks: Blocks, exact: bool = False):
        """``<d_a s_p, y>`` (P, 7) of signatures (``a = 0``) and their six derivatives."""
        if exact or self._basis is None:
            return project(self.model, self.signal, blocks)
        window = self._window_of(geometry.delay)
        offset = geometry.delay - self._centers[window]
        rate = -2j * np.pi * self.model.waveform.frequencies
        vector = np.exp(rate * offset[:, None])
        # d/d tau of v(c) o v(tau - c) is rate * v: the frequency factor is common to both forms.
        inside = np.stack([vector, rate * vector], axis=1) @ self._basis.conj()
        inside = inside.conj().astype(np.complex64)
        partial = np.empty((*inside.shape[:2], self._windows[0].shape[1]), np.complex64)
        for p, w in enumerate(window):
            np.matmul(inside[p], self._windows[w], out=partial[p])
        return project_rest(self.model, partial, blocks[0], self.model.bands[0])

    def _window_of(self, delay):
        half = HALF_WIDTH / self.model.waveform.bandwidth
        window = np.empty(len(delay), int)
        fresh: list[int] = []
        for p, tau in enumerate(delay):
            known = np.abs(self._centers - tau)
            if not len(known) or known.min() > half:
                # Half the reach is left for the path to move in.
                self._centers = np.append(self._centers, tau)
                fresh.append(len(self._centers) - 1)
                known = np.abs(self._centers - tau)
            window[p] = int(np.argmin(known))
        if fresh:
            centers = self._centers[fresh]
            vectors = np.exp(-2j * np.pi * np.outer(centers, self.model.waveform.frequencies))
            matrix = (vectors[:, None] * self._basis.T).conj().reshape(-1, vectors.shape[1]).astype(np.complex64)
            block = matrix @ self.signal.reshape(len(self.signal), -1)
            self._windows.extend(block.reshape(len(fresh), self._basis.shape[1], -1))
        return window


def delay_basis(model: SignalModel):
    """Orthonormal basis (K, r) of the delay vectors within the half width of 0, or None where compression
    does not pay.
    """
    waveform = model.waveform
    if model.subbands > 1 or waveform.subcarriers < 24:
        return None
    offset = np.linspace(-1, 1, 81) * HALF_WIDTH / waveform.bandwidth
    left, values, _ = np.linalg.svd(np.exp(-2j * np.pi * np.outer(waveform.frequencies, offset)), full_matrices=False)
    rank = int(np.sum(values > ACCURACY * values[0]))
    return left[:, :rank]
