"""Random rooms for the snapshot tests: four walls, scatter points, clutter, with or without a line of sight."""

import numpy as np

from dopslam.models.measurement import measure
from dopslam.slam.snapshot.rays import Rays


def room(seed, *, planar=False, sight=True, angle_std=0.01, points=6, clutter=2.0, speed=1.3):
    """True state (4,) and rays of one scan in a random room."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(16,)))
    width, depth, height = rng.uniform(12, 30), rng.uniform(8, 18), 1.3
    station = np.array([rng.uniform(1, width - 1), rng.uniform(0.5, 2), height if planar else rng.uniform(2, 4)])
    state = np.array([rng.uniform(2, width - 2), rng.uniform(2, depth - 2), *rng.uniform([-np.pi, -50], [np.pi, 50])])
    walls = np.array([[-station[0], station[1]], [2 * width - station[0], station[1]],
                      [station[0], -station[1]], [station[0], 2 * depth - station[1]]])  # fmt: skip
    walls = np.column_stack([walls, np.full(4, station[2])])
    place = np.column_stack([rng.uniform(0, [width, depth], (points, 2)), rng.uniform(0.5, 3, points)])
    if planar:
        place[:, 2] = height
    kind = np.array([0] + [1] * 4 + [2] * points)
    seen = rng.random(len(kind)) < 0.8
    seen[0] = sight
    std = np.array([0.05, *[angle_std] * 4, 0.1])
    exact = measure(state, np.vstack([station, walls, place]), kind, station, height=height, speed=speed)[seen]
    real = exact + rng.standard_normal(exact.shape) * std
    low, high = exact[:, 0].min(), exact[:, 0].max() + 10
    false = rng.uniform(
        [low, -np.pi, -0.5, -np.pi, -0.5, -1], [high, np.pi, 0.5, np.pi, 0.5, 1], (rng.poisson(clutter), 6)
    )
    z = rng.permutation(np.vstack([real, false]))
    covariance = np.tile(np.diag(std**2), (len(z), 1, 1))
    return state, Rays(z, covariance, np.tile(station, (len(z), 1)), height, planar)
