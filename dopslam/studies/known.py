"""What a filter's errors owe to its input: the whole run fitted by least squares, every detection with its true landmark.

No filter does better on these detections, and association, births and linearization are out of the question: a cost per
degree of freedom above 1 is what the detections' covariances leave out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dopslam.config.scenario import Scenario
from dopslam.evaluate.metrics import nees
from dopslam.models.measurement import wrap
from dopslam.models.scans import Scans
from dopslam.pipeline import file as files
from dopslam.pipeline import problem as build
from dopslam.pipeline import stages
from dopslam.pipeline.stages import Progress, quiet
from dopslam.slam.batch.noise import Scales
from dopslam.slam.batch.rows import Map, linearize, rows_of
from dopslam.slam.batch.track import KNOWN, Chain, optimize
from dopslam.slam.filter import Problem
from dopslam.studies.traced import NOISES, prepare
from estimation import statistics

Array = NDArray[np.float64]
PLAIN = Scales(np.ones(1), np.ones(1))


@dataclass(frozen=True, slots=True)
class Fit:
    """The fit of one run.

    Attributes
    ----------
    nees : mean over the steps, of the states; their number is expected
    cost : twice the negative log density over its constant, a χ² of ``freedom`` degrees
    rows : (N,) rows of each detection that has a landmark, and ``square`` (N,) the squared Mahalanobis distance of its error
        at the truth, a χ² of as many degrees
    """

    nees: float
    cost: float
    freedom: int
    rows: NDArray[np.int64]
    square: Array


def fit(
    problem: Problem, scans: Scans, states: Array, kind: NDArray[np.int64], position: Array, label: NDArray[np.int64]
) -> Fit:
    """Fit one run.

    Parameters
    ----------
    states : (K, n) the true ones
    kind (L,), position (L, 3) : of the landmarks, the base station first
    label : (N,) landmark of each detection, −1 of false ones
    """
    motion = problem.motion
    speed = float(getattr(motion, "speed", 0.0))
    data = rows_of(scans, problem.stations.position[:1], problem.height, speed)
    seen = np.unique(label[label > 0])
    place = np.full(len(kind), -1)
    place[0], place[seen] = 0, 1 + np.arange(len(seen))
    owner = np.where(label >= 0, place[np.maximum(label, 0)], -1)
    chosen = np.concatenate([[0], seen]).astype(np.int64)
    found = Map(
        kind[chosen].astype(np.int64), position[chosen], np.zeros(len(chosen), np.int64), np.zeros((len(chosen), 3, 3))
    )
    prior = np.asarray(problem.mean, float)
    information = np.asarray(np.linalg.inv(problem.covariance + KNOWN * np.eye(len(prior))), float)
    chain = Chain(motion, prior, information, scans.pace(motion.interval))
    result = optimize(data, chain, PLAIN, owner, np.vstack([prior, states]), found)
    error = result.state[1:] - states
    error[:, 2] = wrap(error[:, 2])
    mine = np.flatnonzero(owner >= 0)
    used = data.used_by(mine, found.kind[owner[mine]])
    linear = linearize(data, mine, states[data.step[mine]], found.kind[owner[mine]], found.position[owner[mine]])
    off = np.where(used, linear.error, 0.0)
    covariance = np.where(used[:, :, None] & used[:, None, :], data.covariance[mine], np.eye(6))
    square = np.einsum("mi,mi->m", off, np.linalg.solve(covariance, off[..., None])[..., 0])
    # Prior and motion are as many residuals as there are states.
    freedom = int(used.sum()) - 3 * len(seen)
    return Fit(float(np.mean(nees(error, result.covariance[1:]))), 2 * result.cost, freedom, used.sum(axis=1), square)


def traced(
    scenario: Scenario, seeds: Sequence[int], folder: Path, noise: str = "estimator", jobs: int = 1,
    progress: Progress = quiet,
) -> dict:  # fmt: skip
    """A traced scene, 95 % intervals over the seeds.

    Returns
    -------
    dict
        ``nees`` and ``cost_per_freedom``, and the median of the latter: one detection of two paths taken for one is enough to
        spoil a run's; ``detection_nees`` at the truth over the rows, and the same without the largest hundredth;
        ``largest``, the largest squared distance; ``runs``, nees and cost per degree of freedom of every seed.
    """
    fits = []
    for seed in seeds:
        path = prepare(scenario, seed, folder, jobs, progress)
        own, _ = files.scenario_of(path, (f"source.traced.added_noise={NOISES[noise]}",))
        track, landmarks, paths, _ = files.read_truth(path)
        detections = files.blurred(own, files.read_detections(path), seed)
        label = stages.landmark_of_detections(own, track, landmarks, paths, detections)
        problem = build.problem(own)
        states = np.column_stack([track.position[:, :2], track.heading, track.bias])
        kind = landmarks.kind.astype(np.int64)
        fits.append(fit(problem, problem.scans(detections), states, kind, landmarks.position, label))
    rows, square = (np.concatenate([getattr(f, name) for f in fits]) for name in ("rows", "square"))
    usual = np.argsort(square / rows)[: int(0.99 * len(square))]
    costs = [f.cost / f.freedom for f in fits]
    return {
        "nees": statistics.mean([f.nees for f in fits]),
        "cost_per_freedom": statistics.mean(costs),
        "cost_per_freedom_median": float(np.median(costs)),
        "detection_nees": float(square.sum() / rows.sum()),
        "detection_nees_trimmed": float(square[usual].sum() / rows[usual].sum()),
        "largest": float(square.max()),
        "runs": [{"nees": f.nees, "cost_per_freedom": c} for f, c in zip(fits, costs, strict=True)],
    }
