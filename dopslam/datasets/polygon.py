"""Distance of points to the outline of a simple polygon, positive inside."""

from __future__ import annotations

import numpy as np


def clearance(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance [m] of each point to the outline, negative outside.

    Parameters
    ----------
    polygon : (C, 2) m, corners in order
    points : (M, 2) m

    Returns
    -------
    (M,)
    """
    start, end = polygon, np.roll(polygon, -1, axis=0)
    edge = end - start
    offset = points[:, None] - start
    share = np.clip(np.sum(offset * edge, axis=-1) / np.maximum(np.sum(edge**2, axis=-1), 1e-300), 0, 1)
    distance = np.linalg.norm(offset - share[..., None] * edge, axis=-1).min(axis=1)
    # Even–odd rule: edges that a ray towards +x crosses.
    above = start[:, 1] > points[:, None, 1]
    crosses = above != (end[:, 1] > points[:, None, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = start[:, 0] + (points[:, None, 1] - start[:, 1]) * edge[:, 0] / edge[:, 1]
    inside = np.sum(crosses & (points[:, None, 0] < reach), axis=1) % 2 == 1
    return np.where(inside, distance, -distance)
