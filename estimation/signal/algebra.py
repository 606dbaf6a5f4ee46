"""Linear algebra of path signatures, generic over modes: synthesis, projections and Gram matrices.

Index 0 of the axes of length 7 is the signature itself, 1..6 its derivative along the six parameters (directions by tangents).
"""

from __future__ import annotations

import numpy as np

from .arrays import Complex
from .model import Band, SignalModel, flat
from .paths import Geometry

Blocks = list[list[Complex]]


def signal_of(model: SignalModel, blocks: Blocks, gain: Complex) -> np.typing.NDArray[np.complex64]:
    """Noise-free whitened signal (model.shape) of paths with complex ``gain`` (P,): two Khatri-Rao halves and one product."""
    out = np.empty(model.shape, np.complex64)
    for band, modes in zip(model.bands, blocks, strict=True):
        left = (modes[0][:, 0] * gain[:, None]).astype(np.complex64)
        right = modes[1][:, 0].astype(np.complex64)
        for mode in modes[2:]:
            right = (right[:, :, None] * mode[:, None, 0].astype(np.complex64)).reshape(len(gain), -1)
        np.matmul(left.T, right, out=flat(out, band).reshape(left.shape[1], -1))
    return out


def project(model: SignalModel, signal: Complex, blocks: Blocks) -> Complex:
    """Inner products (P, 7) of signatures and derivatives with a whitened signal, ``<d_a s_p, y>``."""
    paths = len(blocks[0][0])
    total = np.zeros((paths, 7), complex)
    for band, modes in zip(model.bands, blocks, strict=True):
        total += _project_band(model, flat(signal, band), modes, band)
    return total


def _project_band(model: SignalModel, data: Complex, modes: list[Complex], band: Band) -> Complex:
    first = modes[0].conj().astype(np.complex64)
    partial = first.reshape(-1, first.shape[-1]) @ data.reshape(len(data), -1)
    return project_rest(model, partial.reshape(len(first), first.shape[1], -1), modes, band)


def project_rest(model: SignalModel, partial: Complex, modes: list[Complex], band: Band) -> Complex:
    """Finish a projection (P, 7) whose first mode is contracted already, ``partial`` (P, 2, product of the other modes)."""
    paths = len(partial)
    partial = partial.reshape(paths, 2, *(mode.size for mode in band.modes[1:]))
    # Contract the remaining modes from the last to the first, keeping a derivative axis for each.
    for mode in modes[:0:-1]:
        vectors = mode.conj().astype(np.complex64).swapaxes(1, 2)
        lead = (1,) * (partial.ndim - 3)
        partial = np.matmul(partial, vectors.reshape(paths, *lead, *vectors.shape[1:]))
        partial = np.moveaxis(partial, -1, 2)  # (paths, c0, c_last, remaining modes ...)
    index = tuple(model.columns[row] for row in range(len(modes)))
    return partial.astype(complex)[(slice(None), *index)]


def gram(
    blocks: Blocks,
    columns: np.typing.NDArray,
    other: Blocks | None = None,
    other_columns: np.typing.NDArray | None = None,
) -> Complex:
    """Gram matrix (P, 7, P', 7) of signatures and derivatives, ``<d_a s_p, d_b s_q>``, a Hadamard product over modes."""
    other = blocks if other is None else other
    other_columns = columns if other_columns is None else other_columns
    total = 0
    for modes, others in zip(blocks, other, strict=True):
        product = 1
        for row, (left, right) in enumerate(zip(modes, others, strict=True)):
            inner = left.conj().reshape(-1, left.shape[-1]) @ right.reshape(-1, right.shape[-1]).T
            inner = inner.reshape(len(left), -1, len(right), right.shape[1])
            product = product * inner[:, columns[row]][:, :, :, other_columns[row]]
        total = total + product
    return total


def gram_diagonal(blocks: Blocks, columns: np.typing.NDArray) -> Complex:
    """Gram matrices (P, 7, 7) of each path with itself."""
    total = 0
    for modes in blocks:
        product = 1
        for row, block in enumerate(modes):
            inner = np.matmul(block.conj(), block.swapaxes(1, 2))
            product = product * inner[:, columns[row]][:, :, columns[row]]
        total = total + product
    return total


def cross_gram(blocks: Blocks, other: Blocks) -> Complex:
    """Gram matrix (P, P') of the signatures alone."""
    total = 0
    for modes, others in zip(blocks, other, strict=True):
        product = 1
        for left, right in zip(modes, others, strict=True):
            product = product * (left[:, 0].conj() @ right[:, 0].T)
        total = total + product
    return total


def coherence(model: SignalModel, geometry: Geometry, other: Geometry | None = None):
    """|normalized inner products| (P, P') of signatures, between 0 and 1."""
    blocks = model.evaluate(geometry)
    others = blocks if other is None else model.evaluate(other)
    norms = [np.sqrt(np.abs(gram_norms(b))) for b in (blocks, others)]
    return np.abs(cross_gram(blocks, others)) / np.maximum(np.outer(*norms), 1e-300)


def gram_norms(blocks: Blocks):
    """Squared norms (P,) of the signatures."""
    total = 0
    for modes in blocks:
        product = 1
        for mode in modes:
            product = product * np.sum(np.abs(mode[:, 0]) ** 2, axis=-1)
        total = total + product
    return total
