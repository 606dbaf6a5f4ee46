"""What became of the landmarks of a run, on maps made by hand; intervals of shares; verdicts."""

import numpy as np
import pytest

from dopslam.evaluate.mapping import STEPS, fate, steps_seen
from dopslam.records import Kind, Landmarks
from dopslam.slam.history import history_of
from dopslam.studies.scenes import verdict
from estimation.statistics import median, share

LANDMARKS = Landmarks(
    name=np.array(["BS", "VA a", "VA b", "VA a > b", "SP p"]),
    kind=np.array([Kind.BS, Kind.VA, Kind.VA, Kind.VA, Kind.SP], dtype=np.int8),
    position=np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0], [10, 10, 0], [3, 3, 3]], float),
    order=np.array([0, 1, 1, 2, 1]),
)


def row(position, kind, std=0.1, existence=0.9):
    line = np.zeros(15 + len(Kind))
    line[:3], line[3:12], line[12], line[13] = position, (std**2 * np.eye(3)).ravel(), existence, kind
    return line


def judged(*maps):
    table = np.array([line for rows in maps for line in rows]).reshape(-1, 15 + len(Kind))
    edges = np.concatenate([[0], np.cumsum([len(rows) for rows in maps])])
    steps = len(maps)
    history = history_of(np.zeros((steps, 4)), np.tile(np.eye(4), (steps, 1, 1)), edges, table)
    return fate(LANDMARKS, history, 0.5, *steps_seen(None, None, LANDMARKS, 10.0))


def test_a_landmark_that_was_mapped_and_is_gone_counts_as_ever_only():
    figures = judged([row([10, 0, 0], Kind.VA), row([3, 3, 3], Kind.SP)], [row([10, 0.5, 0], Kind.VA)]).figures(
        LANDMARKS
    )
    assert (figures["landmarks_visible"], figures["landmarks_ever"], figures["landmarks_found"]) == (3, 2, 1)
    assert figures["false_landmarks"] == 0


def test_within_a_meter_or_three_sigma_one_to_one_and_of_the_right_kind():
    near, far, sure = row([10, 0.9, 0], Kind.VA), row([0, 16, 0], Kind.VA, std=2.5), row([0, 16, 0], Kind.VA)
    assert judged([near, far]).found.tolist() == [False, True, True, False, False]
    assert judged([near, sure]).found.tolist() == [False, True, False, False, False]
    twice = judged([near, row([10, -0.2, 0], Kind.VA)])
    assert len(twice.false) == 1 and np.allclose(twice.false[0], [10, 0.9, 0])
    assert len(judged([row([10, 0, 0], Kind.SP)]).false) == 1
    assert len(judged([row([50, 0, 0], Kind.VA, existence=0.4)]).false) == 0


def test_second_reflections_are_counted_by_themselves_and_are_not_false():
    figures = judged([row([10, 10, 0], Kind.VA)]).figures(LANDMARKS)
    assert figures["second_reflections_found"] == figures["second_reflections_visible"] == 1
    assert figures["landmarks_found"] == figures["false_landmarks"] == 0


def test_intervals_of_shares_and_medians():
    assert share(0, 25)["high"] == pytest.approx(1 - 0.025 ** (1 / 25))
    assert share(54, 60)["low"] == pytest.approx(0.795, abs=0.005)  # Clopper and Pearson
    rng = np.random.default_rng(0)
    inside = [median(rng.normal(size=31)) for _ in range(400)]
    covered = np.mean([m["low"] <= 0 <= m["high"] for m in inside])
    assert 0.93 < covered <= 1.0


def result(**changes):
    good = {
        "rmse_over_bound": {"position": 1.0}, "nees": 4.0, "landmarks_visible": 10, "landmarks_found": 9,
        "false_landmarks": 1, "detections": {"nees_over_6": 1.0, "false_per_snapshot": 0.0}, "detection_outliers": 0.0,
        "diverged": False, "lost": {"forgotten": 1, "not resolved": 0, "never mapped": 0},
    }  # fmt: skip
    return good | changes


def test_the_first_thing_that_went_wrong_is_named():
    assert verdict(result()) == ([], "")
    assert verdict(result(landmarks_found=7, lost={"forgotten": 3}))[1].startswith("landmarks forgotten")
    failures, cause = verdict(
        result(nees=80.0, detections={"nees_over_6": 9.0, "false_per_snapshot": 0}, detection_outliers=0.3)
    )
    assert failures == ["NEES"] and "30% outliers" in cause
    assert verdict(result(false_landmarks=2))[0] == ["false landmarks"]
    assert verdict({"error": "no", "stage": "trace"}) == (["no result"], "trace: no")
    assert STEPS == 3
