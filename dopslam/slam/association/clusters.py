"""The γ best data associations cluster by cluster: exactly those of the whole, at the cost of its parts.

Measurements that no track explains, and groups of measurements and tracks that share no possible pair with others, are
decided for themselves; the best of the whole are the cheapest sums of one solution of every cluster. A pair that costs more
than the measurement's own column by more than `slack` is in no solution within `slack` of the best, and joins nothing.
"""

from __future__ import annotations

import numpy as np

from dopslam.compute.compiled import compiled, copy_vector
from dopslam.slam.association.murty import k_best


@compiled
def _root(parent, i):
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@compiled
def clusters(cost, alone, slack):
    """Connected components of measurements and tracks.

    Parameters
    ----------
    cost : (M, T) array; of a measurement stemming from a track, infinity forbids
    alone : (M,) array; of its stemming from none of them
    slack : float

    Returns
    -------
    label : (M + T,) int array; component of each measurement, then of each track, numbered from 0 in the order of their
        first measurements; -1 of a track without a measurement
    count : int
    """
    rows, columns = cost.shape
    parent = np.arange(rows + columns)
    for p in range(rows):
        for t in range(columns):
            if cost[p, t] <= alone[p] + slack and cost[p, t] < np.inf:
                a, b = _root(parent, p), _root(parent, rows + t)
                if a != b:
                    parent[max(a, b)] = min(a, b)
    label = np.full(rows + columns, -1)
    count = 0
    for p in range(rows):  # the root of a component is its first measurement
        root = _root(parent, p)
        if root == p:
            label[p] = count
            count += 1
        label[p] = label[root]
    for t in range(columns):
        root = _root(parent, rows + t)
        if root < rows:
            label[rows + t] = label[root]
    return label, count


@compiled
def k_best_of_clusters(cost, alone, k, slack):
    """The k cheapest associations, cheapest first, none dearer than the best by more than `slack`.

    Parameters
    ----------
    cost, alone, slack : as in :func:`clusters`
    k : int

    Returns
    -------
    totals : (g,) array, g ≤ k
    solutions : (g, M) int array; track of each measurement, -1 for none
    """
    rows, columns = cost.shape
    label, count = clusters(cost, alone, slack)
    totals, solutions = np.zeros(1), np.full((1, rows), -1)
    members, tracks = np.empty(rows, dtype=np.int64), np.empty(columns, dtype=np.int64)
    sums, left, right = np.empty(k * k), np.empty(k * k, dtype=np.int64), np.empty(k * k, dtype=np.int64)
    for c in range(count):
        m = n = 0
        for p in range(rows):
            if label[p] == c:
                members[m] = p
                m += 1
        for t in range(columns):
            if label[rows + t] == c:
                tracks[n] = t
                n += 1
        if n == 0:
            for g in range(totals.shape[0]):
                totals[g] += alone[members[0]]
            continue
        part = np.full((m, n + m), np.inf)
        for i in range(m):
            p = members[i]
            for j in range(n):
                if cost[p, tracks[j]] <= alone[p] + slack:
                    part[i, j] = cost[p, tracks[j]]
            part[i, n + i] = alone[p]
        own, choice = k_best(part, k, slack)
        pairs = 0
        for g in range(totals.shape[0]):
            for h in range(own.shape[0]):
                if totals[g] + own[h] <= totals[0] + own[0] + slack:
                    sums[pairs], left[pairs], right[pairs] = totals[g] + own[h], g, h
                    pairs += 1
        kept = min(k, pairs)
        new_totals, new_solutions = np.empty(kept), np.empty((kept, rows), dtype=np.int64)
        for g in range(kept):
            best = g
            for i in range(g + 1, pairs):
                if sums[i] < sums[best]:
                    best = i
            sums[g], sums[best] = sums[best], sums[g]
            left[g], left[best] = left[best], left[g]
            right[g], right[best] = right[best], right[g]
            new_totals[g] = sums[g]
            copy_vector(solutions[left[g]], new_solutions[g])
            for i in range(m):
                j = choice[right[g], i]
                new_solutions[g, members[i]] = tracks[j] if j < n else -1
        totals, solutions = new_totals, new_solutions
    return totals, solutions
