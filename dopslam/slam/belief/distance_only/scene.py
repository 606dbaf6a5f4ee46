"""The synthetic setting of the distance-only filter: a room, a track, distances with noise, misses and false alarms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dopslam.models.paths import mirror
from dopslam.slam.belief.distance_only.filter import RangeParameters


@dataclass(frozen=True)
class RangeScenario:
    """Track (K, 2) m and per anchor the true features (L_j, 2) m, the anchor itself first."""

    track: np.ndarray
    features: tuple[np.ndarray, ...]

    @property
    def anchors(self) -> np.ndarray:
        """(J, 2) m."""
        return np.array([f[0] for f in self.features])

    def draw(self, rng: np.random.Generator, parameters: RangeParameters) -> list[list[np.ndarray]]:
        """Distances per step and anchor: detected paths with noise, and false alarms."""
        scans = []
        for place in self.track:
            step = []
            for features in self.features:
                true = np.linalg.norm(features - place, axis=1)
                seen = rng.random(true.size) < parameters.detection
                noisy = true[seen] + parameters.deviation * rng.standard_normal(seen.sum())
                false = rng.uniform(0, parameters.distance_end, rng.poisson(parameters.clutter))
                step.append(rng.permutation(np.concatenate([noisy, false])))
            scans.append(step)
        return scans


def office(steps: int = 900, length: float = 0.03) -> RangeScenario:
    """A 10 m × 8 m room with two anchors and eleven anchors in all: images in the four walls, one of second
    order.

    The track is a figure of eight, walked in steps of ``length`` [m].
    """
    width, depth = 10.0, 8.0

    normals, offsets = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 1.0]]), np.array([0.0, width, 0.0, depth])

    def images(a):
        return [a, *mirror(a, normals, offsets)]

    # Both on one side: on the line between two anchors, distances alone cannot tell left from right.
    first, second = [1.6, 1.5], [8.3, 1.2]
    maps = (np.array([*images(first), mirror(images(first)[3], normals[1], width)]), np.array(images(second)))
    phase = np.linspace(0, 6 * np.pi, 60001)
    path = np.column_stack([5 + 3.2 * np.sin(phase), 5 + 1.6 * np.sin(2 * phase)])
    arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    reached = length * np.arange(1, steps + 1)
    return RangeScenario(np.column_stack([np.interp(reached, arc, path[:, a]) for a in range(2)]), maps)
