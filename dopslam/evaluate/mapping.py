"""What became of every landmark of a run: seen by the signal, detected, mapped at some step, in the final map; and what
the final map holds besides.

A landmark is *visible* at a step if it has a path there whose post-integration SNR ρ reaches the detection threshold: what
lies deeper in the noise no estimator finds. It counts as visible in a run from ``STEPS`` steps on. It is *found* in a map
if an entry of its kind lies within 1 m or within 3 σ of the entry's own covariance, one entry for one landmark. An entry
that no landmark of any order explains is *false*. Second reflections count as explained or not by themselves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from dopslam.records import Kind, Landmarks, Paths
from dopslam.slam.history import History
from estimation.evaluate import Match

STEPS = 3
NEAR = 1.0  # m
SIGMAS = 3.0


@dataclass(frozen=True)
class Fate:
    """What became of the landmarks, and what the final map holds besides.

    Attributes
    ----------
    visible, detected : (L,) int, steps
    ever, found : (L,) bool, in the map after some step, and after the last
    false : (F, 3) m, entries of the final map without a landmark
    """

    visible: np.ndarray
    detected: np.ndarray
    ever: np.ndarray
    found: np.ndarray
    false: np.ndarray

    def figures(self, landmarks: Landmarks) -> dict:
        """The figures of ``summary.json``: landmarks of up to one reflection, and the second reflections beside them."""
        counted = (landmarks.kind != Kind.BS) & (self.visible >= STEPS)
        simple, higher = counted & (landmarks.order <= 1), counted & (landmarks.order > 1)
        return {
            "landmarks_visible": int(simple.sum()),
            "landmarks_found": int((simple & self.found).sum()),
            "landmarks_ever": int((simple & self.ever).sum()),
            "false_landmarks": len(self.false),
            "second_reflections_visible": int(higher.sum()),
            "second_reflections_found": int((higher & self.found).sum()),
        }


def steps_seen(
    matches: list[Match] | None, paths: Paths | None, landmarks: Landmarks, threshold: float
) -> tuple[np.ndarray, np.ndarray]:
    """Steps (L,) at which every landmark is visible, and detected; without paths all are at all steps.

    Parameters
    ----------
    matches : one for every step, of the detections against the paths
    threshold : of detection, on ρ
    """
    if matches is None or paths is None:
        always = np.full(len(landmarks), STEPS)
        return always, always
    visible, detected = np.zeros((2, len(landmarks)), dtype=int)
    for step, match in enumerate(matches):
        of = paths.landmark[paths.rows(step)]
        visible[np.unique(of[match.rho >= threshold])] += 1
        detected[np.unique(of[match.detected])] += 1
    return visible, detected


def fate(landmarks: Landmarks, history: History, threshold: float, visible: np.ndarray, detected: np.ndarray) -> Fate:
    """Judge the map of every step; ``threshold`` on the existence of what it reports."""
    ever = np.zeros(len(landmarks), dtype=bool)
    found, false = ever, np.zeros((0, 3))
    for step in range(history.steps):
        found, false = _compare(landmarks, history, step, threshold)
        ever = ever | found
    return Fate(visible, detected, ever, found, false)


def _compare(landmarks: Landmarks, history: History, step: int, threshold: float) -> tuple[np.ndarray, np.ndarray]:
    rows = history.rows(step)
    reported = np.flatnonzero(history.existence[rows] > threshold) + rows.start
    found, false = np.zeros(len(landmarks), dtype=bool), []
    points = history.kind[reported] == Kind.SP
    for entries, mine in (
        (reported[points], np.flatnonzero(landmarks.kind == Kind.SP)),
        (reported[~points], np.flatnonzero(landmarks.kind == Kind.VA)),
    ):
        off = history.position[entries][:, None] - landmarks.position[mine][None]
        distance = np.linalg.norm(off, axis=-1)
        inverse = np.linalg.pinv(history.position_covariance[entries], hermitian=True)
        sigmas = np.sqrt(np.maximum(np.einsum("eli,eij,elj->el", off, inverse, off), 0.0))
        near = (distance <= NEAR) | (sigmas <= SIGMAS)
        row, column = linear_sum_assignment(np.where(near, distance, 1e6))
        good = near[row, column]
        found[mine[column[good]]] = True
        false.append(np.delete(history.position[entries], row[good], axis=0))
    return found, np.concatenate(false)
