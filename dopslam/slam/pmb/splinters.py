"""One path in several pieces: detections of a scan that an estimator made of a single path, in a wrong direction of departure.

Delay, arrival and Doppler of a detection are where it comes from, whatever left the base station how: two paths that agree
in them come from the same image point, and are one. Detections that agree in them and not in their departure are one path
that was fitted beside its departure, and what that left over fitted again, five or ten times. Of such a family the strongest
member tells where the path comes from, and nothing about its departure; the others tell nothing. Two that agree may be
chance; from `FAMILY` on four in five were false (19 generated scenes).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dopslam.compute.compiled import compiled
from dopslam.compute.linalg import factorize, solve_lower_vector
from dopslam.models.kernels import SR, noise_entry, wrap_angle

FAMILY = 3  # members
ALIKE = 12.0  # squared Mahalanobis distance of delay, arrival and Doppler of two that agree (98 % of χ²₄)


@compiled
def pass_over_splinters(z, covariance, log_snr, offsets):
    """Set ln ρ of splinters to -∞, which the recursion passes over, and free the departure of the strongest of a family.

    Parameters
    ----------
    z, covariance, log_snr, offsets : as `ek_pmb.filter_scans` reads them; covariance and log_snr are overwritten. Scans
        whose ρ is not known (ln ρ = 0) stay as they are.
    """
    m = z.shape[1]
    rows = m - 2
    factor, apart = np.empty((rows, rows)), np.empty(rows)
    for k in range(offsets.shape[0] - 1):
        first, count = offsets[k], offsets[k + 1] - offsets[k]
        order = np.argsort(-log_snr[first : first + count])
        taken = np.zeros(count, dtype=np.bool_)
        member = np.empty(count, dtype=np.int64)
        for i in range(count):
            p = first + order[i]
            if taken[i] or log_snr[p] <= 0.0:
                continue
            members = 0
            for j in range(i + 1, count):
                if not taken[j] and _agree(z, covariance, p, first + order[j], factor, apart):
                    member[members] = j
                    members += 1
            if members + 1 < FAMILY:
                continue
            for j in range(members):
                taken[member[j]] = True
                log_snr[first + order[member[j]]] = -np.inf
            for a in range(m):
                for b in range(m):
                    free = noise_entry(covariance[p], SR, a, b)
                    covariance[p, a, b] = max(covariance[p, a, b], free) if a == b else free


def passed_over(log_snr: NDArray[np.float64], offsets: NDArray[np.int64]) -> NDArray[np.int64]:
    """How many detections of every scan (K,) were set aside by :func:`pass_over_splinters`."""
    aside = np.concatenate([[0], np.cumsum(np.isneginf(log_snr))])
    return np.diff(aside[offsets])


@compiled
def _agree(z, covariance, p, q, factor, apart):
    """Whether two detections agree in delay, arrival and Doppler."""
    rows = apart.shape[0]
    for i in range(rows):
        a = i if i < 3 else 5
        apart[i] = z[q, a] - z[p, a]
        if a == 1:
            apart[i] = wrap_angle(apart[i])
        if apart[i] * apart[i] > ALIKE * (covariance[p, a, a] + covariance[q, a, a]):
            return False  # each row alone bounds the distance from below
    for i in range(rows):
        for j in range(rows):
            a, b = i if i < 3 else 5, j if j < 3 else 5
            factor[i, j] = covariance[p, a, b] + covariance[q, a, b]
    return factorize(factor, rows) and solve_lower_vector(factor, rows, apart) < ALIKE
