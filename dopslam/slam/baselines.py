"""What a filter is worth is seen beside these: dead reckoning, and the line of sight alone. Neither makes a map.

``dopslam run SCENE --filter joint,dopslam.slam.baselines:DeadReckoning,dopslam.slam.baselines:LineOfSight``
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dopslam.models.measurement import BS, jacobians, measure, residual
from dopslam.models.motion import propagate, transition_jacobian
from dopslam.models.scans import Scans
from dopslam.slam.filter import Capabilities, Estimate, Info, Problem

GATE = {5: 20.5, 6: 22.5}  # squared Mahalanobis distance that 1 in 1000 lines of sight exceed, by the rows used


def _predicted(state: tuple[Problem, np.ndarray, np.ndarray]) -> tuple[Problem, np.ndarray, np.ndarray]:
    problem, mean, covariance = state
    slope = transition_jacobian(mean, problem.motion)
    return (
        problem,
        propagate(mean, problem.motion),
        slope @ covariance @ slope.T + problem.motion.process_noise,
    )


@dataclass(frozen=True)
class DeadReckoning:
    """The motion model from the start on; no detection is looked at."""

    capabilities = Capabilities(doppler=False, states=(4, 6))

    def init(self, problem: Problem, rng: np.random.Generator) -> Any:
        """The prior."""
        return problem, problem.mean, problem.covariance

    def step(self, state: Any, scan: Scans, rng: np.random.Generator) -> tuple[Any, Info]:
        """Predict."""
        state = _predicted(state)
        return state, Info(Estimate(*state[1:]))


@dataclass(frozen=True)
class LineOfSight:
    """An extended Kalman filter on the detection nearest to the predicted line of sight, where one passes the gate."""

    doppler: bool = True
    capabilities = Capabilities(states=(4, 6))

    def init(self, problem: Problem, rng: np.random.Generator) -> Any:
        """The prior."""
        return problem, problem.mean, problem.covariance

    def step(self, state: Any, scan: Scans, rng: np.random.Generator) -> tuple[Any, Info]:
        """Predict, choose, update (Joseph)."""
        problem, mean, covariance = _predicted(state)
        told = {"speed": problem.speed, "height": problem.height}
        rows = 6 if self.doppler else 5
        h = jacobians(mean, problem.anchor, BS, problem.anchor, **told)[0][:rows]
        away = residual(scan.z, measure(mean, problem.anchor, BS, problem.anchor, **told))[:, :rows]
        spread = h @ covariance @ h.T + scan.covariance[:, :rows, :rows]
        distance = np.einsum("ni,ni->n", away, np.linalg.solve(spread, away[..., None])[..., 0])
        if len(distance) and distance.min() < GATE[rows]:
            best = int(np.argmin(distance))
            gain = np.linalg.solve(spread[best], h @ covariance).T
            left = np.eye(len(mean)) - gain @ h
            mean = mean + gain @ away[best]
            covariance = left @ covariance @ left.T + gain @ scan.covariance[best, :rows, :rows] @ gain.T
        return (problem, mean, covariance), Info(Estimate(mean, covariance))
