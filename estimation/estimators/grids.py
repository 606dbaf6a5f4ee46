"""Dictionaries of the coarse search: directions that cover an array's view evenly in its own resolution, delays
and speeds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.fft

from ..errors import ModelError
from ..signal.arrays import Complex, Manifold
from ..signal.directions import Float, angles_of, sphere
from ..signal.model import SignalModel


@dataclass(frozen=True, slots=True)
class View:
    """Directions searched: azimuth and elevation ranges [rad] in the array's parent frame.

    An azimuth range may pass +-pi (``azimuth=(3.0, 3.5)``). A planar array additionally sees only the
    half-space it faces.
    """

    azimuth: tuple[float, float] = (-np.pi, np.pi)
    elevation: tuple[float, float] = (-np.pi / 2, np.pi / 2)

    def contains(self, directions: Float):
        """Which unit vectors (P, 3) lie in the view."""
        az, el = angles_of(directions).T
        width = self.azimuth[1] - self.azimuth[0]
        inside = np.mod(az - self.azimuth[0], 2 * np.pi) <= width + 1e-12
        return inside & (el >= self.elevation[0] - 1e-12) & (el <= self.elevation[1] + 1e-12)


EVERYWHERE = View()
"""The whole sphere."""


def directions_in(view: View, array: Manifold, count: int = 6000) -> tuple[Float, float]:
    """Evenly spread directions (n, 3) that ``array`` can tell apart within ``view``, and the solid angle they
    stand for [sr].
    """
    azimuth, elevation = array.observable
    if azimuth and elevation:
        points = sphere(count)
    elif azimuth:
        az = np.linspace(-np.pi, np.pi, 1440, endpoint=False)
        points = np.stack([np.cos(az), np.sin(az), 0 * az], axis=1)
        # One half of the circle mirrors the other about the line of the array; keep the one that it faces, if that is
        # in the view at all.
        front = points[points @ array.sight.side > 1e-9]
        flat = replace(view, elevation=EVERYWHERE.elevation)
        points = front if flat.contains(front).any() else points[points @ array.sight.side < -1e-9]
    elif elevation:
        el = np.linspace(-np.pi / 2, np.pi / 2, 720)
        points = np.stack([np.cos(el), 0 * el, np.sin(el)], axis=1)
    else:
        points = np.array([[1.0, 0.0, 0.0]])
    inside = array.faces(points)
    if azimuth or elevation:
        narrowed = View(
            view.azimuth if azimuth else (-np.pi, np.pi),
            view.elevation if elevation else (-np.pi / 2, np.pi / 2),
        )
        inside &= narrowed.contains(points)
    if not inside.any():
        raise ModelError(f"view {view} holds no direction that the array can see; widen it or turn the array")
    return points[inside], 4 * np.pi * inside.sum() / max(len(points), 1)


REGISTERS = 24
"""Matrix products run fastest with a multiple of this many columns."""


def cover(vectors: Complex, retained: float, candidates: int = 2000):
    """Indices of a subset such that every normalized vector keeps ``|inner product|^2 >= retained`` with one
    of it: each next one is the candidate (every so-many-th vector) that covers most of what is left.

    Large subsets are filled up to whole registers with what is covered worst.
    """
    unit = (vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)).astype(np.complex64)
    step = -(-len(unit) // candidates)
    near = np.concatenate([
        np.abs(unit[start : start + 256 * step : step] @ unit.conj().T) ** 2 >= retained
        for start in range(0, len(unit), 256 * step)
    ])  # fmt: skip
    left = np.ones(len(unit), bool)
    counts = near.sum(axis=1)
    chosen = []
    while left.any():
        best = int(np.argmax(counts))
        new = near[best] & left
        if not new.any():
            # What no candidate covers is covered by itself.
            chosen += list(np.flatnonzero(left))
            break
        chosen.append(best * step)
        counts -= near[:, new].sum(axis=1)
        left &= ~near[best]
    if len(chosen) > REGISTERS:
        kept = np.max(np.abs(unit @ unit[chosen].conj().T), axis=1)
        while len(chosen) % REGISTERS and kept.min() < 1 - 1e-6:
            chosen.append(int(np.argmin(kept)))
            np.maximum(kept, np.abs(unit @ unit[chosen[-1]].conj()), out=kept)
    return np.array(chosen)


def direction_grid(
    view: View, array: Manifold, retained: float, seen: Callable[[Complex], Complex] = lambda a: a
) -> Float:
    """Directions (n, 3) covering ``view`` as seen through ``seen`` (beams, combiners), strongest array
    response first.
    """
    points, _ = directions_in(view, array)
    response = array.response(points)[0]
    if len(points) == 1:
        return points
    return points[cover(seen(response), retained)]


BLOCK = 128
"""Columns transformed at a time."""
LARGEST_PRODUCT = 20_000
"""Entries of a matrix that beats the transform of its columns."""


NEIGHBORS = 8
"""Delay cells that are combined into a delay vector between them; they leave out about a thousandth."""


@dataclass(frozen=True, eq=False)
class DelayGrid:
    """Matched filtering over delay cells, by FFT for a uniform comb and by a matrix product otherwise.

    Attributes
    ----------
    delays : (L,) cell centers [s]
    length : FFT length, or 0 for the matrix
    matrix : (L, K) or None
    tones : (K,) [Hz] the frequencies of the matched filter: up to a phase per cell, which does not matter,
        those of the pilots
    """

    delays: Float
    length: int
    matrix: np.typing.NDArray[np.complex64] | None
    tones: Float

    @staticmethod
    def build(
        frequencies: Float, spacing: float | None, bandwidth: float, max_delay: float, oversampling: float
    ) -> DelayGrid:
        """Cells from 0 to ``max_delay`` [s], ``oversampling`` per reciprocal bandwidth."""
        count = len(frequencies)
        if count == 1:
            return DelayGrid(np.zeros(1), 0, np.ones((1, 1), np.complex64), frequencies)
        if spacing is not None:
            length = int(scipy.fft.next_fast_len(int(np.ceil(oversampling * count))) or count)
            cells = min(int(np.ceil(max_delay * spacing * length)) + 1, length)
            delays = np.arange(cells) / (length * spacing)
            # A short transform, or a short stretch of a long one, is cheaper as a product.
            if cells > 0.15 * length and cells * count > LARGEST_PRODUCT:
                return DelayGrid(delays, length, None, spacing * np.arange(count))
        else:
            delays = np.arange(0, max_delay + 1 / (oversampling * bandwidth), 1 / (oversampling * bandwidth))
        matrix = np.exp(2j * np.pi * np.outer(delays, frequencies)).astype(np.complex64)
        return DelayGrid(delays, 0, matrix, frequencies)

    def apply(self, signal) -> np.typing.NDArray[np.complex64]:
        """Matched filter (L, ...) along the first axis of a signal (K, ...), up to a phase per cell."""
        columns = signal.reshape(len(signal), -1)
        if self.matrix is not None:
            return (self.matrix @ columns).reshape(-1, *signal.shape[1:])
        out = np.empty((len(self.delays), columns.shape[1]), np.complex64)
        # Blocks of columns: the transform along the first axis strides through memory.
        for start in range(0, columns.shape[1], BLOCK):
            part = slice(start, start + BLOCK)
            out[:, part] = scipy.fft.ifft(columns[:, part], self.length, axis=0, norm="forward")[: len(out)]  # pyright: ignore[reportCallIssue, reportArgumentType]  # SciPy's stub
        return out.reshape(-1, *signal.shape[1:])

    def around(self, delay: Float):
        """First (P,) of the neighboring cells that ``delay`` (P,) lies between."""
        count = min(NEIGHBORS, len(self.delays))
        return np.clip(np.searchsorted(self.delays, delay) - count // 2, 0, len(self.delays) - count)

    @cached_property
    def _neighbors(self) -> tuple[Complex, Complex]:
        """The delay vectors (n, K) of the first n cells and their pseudo-inverse (K, n); the same up to phases
        everywhere.
        """
        cells = self.delays[:NEIGHBORS] - self.delays[0]
        vectors = np.exp(-2j * np.pi * np.outer(cells, self.tones))
        return vectors, np.linalg.pinv(vectors)

    def combination(self, vectors: Complex, first):
        """Weights (P, c, n) with which the cells from ``first`` (P,) on give delay vectors (P, c, K) between them,
        and what they give in fact (P, c, K).
        """
        cells, inverse = self._neighbors
        shift = np.exp(2j * np.pi * self.delays[first][:, None] * self.tones)[:, None]
        weights = (vectors * shift) @ inverse
        return weights, weights @ cells * shift.conj()

    def equalizer(self, frequencies: Float, weight) -> Float:
        """(L,) factors that give every cell the noise gain of white noise, ``sqrt(K / (v^H C^-1 v))``."""
        vectors = np.exp(-2j * np.pi * np.outer(self.delays, frequencies))
        gain = np.einsum("lk,lk->l", vectors.conj(), vectors @ weight.T).real
        return np.sqrt(len(frequencies) / gain).astype(np.float32)


def speed_grid(model: SignalModel, max_speed: float, oversampling: float, registers: bool = True) -> Float:
    """Trial speeds [m/s] over +-max_speed, ``oversampling`` per wavelength over duration.

    With ``registers`` long grids are rounded to multiples of sixteen, whole vector registers.
    """
    duration = np.ptp(model.schedule.times)
    if duration == 0 or max_speed == 0:
        return np.zeros(1)
    bins = 2 * max_speed * duration / model.waveform.wavelength
    count = int(np.ceil(bins * oversampling)) + 1
    if registers and bins > 8:
        count = 16 * max(round(bins * oversampling / 16), 1)
        return np.linspace(-max_speed, max_speed, count)
    # Cells side by side: the outermost reach to the limits.
    count = max(int(np.ceil(bins * oversampling)), 1)
    return max_speed * ((2 * np.arange(count) + 1) / count - 1)


def over_ranges(model: SignalModel, slots, phase: Float, delays: Float, max_delay: float) -> tuple[Float, Float]:
    """Phases (Q, B, A * V) that undo speeds, from those (Q, B, V) of one range of delays, and all delays (A * L,)."""
    shifts = np.asarray(model.schedule.offsets)[slots]  # (B, Q, S)
    if np.ptp(shifts, axis=2).any():
        raise ModelError(
            "Schedule: a staged search needs the pilots of a beam at the same place for all combiners that it is held for; "
            "sweep(..., stagger=...) makes such a schedule"
        )
    period = model.waveform.max_delay
    ranges = period * np.arange(max(1, int(np.ceil(max_delay / period * (1 - 1e-9)))))
    turned = 2 * np.pi * shifts[:, :, 0].T[:, :, None, None] * ranges[:, None] + phase[:, :, None]
    return turned.reshape(*phase.shape[:2], -1), (ranges[:, None] + delays).ravel()
