"""One mode's dictionary with its neighborhoods: what lies between grid points, from the grid points around.

A response between the cells of a dictionary is nearly a combination of its neighbors, so that their matched
filters hold all that is needed to judge it. The weights are those of least squares; what they leave out lowers
the energy by a few hundredths at most and decides nothing (fits and thresholds work on the data themselves).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..signal.arrays import Complex
from ..signal.directions import Float

Indices = np.typing.NDArray[np.intp]
Single = np.typing.NDArray[np.complex64]


@dataclass(frozen=True, eq=False)
class Cells:
    """C unit-norm responses over M samples of a mode.

    Attributes
    ----------
    vectors : (C, M)
    neighbors : (C, n) numbers of the most coherent cells, each cell itself first
    shifts : (C, J, n) combinations of the neighbors' matched filters that give those of J points about the cell
    """

    vectors: Single
    neighbors: Indices
    shifts: Single

    @staticmethod
    def build(vectors: Complex, points: Complex, count: int) -> Cells:
        """Tables for dictionary ``vectors`` (C, M), ``points`` (C, J, M) about each cell and ``count`` neighbors."""
        unit, points = _normalized(vectors), _normalized(points)
        near = np.abs(unit.conj() @ unit.T)
        neighbors = np.argsort(-near - np.eye(len(near)), axis=1, kind="stable")[:, : min(count, len(near))]
        around = unit[neighbors]
        gram = around.conj() @ around.swapaxes(1, 2)
        # A trace of ridge: closely packed cells of a small array may be all but dependent.
        inverse = np.linalg.inv(gram + 1e-4 * np.eye(gram.shape[1]))
        weights = points @ around.conj().swapaxes(1, 2) @ inverse.swapaxes(1, 2)
        return Cells(unit.astype(np.complex64), neighbors, weights.conj().astype(np.complex64))


def _normalized(vectors: Complex) -> Complex:
    """Vectors along the last axis at unit length; those that an element pattern hides stay 0."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)


def line_points(rates: Complex, grid: Float, offsets: Float) -> Complex:
    """Vectors (C, J, M) ``exp(rate * x)`` at ``grid`` + ``offsets``."""
    return np.exp((grid[:, None] + offsets)[:, :, None] * rates)


def ring(metrics: Float, radius: float, active, count: int = 6) -> Float:
    """Tangent steps (C, 1 + count, 2) to the center and around it at ``radius`` in each cell's metric (C, 2, 2)."""
    values, axes = np.linalg.eigh(metrics)
    # A line or a point sees one angle or none: no step along what it does not see.
    seen = values > 1e-9 * np.maximum(values[:, -1:], 1e-300)
    scale = np.where(seen, radius / np.sqrt(np.where(seen, values, 1.0)), 0.0)
    angle = 2 * np.pi * np.arange(count) / count
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    steps = np.einsum("cij,cj,kj->cki", axes, scale, circle)
    return np.concatenate([np.zeros((len(metrics), 1, 2)), np.clip(steps, -0.5, 0.5)], axis=1) * active
