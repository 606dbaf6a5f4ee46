"""Maximum-likelihood refinement: Levenberg-Marquardt with the gains eliminated (variable projection), jointly
over all paths.

For whitened data the log-likelihood, with gains at their optimum, is ``b^H G^-1 b / sigma^2`` (``b``
projections on the signatures, ``G`` their Gram matrix). Gradient and Gauss-Newton matrix follow from
projections and Gram matrices only, so that an iteration costs one pass over the data. Steps are bounded in
the metric of each path's own normalized Fisher information, which knows the width of the ambiguity function
in every direction, whatever array it comes from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..signal.algebra import Blocks, gram, normalized
from ..signal.directions import Float
from ..signal.model import SignalModel
from ..signal.paths import Geometry
from .clock import ENDLESS, Clock

LARGEST_STEP = 0.8
"""Longest step of one path in its own metric; the ambiguity function's main lobe ends near 3."""


class Data(Protocol):
    """A signal that signatures can be projected on."""

    @property
    def model(self) -> SignalModel: ...

    def inner(self, geometry: Geometry, blocks: Blocks) -> np.ndarray: ...


@dataclass(frozen=True, eq=False)
class Linearization:
    """Everything one pass over the data tells about a set of paths.

    Attributes
    ----------
    geometry : P paths
    blocks : their mode vectors and derivatives
    gain : (P,) optimal gains
    gram : (P, 7, P, 7) Gram matrix of signatures and derivatives
    inverse : (P, P) inverse Gram matrix of the signatures
    explained : energy explained by the paths, ``b^H G^-1 b``
    gradient : (P, 6) ``Re{conj(g) <d_a s, residual>}``
    quadrature : (P, 6) the imaginary part, which no move of the path removes
    """

    geometry: Geometry
    blocks: Blocks
    gain: np.typing.NDArray[np.complex128]
    gram: np.typing.NDArray[np.complex128]
    inverse: np.typing.NDArray[np.complex128]
    explained: float
    gradient: Float
    quadrature: Float

    @property
    def drop(self) -> Float:
        """(P,) energy lost when a path is removed without changing the others' parameters: ``|g|^2 /
        [G^-1]_pp``.
        """
        return np.abs(self.gain) ** 2 / np.maximum(np.diag(self.inverse).real, 1e-300)

    @property
    def coherence(self) -> Float:
        """(P, P) normalized inner products of the signatures, as :func:`~estimation.signal.algebra.coherence`."""
        return normalized(self.gram[:, 0, :, 0])

    @property
    def overlap(self) -> Float:
        """(P,) largest coherence of each signature with another one."""
        return (self.coherence - np.eye(len(self.gain))).max(axis=1, initial=0.0)

    def sorted(self, order) -> Linearization:
        """The same with the paths in another ``order`` (P,)."""
        return Linearization(
            self.geometry.take(order),
            [[mode[order] for mode in modes] for modes in self.blocks],
            self.gain[order],
            self.gram[order][:, :, order],
            self.inverse[order][:, order],
            self.explained,
            self.gradient[order],
            self.quadrature[order],
        )


def inverted(plain) -> np.ndarray:
    """Inverse of the signatures' Gram matrix (P, P), made regular.

    A step may take a path to where an element's pattern vanishes: it has no signature there, and its gain becomes 0.
    """
    own = np.real(np.diag(plain))
    return np.linalg.inv(plain + np.diag(np.where(own > 0, 1e-9 * own, 1.0)))


def linearize(data: Data, geometry: Geometry) -> Linearization:
    """Project the data on the paths' signatures and derivatives."""
    blocks = data.model.evaluate(geometry)
    inner = data.inner(geometry, blocks)
    matrix = gram(data.model, blocks)
    inverse = inverted(matrix[:, 0, :, 0])
    gain = inverse @ inner[:, 0]
    residual = inner - matrix[:, :, :, 0] @ gain
    slope = gain.conj()[:, None] * residual[:, 1:]
    explained = float(np.vdot(inner[:, 0], gain).real)
    return Linearization(geometry, blocks, gain, matrix, inverse, explained, np.real(slope), np.imag(slope))


def information(lin: Linearization, active) -> Float:
    """Gauss-Newton matrix (6P, 6P) with the gains eliminated; half of sigma^2 times the Fisher information."""
    matrix = np.real(tangent_gram(lin))
    idle = np.tile(~np.asarray(active), len(lin.gain))
    matrix[idle], matrix[:, idle] = 0.0, 0.0
    return matrix


def tangent_gram(lin: Linearization) -> np.ndarray:
    """Complex Gram matrix (6P, 6P) of the derivatives ``g d_a s``, what signatures span taken out."""
    paths = len(lin.gain)
    mixed = lin.gram[:, 0, :, 1:].reshape(paths, -1)
    weight = np.repeat(lin.gain, 6)
    full = lin.gram[:, 1:, :, 1:].reshape(6 * paths, 6 * paths) - mixed.conj().T @ (lin.inverse @ mixed)
    return weight.conj()[:, None] * full * weight


def metric(grams, active) -> Float:
    """Normalized information (..., 6, 6) of isolated paths from their Gram matrices (..., 7, 7): the
    ambiguity function's curvature.
    """
    # An element pattern may vanish where a path wandered to: no signal, no curvature.
    norm = grams[..., 0, 0].real[..., None, None]
    norm = np.where(norm > 0, norm, 1.0)
    cross = grams[..., 1:, :1] @ grams[..., :1, 1:]
    matrix = np.real(grams[..., 1:, 1:] - cross / norm) / norm
    return matrix * np.outer(active, active)


def bounded(step: Float, lengths: Float, limit: float) -> Float:
    """Steps (P, 6) shortened to at most ``limit`` in their own metrics (P, 6, 6)."""
    longest = np.sqrt(np.maximum(np.einsum("pa,pab,pb->p", step, lengths, step), 0))
    return step * np.minimum(1.0, limit / np.maximum(longest, 1e-300))[:, None]


def joint_fit(
    data: Data,
    start: Geometry | Linearization,
    noise_variance: float,
    tolerance: float = 0.02,
    iterations: int = 30,
    clock: Clock = ENDLESS,
) -> Linearization:
    """Joint Levenberg-Marquardt over all paths until the predicted gain in log-likelihood falls below
    ``tolerance``, or the time is up.
    """
    lin = start if isinstance(start, Linearization) else linearize(data, start)
    active = data.model.active
    damping = 1e-4
    for _ in range(iterations):
        if clock.over:
            break
        paths = len(lin.gain)
        lengths = metric(np.moveaxis(np.diagonal(lin.gram, axis1=0, axis2=2), -1, 0), active)
        matrix = information(lin, active)
        diagonal = np.diag(matrix).copy()
        diagonal[diagonal <= 0] = diagonal.max() if diagonal.max() > 0 else 1.0
        # Scaled to unit diagonal: delays in seconds beside angles would lose every digit otherwise.
        scale = 1 / np.sqrt(diagonal)
        scaled = matrix * np.outer(scale, scale) + damping * np.eye(6 * paths)
        gradient = lin.gradient.ravel() * np.tile(active, paths)
        step = scale * np.linalg.solve(scaled, scale * gradient)
        if gradient @ step < tolerance * noise_variance:
            break
        step = bounded(step.reshape(paths, 6), lengths, LARGEST_STEP)
        trial = linearize(data, lin.geometry.moved(step))
        # Single-precision projections carry an error of about 1e-7 of the explained energy; it must
        # not veto a good step.
        if trial.explained >= lin.explained * (1 - 1e-6):
            lin, damping = trial, max(damping / 10, 1e-7)
        else:
            damping = max(damping, 1e-3) * 10
            if damping > 1e6:
                break
    return lin
