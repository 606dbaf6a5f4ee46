"""Landmarks out of reach sleep: no step touches their covariances, and yet nothing is lost.

When a map has grown, the blocks that no detection can come from are put to rest. The joint Gaussian of that moment is kept
(the *snapshot*), and of its receiver a clone s₀ stays in the state of the recursion. With A = [s₀; x in work] and a sleeping
landmark b,

    b = m_b + G (A - m_A) + e,    G = P_bA P_AA⁻¹,

where e is independent of everything that happens to A afterwards: landmarks stand still, and what is detected later are they
and the receiver, not b. So the landmark's mean at any later time is m_b + G (m_A' - m_A), its covariances with whatever the
recursion then holds are G P'_A·, and its own is P_bb + G (P'_AA - P_AA) Gᵀ: exact (the compressed filter of Guivant and
Nebot), whenever somebody asks. A step asks for the means alone, to see whom the scan may come from; those wake. Misses,
sight and existence of sleepers follow every step, as if they were awake.

Blocks of A must stay as long as the snapshot is needed; one that is pruned becomes inert (kind `INERT`): rows without a
meaning of their own.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dopslam.compute.compiled import compiled, copy_matrix, copy_vector
from dopslam.slam.pmb.density import INERT, PMB, select, start_of

Array = NDArray[np.float64]

SLEEPING, AWAKE, GONE = 0, 1, 2
DEPENDENT = 1e-13  # share of its variance below which a row of A is a combination of the others


class Asleep(NamedTuple):
    """The snapshot, and what is known of its blocks without their positions.

    Attributes
    ----------
    mean, covariance : (n + 3S,), (n + 3S, n + 3S) arrays; receiver and S blocks at the time of the snapshot
    status : (S + 1,) int array; SLEEPING, AWAKE or GONE; entry 0 is the BS
    kind, weight, track, reference, detections, visible, unseen : (S + 1,) arrays; of the sleepers, as in `PMB`
    rows : (r,) int array; rows of the snapshot that belong to A, those of s₀ first
    factor : (r, r) array; lower Cholesky factor of P_AA (a row of zeros where one depends on those before)
    """

    mean: Array
    covariance: Array
    status: NDArray[np.int64]
    kind: NDArray[np.int64]
    weight: Array
    track: NDArray[np.int64]
    reference: Array
    detections: Array
    visible: Array
    unseen: Array
    rows: NDArray[np.int64]
    factor: Array


@compiled
def nobody(n):
    """No snapshot."""
    none, number = np.zeros(1), np.zeros(1, dtype=np.int64)
    return Asleep(
        np.zeros(n), np.zeros((n, n)), np.full(1, AWAKE), number, none, number, none, none, none, none,
        np.zeros(0, dtype=np.int64), np.zeros((0, 0)),
    )  # fmt: skip


@compiled
def sleepers(asleep):
    """How many blocks sleep."""
    count = 0
    for b in range(1, asleep.status.shape[0]):
        count += 1 if asleep.status[b] == SLEEPING else 0
    return count


@compiled
def places(density, n, asleep):
    """(r,) rows of the density where the rows of A are now."""
    size = asleep.mean.shape[0]
    now = np.full(size + 6, -1)  # behind the snapshot's own rows those of the clone, two blocks
    for b in range(1, density.origin.shape[0]):
        if density.origin[b] > 0:
            for i in range(3):
                now[start_of(n, density.origin[b]) + i] = start_of(n, b) + i
    result = np.empty(asleep.rows.shape[0], dtype=np.int64)
    for r in range(result.shape[0]):
        row = asleep.rows[r]
        result[r] = now[size + row] if row < n else now[row]
    return result


@compiled
def forward(factor, count, rows):
    """Overwrite `rows` (count, columns) with L⁻¹ rows; dependent rows give zero."""
    for i in range(count):
        for k in range(i):
            scale = factor[i, k]
            if scale != 0.0:
                for j in range(rows.shape[1]):
                    rows[i, j] -= scale * rows[k, j]
        scale = 1.0 / factor[i, i] if factor[i, i] > 0.0 else 0.0
        for j in range(rows.shape[1]):
            rows[i, j] *= scale


@compiled
def backward(factor, count, rows):
    """Overwrite `rows` (count, columns) with L⁻ᵀ rows; dependent rows give zero."""
    for i in range(count - 1, -1, -1):
        scale = 1.0 / factor[i, i] if factor[i, i] > 0.0 else 0.0
        for j in range(rows.shape[1]):
            rows[i, j] *= scale
        for k in range(i):
            weight = factor[i, k]
            if weight != 0.0:
                for j in range(rows.shape[1]):
                    rows[k, j] -= weight * rows[i, j]


@compiled
def extend(asleep, old):
    """Complete `factor` for the rows of A from number `old` on."""
    for i in range(old, asleep.rows.shape[0]):
        own = asleep.covariance[asleep.rows[i], asleep.rows[i]]
        square = own
        for j in range(i):
            value = asleep.covariance[asleep.rows[i], asleep.rows[j]]
            for k in range(j):
                value -= asleep.factor[i, k] * asleep.factor[j, k]
            value = value / asleep.factor[j, j] if asleep.factor[j, j] > 0.0 else 0.0
            asleep.factor[i, j] = value
            square -= value * value
        if square > DEPENDENT * own:
            asleep.factor[i, i] = math.sqrt(square)
        else:
            for j in range(i + 1):
                asleep.factor[i, j] = 0.0


@compiled
def positions_now(density, n, asleep):
    """(3S,) means of the sleepers' positions, given what became of A."""
    at = places(density, n, asleep)
    count = at.shape[0]
    moved = np.empty((count, 1))
    for r in range(count):
        moved[r, 0] = density.mean[at[r]] - asleep.mean[asleep.rows[r]]
    forward(asleep.factor, count, moved)
    backward(asleep.factor, count, moved)
    result = np.zeros(asleep.mean.shape[0] - n)
    for b in range(1, asleep.status.shape[0]):
        if asleep.status[b] == SLEEPING:
            for i in range(3):
                row = start_of(n, b) + i
                value = asleep.mean[row]
                for r in range(count):
                    value += asleep.covariance[row, asleep.rows[r]] * moved[r, 0]
                result[row - n] = value
    return result


@compiled
def bring_back(density, n, asleep, woken):
    """Append blocks of the snapshot to the density, with their covariances as they are by now, and to A."""
    size, more = density.mean.shape[0], 3 * woken.shape[0]
    at = places(density, n, asleep)
    old = at.shape[0]
    mean, covariance = np.empty(size + more), np.empty((size + more, size + more))
    copy_vector(density.mean, mean)
    copy_matrix(density.covariance, covariance)
    gain, moved = np.empty((old, more)), np.empty((old, 1))
    rows = np.empty(more, dtype=np.int64)
    for w in range(more):
        rows[w] = start_of(n, woken[w // 3]) + w % 3
    for r in range(old):
        moved[r, 0] = density.mean[at[r]] - asleep.mean[asleep.rows[r]]
        for w in range(more):
            gain[r, w] = asleep.covariance[asleep.rows[r], rows[w]]
    forward(asleep.factor, old, gain)
    left = np.zeros((more, more))  # P_bb - P_bA P_AA⁻¹ P_Ab
    for w in range(more):
        for v in range(w + 1):
            left[w, v] = asleep.covariance[rows[w], rows[v]]
        for r in range(old):
            g = gain[r, w]
            for v in range(w + 1):
                left[w, v] -= g * gain[r, v]
    backward(asleep.factor, old, gain)
    cross = np.zeros((more, size))
    for w in range(more):
        value = asleep.mean[rows[w]]
        for r in range(old):
            g = gain[r, w]
            value += g * moved[r, 0]
            for j in range(size):
                cross[w, j] += g * density.covariance[at[r], j]
        mean[size + w] = value
    for w in range(more):
        for j in range(size):
            covariance[size + w, j] = cross[w, j]
            covariance[j, size + w] = cross[w, j]
        for r in range(old):
            c = cross[w, at[r]]
            for v in range(w + 1):
                left[w, v] += c * gain[r, v]
        for v in range(w + 1):
            covariance[size + w, size + v] = left[w, v]
            covariance[size + v, size + w] = left[w, v]
    result = PMB(
        mean, covariance, joined(density.kind, asleep.kind, woken), joined(density.weight, asleep.weight, woken),
        joined(density.track, asleep.track, woken), joined(density.reference, asleep.reference, woken),
        joined(density.detections, asleep.detections, woken), joined(density.visible, asleep.visible, woken),
        joined(density.unseen, asleep.unseen, woken), joined(density.idle, np.zeros(asleep.kind.shape[0]), woken),
        joined(density.origin, order_of(asleep.kind.shape[0]), woken), density.trail,
    )  # fmt: skip
    all_rows, factor = np.empty(old + more, dtype=np.int64), np.zeros((old + more, old + more))
    copy_vector(asleep.rows, all_rows)
    copy_vector(rows, all_rows[old:])
    copy_matrix(asleep.factor, factor)
    following = Asleep(
        asleep.mean, asleep.covariance, asleep.status, asleep.kind, asleep.weight, asleep.track, asleep.reference,
        asleep.detections, asleep.visible, asleep.unseen, all_rows, factor,
    )  # fmt: skip
    extend(following, old)
    return result, following


@compiled
def order_of(count):
    """0 … count - 1."""
    return np.arange(count)


@compiled
def joined(first, second, index):
    """first, then second[index]."""
    result = np.empty(first.shape[0] + index.shape[0], dtype=first.dtype)
    copy_vector(first, result)
    for i in range(index.shape[0]):
        result[first.shape[0] + i] = second[index[i]]
    return result


@compiled
def whole(density, n, asleep):
    """The density with all sleepers back and nothing inert; the snapshot is needed no more."""
    everyone = np.empty(asleep.status.shape[0], dtype=np.int64)
    count = 0
    for b in range(1, asleep.status.shape[0]):
        if asleep.status[b] == SLEEPING:
            everyone[count] = b
            count += 1
    if count > 0:
        density, _ = bring_back(density, n, asleep, everyone[:count])
    alive = np.empty(density.kind.shape[0], dtype=np.int64)
    count = 0
    for b in range(alive.shape[0]):
        if density.kind[b] != INERT:
            alive[count] = b
            count += 1
    result = select(density, alive[:count])
    for b in range(count):
        result.origin[b] = 0
    return result
