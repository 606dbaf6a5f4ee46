"""Sparse normal equations of a run, solved by eliminating the pose chain block by block.

The unknowns are poses s_0 … s_K, tied to their neighbors by the motion, and landmarks x_j, tied to the poses they are
seen from. Poses leave in their order and each landmark after its last sighting, so that the dense part of the
elimination (the *front*) holds one pose and the landmarks in sight: linear in the length of a run for a map that is
passed by, and a dense Cholesky of what is left for one that is seen all along. A landmark seen again much later stays
in the front between: that is a loop closure.

Every elimination leaves rows of the square-root information matrix, U x_e + Y x_rest = y. Reading them backwards gives
the solution, and, with P over the front, the marginal covariances: W = U⁻¹Y, P_er = −W P_rr,
P_ee = U⁻¹U⁻ᵀ − P_er Wᵀ (Golub and Plemmons 1980; Kaess and Dellaert 2009).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dopslam.compute.compiled import compiled

Array = NDArray[np.float64]
Index = NDArray[np.int64]

POINT = 3  # coordinates of a landmark


class Plan(NamedTuple):
    """Order of elimination of a run's unknowns; made once for an association.

    Attributes
    ----------
    unknown : (E,) int array; eliminated one after the other: k for pose k, K + 1 + j for landmark j
    place : (E,) int array; first row of each unknown in the front
    edges : (E + 1,) int array; columns of elimination e are `column[edges[e]:edges[e + 1]]`
    column : int array; rows of the front that are left
    enter : (L,) int array; landmarks in the order in which they come into sight
    first : (L,) int array; pose from which each landmark is first seen
    size : int; rows of the front
    """

    unknown: Index
    place: Index
    edges: Index
    column: Index
    enter: Index
    first: Index
    size: int


def plan(poses: int, dimension: int, first: Index, last: Index) -> Plan:
    """Order of elimination.

    Parameters
    ----------
    poses : number of poses K + 1
    dimension : coordinates of a pose
    first, last : (L,) poses from which each landmark is first and last seen
    """
    leaving = np.split(np.argsort(last, kind="stable"), np.searchsorted(np.sort(last), np.arange(1, poses)))
    enter = np.argsort(first, kind="stable")
    coming = np.split(enter, np.searchsorted(first[enter], np.arange(1, poses)))
    base = 2 * dimension  # two poses take turns
    slot, free, used = np.full(len(first), -1), [], 0
    unknown, place, column, counts = [], [], [], []
    active: dict[int, None] = {}

    def rows(start: int, size: int) -> list[int]:
        return list(range(start, start + size))

    for k in range(poses):
        own = dimension * (k % 2)
        for j in coming[k].tolist():
            if not free:
                free.append(used)
                used += 1
            slot[j] = base + POINT * free.pop()
            active[j] = None
        for j in leaving[k].tolist():
            del active[j]
            rest = rows(own, dimension) + [r for i in active for r in rows(slot[i], POINT)]
            unknown.append(poses + j)
            place.append(slot[j])
            counts.append(len(rest))
            column += rest
            free.append((slot[j] - base) // POINT)
        rest = rows(dimension * ((k + 1) % 2), dimension) if k + 1 < poses else []
        rest += [r for i in active for r in rows(slot[i], POINT)]
        unknown.append(k)
        place.append(own)
        counts.append(len(rest))
        column += rest
    edges = np.concatenate([[0], np.cumsum(counts)])
    lists = (unknown, place, edges, column, enter, first)
    a, b, c, d, e, f = (np.array(numbers, dtype=np.int64) for numbers in lists)
    return Plan(a, b, c, d, e, f, base + POINT * used)


@compiled
def _eliminate(front, vector, at, size, column, upper, rows, right):
    """Take rows at … at + size out of the front; returns the sum of logarithms of the pivots, nan if one fails."""
    total = 0.0
    width = column.shape[0]
    for i in range(size):
        for j in range(i, size):
            upper[i, j] = front[at + i, at + j]
        for c in range(width):
            rows[i, c] = front[at + i, column[c]]
        right[i] = vector[at + i]
    for i in range(size):
        for k in range(i):
            w = upper[k, i]
            if w != 0.0:
                for j in range(i, size):
                    upper[i, j] -= w * upper[k, j]
                for c in range(width):
                    rows[i, c] -= w * rows[k, c]
                right[i] -= w * right[k]
        pivot = upper[i, i]
        if not pivot > 0.0:
            return np.nan
        total += np.log(pivot)
        scale = 1.0 / np.sqrt(pivot)
        for j in range(i, size):
            upper[i, j] *= scale
        for c in range(width):
            rows[i, c] *= scale
        right[i] *= scale
    for i in range(size):
        for a in range(width):
            w = rows[i, a]
            if w != 0.0:
                r = column[a]
                vector[r] -= w * right[i]
                for c in range(width):
                    front[r, column[c]] -= w * rows[i, c]
    for i in range(size):  # the place is free for the next unknown
        vector[at + i] = 0.0
        for j in range(front.shape[0]):
            front[at + i, j] = 0.0
            front[j, at + i] = 0.0
    return total


@compiled
def _forward(unknown, place, edges, column, enter, first, size, pose, tie, point, cross, owner, offsets, by_pose,
             by_point, damping):  # fmt: skip
    poses, n = by_pose.shape
    count = unknown.shape[0]
    slot = np.empty(point.shape[0], dtype=np.int64)
    for e in range(count):
        if unknown[e] >= poses:
            slot[unknown[e] - poses] = place[e]
    upper = np.zeros((count, max(n, POINT), max(n, POINT)))
    stored = 0
    for e in range(count):
        stored += (edges[e + 1] - edges[e]) * (n if unknown[e] < poses else POINT)
    rows, right = np.empty(stored), np.zeros((count, max(n, POINT)))
    front, vector = np.zeros((size, size)), np.zeros(size)
    total, entered, begin, k, fresh = 0.0, 0, 0, 0, True
    for e in range(count):
        if fresh:
            fresh = False
            own, following = n * (k % 2), n * ((k + 1) % 2)
            for i in range(n):
                vector[own + i] += by_pose[k, i]
                for j in range(n):
                    front[own + i, own + j] += pose[k, i, j]
                front[own + i, own + i] += damping * pose[k, i, i]
            if k + 1 < poses:
                for i in range(n):
                    for j in range(n):
                        front[own + i, following + j] += tie[k, i, j]
                        front[following + j, own + i] += tie[k, i, j]
            while entered < enter.shape[0] and first[enter[entered]] == k:
                j = enter[entered]
                entered += 1
                for i in range(POINT):
                    vector[slot[j] + i] = by_point[j, i]
                    for m in range(POINT):
                        front[slot[j] + i, slot[j] + m] = point[j, i, m]
                    front[slot[j] + i, slot[j] + i] += damping * point[j, i, i]
            for row in range(offsets[k], offsets[k + 1]):
                j = owner[row]
                if j >= 0:
                    for i in range(n):
                        for m in range(POINT):
                            front[own + i, slot[j] + m] += cross[row, i, m]
                            front[slot[j] + m, own + i] += cross[row, i, m]
        block = n if unknown[e] < poses else POINT
        width = edges[e + 1] - edges[e]
        end = begin + block * width
        logs = _eliminate(
            front, vector, place[e], block, column[edges[e] : edges[e + 1]], upper[e],
            rows[begin:end].reshape(block, width), right[e],
        )  # fmt: skip
        if logs != logs:
            return upper, rows, right, np.nan
        total += logs
        begin = end
        if unknown[e] < poses:
            k += 1
            fresh = True
    return upper, rows, right, total


@compiled
def _backward(unknown, place, edges, column, size, upper, rows, right, poses, n, points, spread):
    """Solution and, where `spread`, marginal covariances of poses and landmarks."""
    count = unknown.shape[0]
    value, covariance = np.zeros(size), np.zeros((size if spread else 1, size if spread else 1))
    pose, point = np.zeros((poses, n)), np.zeros((points, POINT))
    pose_covariance = np.zeros((poses if spread else 0, n, n))
    point_covariance = np.zeros((points if spread else 0, POINT, POINT))
    end = rows.shape[0]
    for e in range(count - 1, -1, -1):
        is_pose = unknown[e] < poses
        block = n if is_pose else POINT
        at, columns = place[e], column[edges[e] : edges[e + 1]]
        width = columns.shape[0]
        begin = end - block * width
        y = rows[begin:end].reshape(block, width)
        u = upper[e]
        for i in range(block - 1, -1, -1):
            total = right[e, i]
            for c in range(width):
                total -= y[i, c] * value[columns[c]]
            for j in range(i + 1, block):
                total -= u[i, j] * value[at + j]
            value[at + i] = total / u[i, i]
        for i in range(block):
            if is_pose:
                pose[unknown[e], i] = value[at + i]
            else:
                point[unknown[e] - poses, i] = value[at + i]
        if spread:
            w, inverse = np.empty((block, width)), np.zeros((block, block))
            for i in range(block - 1, -1, -1):
                for c in range(width):
                    total = y[i, c]
                    for j in range(i + 1, block):
                        total -= u[i, j] * w[j, c]
                    w[i, c] = total / u[i, i]
                for m in range(i, block):
                    total = 1.0 if m == i else 0.0
                    for j in range(i + 1, m + 1):
                        total -= u[i, j] * inverse[j, m]
                    inverse[i, m] = total / u[i, i]
            across = np.zeros((block, width))
            for i in range(block):
                for a in range(width):
                    f = w[i, a]
                    if f != 0.0:
                        r = columns[a]
                        for c in range(width):
                            across[i, c] -= f * covariance[r, columns[c]]
            for i in range(block):
                for c in range(width):
                    covariance[at + i, columns[c]] = across[i, c]
                    covariance[columns[c], at + i] = across[i, c]
                for j in range(i + 1):
                    total = 0.0
                    for m in range(i, block):
                        total += inverse[i, m] * inverse[j, m]
                    for c in range(width):
                        total -= across[i, c] * w[j, c]
                    covariance[at + i, at + j] = total
                    covariance[at + j, at + i] = total
            for i in range(block):
                for j in range(block):
                    if is_pose:
                        pose_covariance[unknown[e], i, j] = covariance[at + i, at + j]
                    else:
                        point_covariance[unknown[e] - poses, i, j] = covariance[at + i, at + j]
        end = begin
    return pose, point, pose_covariance, point_covariance


class Normal(NamedTuple):
    """Normal equations of a run.

    Attributes
    ----------
    pose : (K + 1, n, n) information of each pose
    tie : (K, n, n) information between pose k and k + 1
    point : (L, 3, 3) information of each landmark
    cross : (M, n, 3) information between the pose and the landmark of each sighting, sorted by pose
    owner : (M,) landmark of each sighting, -1 if none
    offsets : (K + 2,) sightings of pose k are rows offsets[k]:offsets[k + 1]
    by_pose, by_point : (K + 1, n), (L, 3) right side
    """

    pose: Array
    tie: Array
    point: Array
    cross: Array
    owner: Index
    offsets: Index
    by_pose: Array
    by_point: Array


class Solution(NamedTuple):
    """Poses (K + 1, n) and landmarks (L, 3), their covariances if asked for, and log |information|."""

    pose: Array
    point: Array
    pose_covariance: Array
    point_covariance: Array
    log_determinant: float


def solve(order: Plan, normal: Normal, damping: float = 0.0, spread: bool = False) -> Solution | None:
    """Solve the normal equations; None if the matrix is not positive definite.

    Parameters
    ----------
    order : Plan
    normal : Normal
    damping : float
        Multiple of the diagonal that is added (Levenberg and Marquardt).
    spread : bool
        Whether the marginal covariances are wanted.
    """
    poses, n = normal.by_pose.shape
    upper, rows, right, logs = _forward(*order, *normal, damping)
    if not np.isfinite(logs):
        return None
    found = _backward(
        order.unknown, order.place, order.edges, order.column, order.size, upper, rows, right, poses, n,
        len(normal.by_point), spread,
    )  # fmt: skip
    pose, point, pose_covariance, point_covariance = found
    return Solution(pose, point, pose_covariance, point_covariance, logs)
