"""The posterior Cramér-Rao recursion (17) of paper A over (F, Q, information): one place for every bound.

The error of a run is `[s_k; x_1; …; x_L]`: a state that moves by `s_k = F_k s_{k-1} + w_k`, `w_k ~ N(0, Q_k)`, and
landmarks that stand still and have no prior information. Nothing here is inverted that may be singular:

* a state known exactly (zeros in the prior or in Q) leaves the recursion: the state's error is written `s = G u` with
  `G` a basis of the errors that are possible at all, and scaled so that `u` has unit covariance before each update.
  This departs from (17), whose `Q⁻¹` and `P₀⁻¹` need not exist, and agrees with it where they do;
* landmarks seen from too few rows have infinite bounds in the directions that nothing tells about.

`filtering` bounds the estimates of step k from the measurements up to k; `smoothing` from those of the whole run, or of
some steps more. The latter adds to the forward information of a step the backward information of all later ones, which is what the
elimination of the block-tridiagonal information matrix of the whole run from both its ends leaves (Rauch, Tung and
Striebel's smoother in information form; Fraser and Potter 1969).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dopslam.errors import FilterError

Array = NDArray[np.float64]

_RANK = 1e-11  # of singular values: below it a direction of the state's error counts as impossible
_REGULAR_PIVOT = 1e-15  # of a correlation matrix: below it a direction has no variance
_SAFE_PIVOT = 1e-12  # of a matrix with unit diagonal: above it the inverse is taken directly


@dataclass(frozen=True, slots=True)
class LinearizedRun:
    """A run linearized at the truth.

    Attributes
    ----------
    prior : (n, n) covariance of the state one step before the first; may be singular
    transition : (K, n, n) F_k, from the step before to step k
    noise : (K, n, n) Q_k; may be singular
    state : (K, n, n) Σ_i AᵢᵀRᵢ⁻¹Aᵢ over all measurements of a step
    cross : (K, L, n, d) AᵢᵀRᵢ⁻¹Bᵢ of every landmark that is to be estimated
    landmark : (K, L, d, d) BᵢᵀRᵢ⁻¹Bᵢ
    seen : (K, L) whether the landmark was detected at that step
    """

    prior: Array
    transition: Array
    noise: Array
    state: Array
    cross: Array
    landmark: Array
    seen: NDArray[np.bool_]

    def __post_init__(self) -> None:
        steps, count, n, d = self.cross.shape
        shapes = {
            "prior": (n, n), "transition": (steps, n, n), "noise": (steps, n, n), "state": (steps, n, n),
            "landmark": (steps, count, d, d), "seen": (steps, count),
        }  # fmt: skip
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise FilterError(f"LinearizedRun.{name} has shape {getattr(self, name).shape}; {shape} must agree")
        for name in ("prior", "transition", "noise", "state", "cross", "landmark"):
            if not np.isfinite(getattr(self, name)).all():
                raise FilterError(
                    f"LinearizedRun.{name} holds non-finite values: a state or an R of the run is at fault"
                )
        for name in ("prior", "noise"):
            if (np.diagonal(getattr(self, name), axis1=-2, axis2=-1) < 0).any():
                raise FilterError(f"LinearizedRun.{name} has a negative variance; a covariance is wanted")

    @property
    def size(self) -> int:
        """Rows of the whole error, n + L d."""
        return self.cross.shape[2] + self.cross.shape[1] * self.cross.shape[3]

    def information(self, step: int) -> Array:
        """Information (N, N) that the measurements of a step hold on state and landmarks."""
        _, count, n, d = self.cross.shape
        result = np.zeros((self.size, self.size))
        result[:n, :n] = self.state[step]
        for i in range(count):
            rows = slice(n + d * i, n + d * i + d)
            result[:n, rows] = self.cross[step, i]
            result[rows, :n] = self.cross[step, i].T
            result[rows, rows] = self.landmark[step, i]
        return result


def filtering(run: LinearizedRun) -> tuple[Array, Array]:
    """Bounds of what step k can know from the measurements up to k.

    Returns
    -------
    state : (K, n, n) block of J_k⁻¹
    landmark : (K, L, d, d) blocks; NaN before the first detection, inf on the diagonal where there is no bound
    """
    known = np.logical_or.accumulate(run.seen, axis=0)
    return _blocks(run, _forward(run), known)


def smoothing(run: LinearizedRun, lag: int | None = None) -> tuple[Array, Array]:
    """Bounds of what the measurements of the whole run tell about step k, or those up to step k + `lag`; shapes as of
    `filtering`.

    The landmarks stand still: from the whole run their bounds are the same at every step, save for rounding.
    """
    steps = len(run.state)
    parts = list(_forward(run))
    later = np.zeros((run.size, run.size))
    for k in reversed(range(steps)):
        if lag is not None:
            later = np.zeros((run.size, run.size))
            for j in range(min(k + lag, steps - 1), k, -1):
                later = _pulled_back(later + run.information(j), run.transition[j], run.noise[j])
        basis, information = parts[k]
        parts[k] = basis, information + _restricted(later, basis)
        if lag is None and k:
            later = _pulled_back(later + run.information(k), run.transition[k], run.noise[k])
    last = np.arange(steps) + (steps if lag is None else lag)
    known = np.logical_or.accumulate(run.seen, axis=0)[np.minimum(last, steps - 1)]
    return _blocks(run, iter(parts), known)


def _forward(run: LinearizedRun) -> Iterator[tuple[Array, Array]]:
    """Basis (n, r) and information (r + L d, r + L d) after the update of every step."""
    n, d = run.cross.shape[2:]
    basis = _root(run.prior)
    r = basis.shape[1]
    information = np.zeros((r + run.size - n, r + run.size - n))
    information[:r, :r] = np.eye(r)
    seen = np.zeros(run.seen.shape[1], bool)
    for k in range(len(run.state)):
        spread = _state_covariance(information, basis.shape[1], np.flatnonzero(seen), d)
        basis, information = _predicted(basis, information, spread, run.transition[k], run.noise[k])
        information = information + _restricted(run.information(k), basis)
        seen = seen | run.seen[k]
        yield basis, information


def _predicted(basis: Array, information: Array, spread: Array, transition: Array, noise: Array) -> tuple[Array, Array]:
    """Basis and information one step later, before its measurements; the new coordinates have unit covariance.

    Old coordinates (whitened by their covariance `spread`) and process noise together are independent errors of unit
    variance; they are turned so that those which make the new state come first, and the others are eliminated.
    """
    r, root, factor = basis.shape[1], _root(noise), _root(spread)
    columns = np.hstack([transition @ basis @ factor, root])
    scale = np.linalg.norm(columns, axis=1)
    moving, size = scale > 0, columns.shape[1]
    left, values, right = np.linalg.svd(columns[moving] / scale[moving, None], full_matrices=True)
    rank = int(np.sum(values > _RANK * values[0])) if values.size else 0
    new = np.zeros((len(scale), rank))
    new[moving] = scale[moving, None] * left[:, :rank] * values[:rank]
    own, rest = factor.shape[1], len(information) - r
    joint = np.zeros((size + rest, size + rest))
    joint[:own, :own] = factor.T @ information[:r, :r] @ factor
    joint[own:size, own:size] = np.eye(size - own)
    joint[:own, size:] = factor.T @ information[:r, r:]
    joint[size:, :own] = joint[:own, size:].T
    joint[size:, size:] = information[r:, r:]
    joint[:size] = right @ joint[:size]
    joint[:, :size] = joint[:, :size] @ right.T
    kept = np.concatenate([np.arange(rank), np.arange(size, size + rest)])
    moved = joint[np.ix_(kept, kept)]
    if rank < size:
        head = joint[kept, rank:size]
        moved = moved - head @ np.linalg.solve(joint[rank:size, rank:size], head.T)
    return new, 0.5 * (moved + moved.T)


def _state_covariance(information: Array, r: int, active: NDArray[np.int64], d: int) -> Array:
    """Covariance (r, r) of the state's coordinates, the landmarks seen so far eliminated."""
    covariance, _ = inverse(information[np.ix_(*2 * (_rows(r, active, d),))])
    return covariance[:r, :r]


def _rows(r: int, active: NDArray[np.int64], d: int) -> NDArray[np.int64]:
    return np.concatenate([np.arange(r), (r + d * active[:, None] + np.arange(d)).ravel()])


def _pulled_back(information: Array, transition: Array, noise: Array) -> Array:
    """Information on [s_{k-1}; x] from that on [s_k; x]: the process noise eliminated without its inverse."""
    n = len(noise)
    root = _root(noise)
    result = information
    if root.shape[1]:
        head = information[:, :n] @ root
        inner = np.eye(root.shape[1]) + root.T @ head[:n]
        result = information - head @ np.linalg.solve(inner, head.T)
    result = np.array(result)
    result[:n] = transition.T @ result[:n]
    result[:, :n] = result[:, :n] @ transition
    return 0.5 * (result + result.T)


def _restricted(information: Array, basis: Array) -> Array:
    """Information on [s; x] as information on [u; x], s = G u."""
    n, r = basis.shape
    rest = len(information) - n
    result = np.empty((r + rest, r + rest))
    result[:r, :r] = basis.T @ information[:n, :n] @ basis
    result[:r, r:] = basis.T @ information[:n, n:]
    result[r:, :r] = result[:r, r:].T
    result[r:, r:] = information[n:, n:]
    return result


def _blocks(run: LinearizedRun, parts: Iterator[tuple[Array, Array]], known: NDArray[np.bool_]) -> tuple[Array, Array]:
    steps, count, n, d = run.cross.shape
    state, landmark = np.empty((steps, n, n)), np.full((steps, count, d, d), np.nan)
    for k, (basis, information) in enumerate(parts):
        r = basis.shape[1]
        active = np.flatnonzero(known[k])
        covariance, free = inverse(information[np.ix_(*2 * (_rows(r, active, d),))])
        state[k] = basis @ covariance[:r, :r] @ basis.T
        covariance[free, free] = np.inf
        for j, i in enumerate(active):
            rows = slice(r + d * j, r + d * j + d)
            landmark[k, i] = covariance[rows, rows]
    return state, landmark


def _root(covariance: Array) -> Array:
    """Factor (n, r) with `root rootᵀ = covariance`, r its rank; scaled to a unit diagonal first."""
    scale = np.sqrt(np.diag(covariance))
    used = np.flatnonzero(scale > 0)
    correlation = covariance[np.ix_(used, used)] / scale[used, None] / scale[used]
    correlation = 0.5 * (correlation + correlation.T)
    try:
        factor = np.linalg.cholesky(correlation)
        regular = np.square(np.diag(factor)).min(initial=1.0) > _REGULAR_PIVOT
    except np.linalg.LinAlgError:
        regular = False
    if not regular:
        values, vectors = np.linalg.eigh(correlation)
        kept = values > _REGULAR_PIVOT
        factor = vectors[:, kept] * np.sqrt(values[kept])
    result = np.zeros((len(scale), factor.shape[1]))
    result[used] = scale[used, None] * factor
    return result


def inverse(information: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Inverse of an information matrix that may hold nothing on some directions.

    Scaled to a unit diagonal, since the entries span many orders of magnitude. Where the matrix is singular the
    pseudo-inverse is taken, which is the covariance of all that is observable.

    Returns
    -------
    covariance : (N, N) array
    free : (N,) bool; coordinates with a part in an unobserved direction: their variance is infinite
    """
    diagonal = np.diag(information)
    used = np.flatnonzero(diagonal > 0)
    covariance, free = np.zeros_like(information), np.ones(len(information), bool)
    scale = 1.0 / np.sqrt(diagonal[used])
    matrix = information[np.ix_(used, used)] * scale[:, None] * scale
    matrix = 0.5 * (matrix + matrix.T)
    try:
        sound = np.square(np.diag(np.linalg.cholesky(matrix))).min(initial=1.0) > _SAFE_PIVOT
    except np.linalg.LinAlgError:
        sound = False
    if sound:
        small, unseen = np.linalg.inv(matrix), np.zeros(len(used), bool)
    else:
        values, vectors = np.linalg.eigh(matrix)
        kept = values > _SAFE_PIVOT
        small = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
        unseen = np.square(vectors[:, ~kept]).sum(axis=1) > 1e-6
    covariance[np.ix_(used, used)] = small * scale[:, None] * scale
    free[used] = unseen
    return covariance, free
