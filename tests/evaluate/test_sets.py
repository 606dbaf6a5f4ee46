"""OSPA and T-GOSPA against hand computation, against GOSPA, against enumeration, and as metrics."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dopslam.errors import DopslamError
from dopslam.evaluate.metrics import gospa
from dopslam.evaluate.sets import ospa, trajectory_gospa

C, P, G = 5.0, 2.0, 1.5


def test_ospa_by_hand():
    truth = np.array([[0.0, 0], [10, 0]])
    assert ospa(truth, truth, C) == 0
    assert ospa(truth, truth[:1], C) == pytest.approx(np.sqrt(25 / 2))
    assert ospa(truth, np.array([[0.0, 3], [10, 40]]), C) == pytest.approx(np.sqrt((9 + 25) / 2))
    assert ospa(truth, np.zeros((0, 2)), C) == C and ospa(np.zeros((0, 2)), np.zeros((0, 2)), C) == 0
    with pytest.raises(DopslamError, match="cutoff 0"):
        ospa(truth, truth, 0.0)


def test_one_step_is_gospa():
    rng = np.random.default_rng(0)
    for _ in range(20):
        truth, estimate = (rng.uniform(0, 12, (rng.integers(0, 5), 2)) for _ in range(2))
        found, known = trajectory_gospa(truth[:, None], estimate[:, None], C, P, G), gospa(truth, estimate, C, P)
        assert found.distance == pytest.approx(known.distance, abs=1e-9) and found.switch == 0
        assert found.localization + found.missed + found.false == pytest.approx(
            known.localization + known.missed + known.false, abs=1e-9
        )


def test_a_change_of_partner_costs_the_switch_once():
    truth = np.array([[[0.0, 0], [0, 0], [0, 0], [0, 0]]])
    nan = [np.nan, np.nan]
    estimate = np.array([[[0.0, 1], [0, 1], nan, nan], [nan, nan, [0, 1], [0, 1]]])
    found = trajectory_gospa(truth, estimate, C, P, G)
    assert found.localization == pytest.approx(4) and found.switch == pytest.approx(G**P)
    assert found.missed == pytest.approx(0) and found.false == pytest.approx(0)
    whole = trajectory_gospa(truth, np.array([[[0.0, 1]] * 4]), C, P, G)
    assert whole.switch == 0 and whole.distance == pytest.approx(2)


def test_a_gap_is_missed_and_what_goes_on_is_false():
    truth = np.array([[[0.0, 0], [0, 0], [np.nan, np.nan]]])
    estimate = np.array([[[0.0, 0], [np.nan, np.nan], [0, 0]]])
    found = trajectory_gospa(truth, estimate, C, P, G)
    assert (found.missed, found.false) == (pytest.approx(C**P / 2), pytest.approx(C**P / 2))


def enumerated(truth, estimate):
    """The least cost over all sequences of one-to-one assignments; what the linear program relaxes."""
    steps = truth.shape[1]
    here, there = (np.isfinite(x).all(axis=2) for x in (truth, estimate))
    choices = [
        c
        for c in product(range(-1, len(estimate)), repeat=len(truth))
        if len({x for x in c if x >= 0}) == sum(x >= 0 for x in c)
    ]

    def cost(k, choice):
        total = 0.0
        for i, j in enumerate(choice):
            if j >= 0 and here[i, k] and there[j, k]:
                total += min(np.linalg.norm(truth[i, k] - estimate[j, k]), C) ** P
            else:
                total += C**P / 2 * (here[i, k] + (j >= 0 and there[j, k]))
        return total + C**P / 2 * sum(there[j, k] for j in range(len(estimate)) if j not in choice)

    def change(a, b):
        pairs = [{(i, j) for i, j in enumerate(x) if j >= 0} for x in (a, b)]
        return G**P / 2 * len(pairs[0] ^ pairs[1])

    best = {c: cost(0, c) for c in choices}
    for k in range(1, steps):
        best = {c: cost(k, c) + min(v + change(a, c) for a, v in best.items()) for c in choices}
    return min(best.values()) ** (1 / P)


def test_the_program_finds_what_enumeration_finds():
    rng = np.random.default_rng(3)
    equal = 0
    for _ in range(25):
        truth, estimate = (rng.uniform(0, 8, (n, 4, 2)) for n in rng.integers(1, 3, 2))
        for x in (truth, estimate):
            x[rng.random(x.shape[:2]) < 0.2] = np.nan
        found, least = trajectory_gospa(truth, estimate, C, P, G).distance, enumerated(truth, estimate)
        assert found <= least + 1e-9
        equal += found == pytest.approx(least, abs=1e-8)
    assert equal >= 23  # the relaxation is seldom below it


@given(st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_it_is_a_metric(seed):
    rng = np.random.default_rng(seed)
    a, b, c = (rng.uniform(0, 8, (n, 3, 2)) for n in rng.integers(0, 4, 3))
    ab, ba, ac, cb = (trajectory_gospa(x, y, C, P, G).distance for x, y in ((a, b), (b, a), (a, c), (c, b)))
    assert ab == pytest.approx(ba, abs=1e-7) and ab <= ac + cb + 1e-7
    assert trajectory_gospa(a, a[::-1], C, P, G).distance == pytest.approx(0, abs=1e-6)
    points = [x[:, 0] for x in (a, b, c)]
    assert ospa(points[0], points[1], C) <= ospa(points[0], points[2], C) + ospa(points[2], points[1], C) + 1e-9


def test_tracks_of_a_map_become_trajectories_with_gaps():
    from dopslam.evaluate.community import trajectories
    from dopslam.records import Kind
    from dopslam.slam.history import COLUMNS, history_of

    table = np.zeros((3, COLUMNS))
    table[:, 0], table[:, 12], table[:, 13] = [7.0, 8.0, 9.0], 0.9, Kind.SP
    table[:, 14] = [4, 2, 4]
    history = history_of(np.zeros((3, 4)), np.zeros((3, 4, 4)), np.array([0, 2, 2, 3]), table)
    found = trajectories(history, Kind.SP, 0.5)
    np.testing.assert_array_equal(found[:, :, 0], [[8, np.nan, np.nan], [7, np.nan, 9]])
    assert trajectories(history, Kind.VA, 0.5).shape == (0, 3, 3)
