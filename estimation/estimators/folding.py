"""Data in coordinates in which the steering vectors of symmetric modes are real.

A mode whose samples lie at opposite places in pairs (a comb about the carrier, symbols about the burst's center, most
arrays about theirs) has conjugate-symmetric vectors: ``v(-x) = conj(v(x))``. Sums ``(y_a + y_b) / sqrt(2)`` and turned
differences ``(y_a - y_b) / (j sqrt(2))`` of the pairs are a unitary change of coordinates that makes them real, the
idea of unitary ESPRIT. Matched filters then are real matrices on the real and imaginary planes of the data: half the
arithmetic. Nothing is lost where symmetry fails; matrices are complex there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from ..signal.algebra import project_rest
from ..signal.arrays import Complex, Manifold
from ..signal.directions import sphere
from ..signal.model import SignalModel
from .kernels import folded

Planes = np.typing.NDArray[np.float32]
"""Real and imaginary parts along the first axis."""
Matrix = np.typing.NDArray[np.float32] | np.typing.NDArray[np.complex64]


@dataclass(frozen=True, eq=False)
class Pairs:
    """Samples of a mode at opposite places: ``first`` (h,) with ``second`` (h,), and those ``alone``.

    Folded vectors hold h sums, h differences, then the samples alone. ``real`` says that the mode's vectors are real then.
    """

    first: np.typing.NDArray[np.intp]
    second: np.typing.NDArray[np.intp]
    alone: np.typing.NDArray[np.intp]
    real: bool

    @staticmethod
    def build(places) -> Pairs:
        """Pairs among ``places`` (M, d); none unless they are symmetric about the origin."""
        places = np.asarray(places, float)
        own = np.arange(len(places))
        distance, partner = (np.asarray(found) for found in KDTree(places).query(-places))
        if distance.max() > 1e-6 * max(np.abs(places).max(), 1e-300) or np.any(partner[partner] != own):
            return Pairs.none(len(places))
        first = own[partner > own]
        return Pairs(first, partner[first], own[partner == own], True)

    @staticmethod
    def of_array(array: Manifold) -> Pairs:
        """Pairs of an array's elements, if they have places and patterns without phase."""
        places = getattr(array, "positions", None)
        pairs = Pairs.none(array.elements) if places is None else Pairs.build(places)
        vectors = pairs.fold(array.response(sphere(50))[0])
        return pairs if pairs.real and np.allclose(np.imag(vectors), 0) else Pairs.none(array.elements)

    @staticmethod
    def none(size: int) -> Pairs:
        """Every sample alone."""
        return Pairs(np.empty(0, int), np.empty(0, int), np.arange(size), False)

    @property
    def mirrored(self) -> bool:
        """Whether all samples pair from the ends inwards."""
        count = len(self.first) * 2 + len(self.alone)
        half = np.arange(count // 2)
        return bool(np.array_equal(self.first, half) and np.array_equal(self.second, count - 1 - half))

    def fold(self, vectors: Complex) -> Complex:
        """Vectors (..., M) in folded coordinates."""
        if not len(self.first):
            return vectors
        first, second = vectors[..., self.first], vectors[..., self.second]
        scale = np.sqrt(0.5)
        return np.concatenate(
            [(first + second) * scale, (first - second) * (-1j * scale), vectors[..., self.alone]], axis=-1
        )

    def steering(self, vectors: Complex) -> Matrix:
        """Vectors (..., M) of the mode in folded coordinates, real if they may be, in single precision."""
        if not self.real:
            return self.fold(vectors).astype(np.complex64)
        # Of conjugate-symmetric vectors one of each pair tells all.
        first = vectors[..., self.first] * np.sqrt(2)
        alone = np.real(vectors[..., self.alone])
        return np.concatenate([np.real(first), np.imag(first), alone], axis=-1, dtype=np.float32)

    def unfold_rows(self, rows: Complex) -> Complex:
        """The inverse of :meth:`fold` along the first axis."""
        half = len(self.first)
        if not half:
            return rows
        scale = np.float32(np.sqrt(0.5))
        out = np.empty_like(rows)
        turned = 1j * rows[half : 2 * half]
        out[self.first] = (rows[:half] + turned) * scale
        out[self.second] = (rows[:half] - turned) * scale
        out[self.alone] = rows[2 * half :]
        return out


@dataclass(frozen=True, eq=False)
class Folding:
    """Pairs of the ``axes`` of a link's data and of those of its ``arrays`` that are modes of their own.

    The axes are pilots, symbols, receive elements and transmit elements of a digital link; of any other link only the
    pilots fold, and the last axis is all the rest.
    """

    axes: tuple[Pairs, Pairs, Pairs, Pairs]
    arrays: tuple[Pairs, ...]

    @staticmethod
    def build(model: SignalModel) -> Folding:
        """Pairs wherever a mode is symmetric."""
        pilots = Pairs.build(model.waveform.frequencies[:, None])
        if model.schedule.precoders is None and model.schedule.combiners is None:
            symbols = Pairs.build(model.schedule.times[:, None])
            arrays = Pairs.of_array(model.heard), Pairs.of_array(model.transmitter)
            return Folding((pilots, symbols, *arrays), arrays)
        others = model.bands[0].modes[2:]
        rest = Pairs.none(int(np.prod(model.shape[1:])))
        return Folding((pilots, Pairs.none(1), Pairs.none(1), rest), tuple(Pairs.none(m.size) for m in others))

    def planes(self, signal, out: Planes) -> Planes:
        """Real and imaginary planes ``out`` (2, K, N, R, T) of a folded signal."""
        rows = np.ascontiguousarray(signal, np.complex64).reshape(*out.shape[1:3], -1).view(np.float32)
        folded(rows, *((p.first, p.second, p.alone) for p in self.axes), self.axes[3].mirrored, out)
        return out

    @property
    def shape(self) -> tuple[int, ...]:
        """(2, K, N, R, T)."""
        return 2, *(2 * len(p.first) + len(p.alone) for p in self.axes)


def product(matrix: Matrix, planes: Planes, out: Planes | None = None) -> Planes:
    """``matrix`` (..., n, m) times planes (2, ..., m, c) of complex numbers."""
    if not np.iscomplexobj(matrix):
        return np.matmul(matrix, planes, out=out)
    count = matrix.shape[-2]
    parts = np.matmul(np.concatenate([matrix.real, matrix.imag], axis=-2), planes)
    if out is None:
        out = np.empty((*parts.shape[:-2], count, parts.shape[-1]), np.float32)
    np.subtract(parts[0, ..., :count, :], parts[1, ..., count:, :], out=out[0])
    np.add(parts[0, ..., count:, :], parts[1, ..., :count, :], out=out[1])
    return out


def product_right(planes: Planes, matrix: Matrix) -> Planes:
    """Planes (2, ..., c, m) of complex numbers times the transpose of ``matrix`` (n, m)."""
    if not np.iscomplexobj(matrix):
        return planes @ matrix.T  # pyright: ignore[reportReturnType]  # both are real, of single precision
    real, imag = matrix.real, matrix.imag
    return np.stack([planes[0] @ real.T - planes[1] @ imag.T, planes[0] @ imag.T + planes[1] @ real.T])


def joined(planes: Planes) -> np.typing.NDArray[np.complex64]:
    """Complex numbers from their planes."""
    out = np.empty(planes.shape[1:], np.complex64)
    out.real, out.imag = planes
    return out


def project_planes(model: SignalModel, partial: Planes, modes: list[Matrix]):
    """Finish projections (P, 7) whose first mode is contracted, ``partial`` planes (2, P, 2, product of the others), as
    :func:`~estimation.signal.algebra.project_rest`; the modes are folded.
    """
    if any(np.iscomplexobj(mode) for mode in modes[1:]):
        return project_rest(model, joined(partial), modes)
    real, imag = project_rest(model, partial, modes)
    return real + 1j * imag
