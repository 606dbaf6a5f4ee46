"""The γ best data associations: an optimal assignment and Murty's partition over it.

Rows are measurements, columns are things a measurement can come from; every row must be assigned, columns
may stay free. Forbidden pairs cost infinity.
"""

from __future__ import annotations

import numpy as np

from dopslam.compute.compiled import compiled, copy_matrix, copy_vector


@compiled
def _augment(cost, row_of, u, v, row):
    """Dijkstra from `row` to the nearest free column over reduced costs.

    Returns the path's length (infinity if there is none), its last column, and the distances, predecessors
    and settled columns that the dual update needs.
    """
    columns = cost.shape[1]
    distance = np.full(columns, np.inf)
    before = np.full(columns, -1)
    done = np.zeros(columns, dtype=np.bool_)
    current, base = row, 0.0
    while True:
        for j in range(columns):
            if not done[j]:
                through = base + cost[current, j] - u[current] - v[j]
                if through < distance[j]:
                    distance[j] = through
                    before[j] = current
        best, nearest = np.inf, -1
        for j in range(columns):
            if not done[j] and distance[j] < best:
                best, nearest = distance[j], j
        if nearest < 0:
            return np.inf, -1, distance, before, done
        if row_of[nearest] < 0:
            return best, nearest, distance, before, done
        done[nearest] = True
        current, base = row_of[nearest], best


@compiled
def assign(cost):
    """Cheapest assignment of every row to a column of its own (Jonker-Volgenant, shortest augmenting paths).

    Parameters
    ----------
    cost : (rows, columns) array, columns ≥ rows; infinity forbids

    Returns
    -------
    total : float, infinity if there is no assignment
    column_of : (rows,) int array
    u, v : (rows,), (columns,) arrays; dual variables: cost - u - v ≥ 0, zero on assigned pairs, v ≤ 0
    """
    rows, columns = cost.shape
    row_of = np.full(columns, -1)
    column_of = np.full(rows, -1)
    u = np.zeros(rows)
    v = np.zeros(columns)
    for row in range(rows):
        length, sink, distance, before, done = _augment(cost, row_of, u, v, row)
        if sink < 0:
            return np.inf, column_of, u, v
        u[row] += length
        for j in range(columns):
            if done[j]:
                u[row_of[j]] += length - distance[j]
                v[j] -= length - distance[j]
        j = sink
        while True:
            i = before[j]
            row_of[j] = i
            previous = column_of[i]
            column_of[i] = j
            if i == row:
                break
            j = previous
    total = 0.0
    for i in range(rows):
        total += cost[i, column_of[i]]
    return total, column_of, u, v


@compiled
def k_best(cost, k, slack):
    """The k cheapest assignments, cheapest first (Murty), none dearer than the best by more than `slack`.

    Parameters
    ----------
    cost : (rows, columns) array; infinity forbids
    k : int
    slack : float

    Returns
    -------
    totals : (g,) array, g ≤ k
    solutions : (g, rows) int array of columns
    """
    rows, columns = cost.shape
    totals = np.empty(k)
    solutions = np.empty((k, rows), dtype=np.int64)
    best, column_of, u, v = assign(cost)
    if rows == 0 or best == np.inf:
        totals[0] = 0.0 if rows == 0 else np.inf
        return totals[: 1 if rows == 0 else 0], solutions[: 1 if rows == 0 else 0]
    # Candidates: cost, solution, the rows fixed in their parent (a prefix) and the pairs forbidden so far.
    # Never more are stored than can still be asked for.
    room = k + rows
    candidate_total = np.full(room, np.inf)
    candidate = np.empty((room, rows), dtype=np.int64)
    prefix = np.zeros(room, dtype=np.int64)
    forbidden = np.zeros((room, rows, columns), dtype=np.bool_)
    # cost - u - v with the root's duals: what a pair adds to the best total at least, so that most children
    # are dismissed without solving them.
    reduced = np.empty((rows, columns))
    for i in range(rows):
        for j in range(columns):
            reduced[i, j] = cost[i, j] - u[i] - v[j]
    candidate_total[0] = best
    copy_vector(column_of, candidate[0])
    found = 0
    work = np.empty((rows, columns))
    while found < k:
        top = np.argmin(candidate_total)
        if candidate_total[top] == np.inf or candidate_total[top] > best + slack:
            break
        totals[found] = candidate_total[top]
        copy_vector(candidate[top], solutions[found])
        found += 1
        if found == k:
            break
        parent = candidate[top].copy()
        banned = forbidden[top].copy()
        fixed = prefix[top]
        candidate_total[top] = np.inf
        slot = np.argmax(candidate_total)  # an empty slot, or the dearest candidate
        at_least, base = best, 0.0
        for branch in range(rows):  # rows before `branch` keep the parent's columns, `branch` must not
            if branch >= fixed:
                cheapest = np.inf
                for j in range(columns):
                    if j != parent[branch] and not banned[branch, j]:
                        cheapest = min(cheapest, reduced[branch, j])
                limit = min(best + slack, candidate_total[slot])
                if at_least + cheapest < limit:
                    for i in range(branch, rows):
                        for j in range(columns):
                            work[i, j] = np.inf if banned[i, j] else cost[i, j]
                        for j in range(branch):
                            work[i, parent[j]] = np.inf
                    work[branch, parent[branch]] = np.inf
                    sub_total, sub, _, _ = assign(work[branch:])
                    if base + sub_total < limit:
                        candidate_total[slot] = base + sub_total
                        copy_vector(parent[:branch], candidate[slot])
                        copy_vector(sub, candidate[slot, branch:])
                        prefix[slot] = branch
                        copy_matrix(banned, forbidden[slot])
                        forbidden[slot, branch, parent[branch]] = True
                        slot = np.argmax(candidate_total)
            base += cost[branch, parent[branch]]
            at_least += max(reduced[branch, parent[branch]], 0.0)
    return totals[:found], solutions[:found]
