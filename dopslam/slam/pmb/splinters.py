"""One path in several pieces: detections of a scan that an estimator made of a single path, in a wrong direction of departure.

Delay, arrival and Doppler of a detection are where it comes from, whatever left the base station how: two paths that agree
in them come from the same image point, and are one. Detections that agree in them and not in their departure are one path
that was fitted beside its departure, and what that left over fitted again, five or ten times. Of such a family the strongest
member tells where the path comes from, and nothing about its departure; the others tell nothing. Two that agree may be
chance; from `FAMILY` on four in five were false (19 generated scenes).

What the map explains, departure included, is no piece. Paths that lie within a resolution cell have covariances as wide as
what they overlap, and agree as well: the line of sight, a wall beside it and the ceiling, at the end of a corridor. Each
established landmark, and the base station, therefore keeps its best detection, and all of them count for one in a family.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dopslam.compute.compiled import compiled
from dopslam.compute.linalg import factorize, solve_lower_vector
from dopslam.models.kernels import SR, noise_entry, wrap_angle
from dopslam.slam.pmb.hypotheses import ESTABLISHED, local_hypotheses

FAMILY = 3  # members
ALIKE = 12.0  # squared Mahalanobis distance of delay, arrival and Doppler of two that agree (98 % of χ²₄)


@compiled
def pass_over_splinters(prior, n, scan, model):
    """Set ln ρ of splinters to -∞, which the recursion passes over, and free the departure of the strongest of a family.

    Parameters
    ----------
    prior : PMB, the predicted density
    n : int, entries of the receiver's state
    scan : Scan; its covariance and log_snr are overwritten. Where ρ is not known (ln ρ = 0) it stays as it is.
    model : Model
    """
    count = scan.z.shape[0]
    if not model.pieces or count < FAMILY:
        return
    explained = np.zeros(count, dtype=np.bool_)
    if not families(scan, explained, False):
        return
    local = local_hypotheses(prior, n, scan, model)
    for t in range(local.first.shape[0] - 1):
        if t == 0 or prior.detections[local.first[t]] >= ESTABLISHED:
            best = np.argmax(local.log_ratio[:, t])
            if local.log_ratio[best, t] > -np.inf:
                explained[best] = True
    families(scan, explained, True)


@compiled
def families(scan, explained, act):
    """Whether detections are pieces of one path; with `act` they are made one, what is `explained` left as it is.

    Landmarks within one resolution cell explain a detection each: of a family they count for one.
    """
    z, covariance, log_snr = scan.z, scan.covariance, scan.log_snr
    count, m = z.shape
    factor, apart = np.empty((m - 2, m - 2)), np.empty(m - 2)
    order = np.argsort(-log_snr)
    taken, member = np.zeros(count, dtype=np.bool_), np.empty(count, dtype=np.int64)
    found = False
    for i in range(count):
        p = order[i]
        if taken[p] or log_snr[p] <= 0.0:
            continue
        members, known = 0, 0
        for j in range(i, count):
            q = order[j]
            if taken[q] or (j > i and not _agree(z, covariance, p, q, factor, apart)):
                continue
            if explained[q]:
                known = 1
            else:
                member[members] = q
                members += 1
        if members + known < FAMILY:
            continue
        found = True
        if not act:
            break
        for j in range(members):
            taken[member[j]] = True
            if j > 0:
                log_snr[member[j]] = -np.inf
        p = member[0]
        for a in range(m):
            for b in range(m):
                free = noise_entry(covariance[p], SR, a, b)
                covariance[p, a, b] = max(covariance[p, a, b], free) if a == b else free
    return found


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
