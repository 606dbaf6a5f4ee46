"""Which landmark each detection of a run belongs to, given the track and the map: the best assignment of every step.

A pair is worth log N(z; h, R + A P Aᵀ + B P_x Bᵀ)/c(z), with the mixture of scales in place of the normal; what is worth
less than a false detection stays free. Pairs are looked at only where delay and azimuth are near.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from dopslam.models.measurement import wrap
from dopslam.models.pose import positions
from dopslam.slam.batch.landmarks import Belief, explain
from dopslam.slam.batch.rows import Map, Rows, predict

Array = NDArray[np.float64]
Index = NDArray[np.int64]

CHUNK = 200_000  # predicted measurements at once
REACH = 8.0  # deviations within which a pair is looked at


def pairs(data: Rows, belief: Belief, found: Map) -> tuple[Index, Index]:
    """Pairs (detection, landmark) whose delay and arrival azimuth are near each other."""
    size = max(1, CHUNK // max(len(found), 1))
    wide = np.einsum("jii->j", found.covariance)
    rows, owners = [], []
    for low in range(0, data.steps, size):
        high = min(low + size, data.steps)
        state, covariance = belief.state[low:high], belief.covariance[low:high]
        exact = predict(data, state[:, None], found.kind, found.position, found.station)
        distance = np.linalg.norm(found.position - positions(state, data.height)[:, None], axis=-1)
        place = covariance[:, 0, 0] + covariance[:, 1, 1]
        delay = (place + covariance[:, 3, 3])[:, None] + 2 * wide
        angle = covariance[:, 2, 2][:, None] + (place[:, None] + wide) / np.maximum(distance, 1e-3) ** 2
        chosen = np.arange(data.offsets[low], data.offsets[high])
        step = data.step[chosen] - low
        variance = np.einsum("nii->ni", data.covariance[chosen])
        length = np.abs(data.z[chosen, 0, None] - exact[step, :, 0]) < REACH * np.sqrt(
            variance[:, 0, None] + delay[step]
        )
        off = np.abs(wrap(data.z[chosen, 1, None] - exact[step, :, 1]))
        near = (off < REACH * np.sqrt(variance[:, 1, None] + angle[step])) | ~data.used[chosen, 1, None]
        row, owner = np.nonzero(length & near & (data.station[chosen][:, None] == found.station))
        rows.append(chosen[row])
        owners.append(owner)
    return np.concatenate(rows), np.concatenate(owners)


def associate(data: Rows, belief: Belief, found: Map) -> Index:
    """Landmark (N,) of every detection, -1 for those that none explains."""
    result = np.full(len(data.z), -1)
    rows, owner = pairs(data, belief, found)
    if not len(rows):
        return result
    density = explain(data, belief, rows, owner, found.kind, found.position, found.covariance)[0]
    gain, step = density - data.false[rows], data.step[rows]
    order = np.flatnonzero(gain > 0)
    order = order[np.argsort(step[order], kind="stable")]
    for part in np.split(order, np.flatnonzero(np.diff(step[order])) + 1):
        if not len(part):
            continue
        left, i = np.unique(rows[part], return_inverse=True)
        right, j = np.unique(owner[part], return_inverse=True)
        if len(left) == len(part) == len(right):
            result[rows[part]] = owner[part]
            continue
        cost = np.zeros((len(left), len(right)))
        cost[i, j] = -gain[part]
        for a, b in zip(*linear_sum_assignment(cost), strict=True):
            if cost[a, b] < 0:
                result[left[a]] = right[b]
    return result
