"""Linear algebra of path signatures, generic over modes: synthesis, projections and Gram matrices.

Index 0 of the axes of length 7 is the signature itself, 1..6 its derivative along the six parameters
(directions by tangents).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg.blas import cgemm  # pyright: ignore[reportAttributeAccessIssue]

from .arrays import Complex
from .model import Band, SignalModel, flat
from .paths import Geometry

Blocks = list[list[Complex]]


def signal_of(model: SignalModel, blocks: Blocks, gain: Complex) -> np.typing.NDArray[np.complex64]:
    """Noise-free whitened signal (model.shape) of paths with complex ``gain`` (P,)."""
    return add_signal(model, blocks, gain, np.zeros(model.shape, np.complex64))


def add_signal(model: SignalModel, blocks: Blocks, gain: Complex, out):
    """Add the paths' signal to ``out`` (model.shape, complex64, contiguous) in place: Khatri-Rao halves and
    one product per band.
    """
    for band, modes in zip(model.bands, blocks, strict=True):
        left = (modes[0][:, 0] * gain[:, None]).astype(np.complex64)
        right = modes[1][:, 0].astype(np.complex64)
        for mode in modes[2:]:
            right = (right[:, :, None] * mode[:, None, 0].astype(np.complex64)).reshape(len(gain), -1)
        # out += left^T right in place; BLAS wants column order, that is the transposes.
        cgemm(1.0, right.T, left, 1.0, out[band.pilots].reshape(left.shape[1], -1).T, overwrite_c=True)
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
    return project_rest(model, partial.reshape(len(first), first.shape[1], -1), modes)


def project_rest(model: SignalModel, partial, modes: list[Complex]):
    """Finish a projection (..., P, 7) whose first mode is contracted already, ``partial`` (..., P, 2, product of the
    other modes); real modes of real data stay real.
    """
    partial = contract_rest(partial, modes)
    double = complex if np.iscomplexobj(partial) else float
    return model.merged(partial.astype(double)[(..., *(model.columns[row] for row in range(len(modes))))])


def contract_rest(partial, modes: list[Complex]):
    """Inner products (..., P, c_0, c_1, ...) with all outer products of vectors (P, c, n), one of each mode, the first of
    which is contracted already: ``partial`` (..., P, c_0, product of the other modes).
    """
    # The remaining modes one after the other, an axis for each; long contiguous rows come first.
    lead = partial.shape[:-2]
    shape = (*lead, partial.shape[-2])
    for mode in modes[1:]:
        single = np.complex64 if np.iscomplexobj(mode) else np.float32
        vectors = mode.conj().astype(single)
        partial = partial.reshape(*lead, -1, mode.shape[-1], partial.shape[-1] // mode.shape[-1])
        partial = np.matmul(vectors[:, None], partial)
        shape += (mode.shape[1],)
        partial = partial.reshape(*lead, -1, partial.shape[-1])
    return partial.reshape(shape)


def gram(model: SignalModel, blocks: Blocks, other: Blocks | None = None, plain: bool = False) -> Complex:
    """Gram matrix (P, 7, P', 7) of signatures and derivatives, ``<d_a s_p, C^-1 d_b s_q>``, a Hadamard
    product over modes.

    ``C`` is the noise covariance over the pilots, if the model has one. With ``plain`` the others enter
    without derivatives: (P, 7, P', 1).
    """
    columns = model.columns
    others_columns = np.zeros((len(columns), 1), int) if plain else columns
    total: Any = 0
    for modes, others in zip(blocks, blocks if other is None else other, strict=True):
        product = 1
        for row, (left, right) in enumerate(zip(modes, others, strict=True)):
            right = _weighted(model, row, right[:, :1] if plain else right)
            inner = left.conj().reshape(-1, left.shape[-1]) @ right.reshape(-1, right.shape[-1]).T
            inner = inner.reshape(len(left), -1, len(right), right.shape[1])
            kept = columns[row] if left.shape[1] > 1 else np.zeros(1, int)
            product = product * inner[:, kept][:, :, :, others_columns[row]]
        total = total + product
    total = total if total.shape[1] == 1 else model.merged(total, 1)
    return total if total.shape[3] == 1 else model.merged(total, 3)


def gram_diagonal(model: SignalModel, blocks: Blocks, plain: bool = False) -> Complex:
    """Gram matrices (P, 7, 7) of each path with itself; (P, 1, 1) without derivatives if ``plain``."""
    total: Any = 0
    columns = np.zeros((len(blocks[0]), 1), int) if plain else model.columns
    for modes in blocks:
        product = 1
        for row, block in enumerate(modes):
            inner = np.matmul(block.conj(), _weighted(model, row, block).swapaxes(1, 2))
            product = product * inner[:, columns[row]][:, :, columns[row]]
        total = total + product
    return total if plain else model.merged(model.merged(total, 1), 2)


def coherence(model: SignalModel, geometry: Geometry):
    """|normalized inner products| (P, P) of signatures, between 0 and 1."""
    blocks = [[mode[:, :1] for mode in modes] for modes in model.evaluate(geometry)]
    return normalized(gram(model, blocks, plain=True)[:, 0, :, 0])


def normalized(matrix: Complex):
    """Magnitudes (P, P) of a Gram matrix with ones on its diagonal."""
    size = np.abs(matrix)
    norm = np.sqrt(np.diag(size))
    return size / np.maximum(norm[:, None] * norm, 1e-300)


def _weighted(model: SignalModel, row: int, block: Complex) -> Complex:
    """The block of mode ``row`` times the inverse pilot covariance, which acts on the delay mode only."""
    return block if row or model.weight is None else block @ model.weight.T


def weighted_blocks(model: SignalModel, blocks: Blocks) -> Blocks:
    """Blocks whose delay mode carries the inverse pilot covariance: how paths appear in data weighted by it."""
    if model.weight is None:
        return blocks
    return [[_weighted(model, 0, modes[0]), *modes[1:]] for modes in blocks]
