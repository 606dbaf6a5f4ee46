"""Assignment and Murty's k best against enumeration and scipy."""

from itertools import permutations

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from dopslam.slam.association.clusters import clusters, k_best_of_clusters
from dopslam.slam.association.murty import assign, k_best


def slam_like(rng, rows, tracks, gated=0.6):
    """Costs as the filter makes them: tracks, then a private column per measurement."""
    cost = np.full((rows, tracks + rows), np.inf)
    shared = rng.normal(-3, 4, (rows, tracks))
    cost[:, :tracks] = np.where(rng.random((rows, tracks)) < gated, shared, np.inf)
    cost[np.arange(rows), tracks + np.arange(rows)] = rng.normal(0, 2, rows)
    return cost


def enumerate_all(cost):
    rows, columns = cost.shape
    totals = {}
    for choice in permutations(range(columns), rows):
        total = cost[np.arange(rows), list(choice)].sum()
        if np.isfinite(total):
            totals[choice] = total
    return sorted(totals.values()), totals


@pytest.mark.parametrize("seed", range(30))
def test_assignment_matches_scipy(seed):
    rng = np.random.default_rng(seed)
    rows = int(rng.integers(1, 9))
    cost = slam_like(rng, rows, int(rng.integers(0, 9)))
    total, columns, u, v = assign(cost)
    finite = np.where(np.isfinite(cost), cost, 1e6)
    row, column = linear_sum_assignment(finite)
    assert total == pytest.approx(finite[row, column].sum(), abs=1e-9)
    assert len(set(columns)) == rows
    reduced = cost - u[:, None] - v
    assert reduced.min() > -1e-9 and v.max() <= 0
    np.testing.assert_allclose(reduced[np.arange(rows), columns], 0, atol=1e-9)


@pytest.mark.parametrize("seed", range(30))
@pytest.mark.parametrize("k", [1, 3, 10, 60])
def test_k_best_matches_enumeration(seed, k):
    rng = np.random.default_rng(seed)
    rows = int(rng.integers(1, 5))
    cost = slam_like(rng, rows, int(rng.integers(0, 4)))
    totals, solutions = k_best(cost, k, np.inf)
    expected, every = enumerate_all(cost)
    np.testing.assert_allclose(totals, expected[:k], atol=1e-9)
    for total, solution in zip(totals, solutions, strict=True):
        assert every[tuple(int(c) for c in solution)] == pytest.approx(total, abs=1e-9)
    assert len({tuple(s) for s in solutions}) == len(solutions)


def test_slack_only_cuts_the_tail():
    cost = slam_like(np.random.default_rng(5), 5, 4)
    totals, _ = k_best(cost, 40, np.inf)
    cut, _ = k_best(cost, 40, 6.0)
    np.testing.assert_allclose(cut, totals[totals <= totals[0] + 6.0])


def test_nothing_to_assign_and_nothing_possible():
    totals, solutions = k_best(np.empty((0, 3)), 5, 10.0)
    assert totals.tolist() == [0.0] and solutions.shape == (1, 0)
    assert assign(np.full((1, 2), np.inf))[0] == np.inf
    assert len(k_best(np.full((1, 2), np.inf), 3, 10.0)[0]) == 0


@pytest.mark.parametrize("density", [0.05, 0.15, 0.4])
def test_clusters_give_what_the_whole_gives(density):
    """Murty over the whole matrix against the cheapest sums over connected components, sparse and not so sparse."""
    rng = np.random.default_rng(int(100 * density))
    for _ in range(60):
        rows, columns = rng.integers(0, 9), rng.integers(1, 12)
        cost = np.where(rng.random((rows, columns)) < density, rng.normal(0, 4, (rows, columns)), np.inf)
        alone = rng.normal(2, 3, rows)
        whole = np.full((rows, columns + rows), np.inf)
        whole[:, :columns] = cost
        whole[np.arange(rows), columns + np.arange(rows)] = alone
        totals, solutions = k_best(whole, 7, 9.0)
        own, choice = k_best_of_clusters(cost, alone, 7, 9.0)
        np.testing.assert_allclose(own, totals, rtol=1e-12, atol=1e-12)
        np.testing.assert_array_equal(choice, np.where(solutions < columns, solutions, -1))


def test_components_share_no_pair():
    cost = np.array([[1.0, np.inf, np.inf, np.inf], [np.inf, 2.0, np.inf, np.inf], [np.inf, 0.0, 40.0, np.inf]])
    label, count = clusters(cost, np.zeros(3), 10.0)
    assert count == 2 and label.tolist() == [0, 1, 1, 0, 1, -1, -1]
