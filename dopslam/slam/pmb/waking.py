"""Which landmarks sleep and wake (`sleeping`): who may be seen by a scan, whom no detection comes near, and the map of both."""

from __future__ import annotations

import math

import numpy as np

from dopslam.compute.compiled import compiled, copy_vector, take
from dopslam.models.kernels import SP, linearize, log_spreading, noise_entry, subtract
from dopslam.models.scans import CELL
from dopslam.slam.pmb.density import INERT, NO_TRACK, PMB, look_up, start_of
from dopslam.slam.pmb.hypotheses import ESTABLISHED
from dopslam.slam.pmb.newborn import RARE
from dopslam.slam.pmb.sleeping import (
    AWAKE,
    GONE,
    SLEEPING,
    Asleep,
    bring_back,
    extend,
    positions_now,
    sleepers,
    whole,
)

RESTED = 3.0  # scans out of reach after which a block may be put to rest
SPARE = 32  # blocks beyond twice those in reach that may stay in work
WORTH = 16  # blocks that must be able to rest before the work of putting them to rest is done
WIDE = 2.0  # by which variances are multiplied before a detection is said not to come from a sleeper


@compiled
def within_reach(x, spread, b, prior, n, asleep, scan, model, predicted, by_state, by_landmark, nu):
    """Whether a detection may be gated with a sleeper at `x`, covariance `spread`, or lie within a resolution cell of it."""
    m = scan.z.shape[1]
    kind = asleep.kind[b]
    state = prior.mean[:n]
    if kind == SP and model.sp_range < np.inf:  # nearly within the range: its share of it is asked for exactly
        far, variance = 0.0, prior.covariance[0, 0] + prior.covariance[1, 1]
        for i in range(3):
            far += (x[i] - (state[i] if i < 2 else model.site[3])) ** 2
            variance += spread[i, i]
        if math.sqrt(far) < model.sp_range + 8.0 * math.sqrt(variance):
            return True
    if not linearize(state, x, kind, model.site, predicted, by_state, by_landmark):
        return False
    for p in range(scan.z.shape[0]):
        if scan.log_snr[p] == -np.inf:
            continue
        subtract(scan.z[p], predicted, by_landmark, by_state, nu)
        cell = 0.0
        if model.outlier > 0.0 and scan.log_snr[p] > 0.0 and asleep.detections[b] >= ESTABLISHED:
            cell = CELL * math.exp(scan.log_snr[p])
        near = True
        for i in range(m):
            if not near:
                break
            own = theirs = 0.0
            for k in range(n):
                for j in range(n):
                    own += by_state[i, k] * prior.covariance[k, j] * by_state[i, j]
            for k in range(3):
                for j in range(3):
                    theirs += by_landmark[i, k] * spread[k, j] * by_landmark[i, j]
            variance = WIDE * (math.sqrt(max(own, 0.0)) + math.sqrt(max(theirs, 0.0))) ** 2
            noise = noise_entry(scan.covariance[p], kind, i, i)
            near = nu[i] * nu[i] < max(model.gate * (variance + noise), 9.0 * variance + cell * noise)
        if near:
            return True
    return False


@compiled
def wake(prior, n, scan, asleep, model):
    """Bring back the sleepers that the scan may have detected, and let it pass for the others: a miss of each.

    Returns
    -------
    prior, asleep : with the woken blocks in the one and not in the other
    """
    total = asleep.status.shape[0]
    if sleepers(asleep) == 0:
        return prior, asleep
    m = scan.z.shape[1]
    predicted, nu = np.empty(m), np.empty(m)
    by_state, by_landmark = np.empty((m, n)), np.empty((m, 3))
    means = positions_now(prior, n, asleep)
    woken = np.empty(total, dtype=np.int64)
    count = 0
    weight, visible, unseen = asleep.weight.copy(), asleep.visible.copy(), asleep.unseen.copy()
    status = asleep.status.copy()
    due = np.zeros(total)
    b = 1
    while b < total:
        last = b
        near = False
        while last < total and asleep.track[last] == asleep.track[b]:
            if status[last] == SLEEPING:
                start = start_of(n, last)
                spread = asleep.covariance[start : start + 3, start : start + 3]
                x = means[start - n : start - n + 3]
                near = near or within_reach(
                    x, spread, last, prior, n, asleep, scan, model, predicted, by_state, by_landmark, nu
                )
                weight[last] *= model.survival
                if model.hide > 0.0 and asleep.detections[last] >= ESTABLISHED:
                    back = model.reappear / (1.0 + model.reappear * unseen[last])
                    visible[last] += (1.0 - visible[last]) * back - visible[last] * model.hide
                due[last] = 0.0
                limited = asleep.kind[last] == SP and model.sp_range < np.inf
                valid = linearize(prior.mean[:n], x, asleep.kind[last], model.site, predicted, by_state, by_landmark)
                if valid and not limited:
                    loss = log_spreading(asleep.kind[last], x, prior.mean, model.site)
                    due[last] = visible[last] * look_up(model.table, asleep.reference[last] - loss)
            last += 1
        if near:
            for i in range(b, last):
                if status[i] == SLEEPING:
                    woken[count] = i
                    count += 1
                    status[i] = AWAKE
        else:
            missed = existence = 0.0
            for i in range(b, last):
                missed += weight[i] * due[i] if status[i] == SLEEPING else 0.0
            for i in range(b, last):
                if status[i] == SLEEPING:
                    weight[i] *= (1.0 - due[i]) / max(1.0 - missed, 1e-12)
                    unseen[i] += due[i] / max(visible[i], 1e-12)
                    visible[i] = (visible[i] - due[i]) / max(1.0 - due[i], 1e-12) if due[i] > 0.0 else visible[i]
                    existence += weight[i]
            for i in range(b, last):
                if status[i] == SLEEPING and (existence < model.prune or weight[i] < RARE * model.prune):
                    status[i] = GONE
        b = last
    following = Asleep(
        asleep.mean, asleep.covariance, status, asleep.kind, weight, asleep.track, asleep.reference,
        asleep.detections, visible, unseen, asleep.rows, asleep.factor,
    )  # fmt: skip
    if count == 0:
        return prior, following
    return bring_back(prior, n, following, woken[:count])


@compiled
def rest(density, n, asleep):
    """Put to rest what is out of reach, if that is worth its work.

    The first blocks of the new density are the clone of the receiver, the others those in work.
    """
    blocks = density.kind.shape[0]
    busy = idle = 0
    for b in range(1, blocks):
        if density.kind[b] != INERT and density.idle[b] < RESTED:
            busy += 1
        else:
            idle += 1
    if blocks < 2 * busy + SPARE or idle < WORTH:
        return density, asleep
    density = whole(density, n, asleep)
    blocks = density.kind.shape[0]
    size = density.mean.shape[0]
    order = np.empty(blocks, dtype=np.int64)  # BS, those in work, those that rest; tracks stay together
    order[0] = 0
    count = 1
    for wanted in range(2):
        b = 1
        while b < blocks:
            last, rested = b, True
            while last < blocks and density.track[last] == density.track[b]:
                rested = rested and density.idle[last] >= RESTED
                last += 1
            if density.kind[b] != INERT and rested == (wanted == 1):
                for i in range(b, last):
                    order[count] = i
                    count += 1
            b = last
        if wanted == 0:
            work = count
    order = order[:count]
    rows = np.empty(n + 3 * (count - 1), dtype=np.int64)
    for i in range(n):
        rows[i] = i
    for b in range(1, count):
        for i in range(3):
            rows[start_of(n, b) + i] = start_of(n, order[b]) + i
    mean, covariance = np.empty(rows.shape[0]), np.empty((rows.shape[0], rows.shape[0]))
    for i in range(rows.shape[0]):
        mean[i] = density.mean[rows[i]]
        for j in range(rows.shape[0]):
            covariance[i, j] = density.covariance[rows[i], rows[j]]
    status = np.full(count, SLEEPING)
    for b in range(work):
        status[b] = AWAKE
    active = n + 3 * (work - 1)
    following = Asleep(
        mean, covariance, status, take(density.kind, order), take(density.weight, order), take(density.track, order),
        take(density.reference, order), take(density.detections, order), take(density.visible, order),
        take(density.unseen, order), np.arange(active), np.zeros((active, active)),
    )  # fmt: skip
    extend(following, 0)
    # the density in work: receiver, its clone in two blocks of three rows, the blocks in work
    total = work + 2
    size = n + 3 * (total - 1)
    source = np.full(size, -1)
    for i in range(n):
        source[i] = i
        source[n + i] = i
    for i in range(n, active):
        source[6 + i] = i
    new_mean, new_covariance = np.zeros(size), np.zeros((size, size))
    for i in range(size):
        if source[i] >= 0:
            new_mean[i] = mean[source[i]]
            for j in range(size):
                if source[j] >= 0:
                    new_covariance[i, j] = covariance[source[i], source[j]]
    clone = np.zeros(total, dtype=np.int64)
    for b in range(1, work):
        clone[b + 2] = b
    kind, weight, track = take(following.kind, clone), take(following.weight, clone), take(following.track, clone)
    visible, idle_now = take(following.visible, clone), take(density.idle, take(order, clone))
    reference, detections = take(following.reference, clone), take(following.detections, clone)
    unseen, origin = take(following.unseen, clone), clone.copy()
    for i in range(2):
        kind[1 + i], weight[1 + i], track[1 + i], origin[1 + i] = INERT, 1.0, NO_TRACK - 1, count + i
    result = PMB(
        new_mean, new_covariance, kind, weight, track, reference, detections, visible, unseen, idle_now, origin,
        density.trail,
    )  # fmt: skip
    return result, following


@compiled
def write_sleepers(asleep, density, n, table, row):
    """Write the sleepers below the map of those in work (`history.write_map`); their covariances as they fell asleep, which
    later steps only lower. Returns the row after the last."""
    if sleepers(asleep) == 0:
        return row
    means = positions_now(density, n, asleep)
    b, total = 1, asleep.status.shape[0]
    while b < total:
        last, best, existence = b, -1, 0.0
        for t in range(15, table.shape[1]):
            table[row, t] = 0.0
        while last < total and asleep.track[last] == asleep.track[b]:
            if asleep.status[last] == SLEEPING:
                existence += asleep.weight[last]
                table[row, 15 + asleep.kind[last]] += asleep.weight[last]
                if best < 0 or asleep.weight[last] > asleep.weight[best]:
                    best = last
            last += 1
        if best >= 0:
            start = start_of(n, best)
            copy_vector(means[start - n : start - n + 3], table[row])
            for i in range(3):
                for j in range(3):
                    table[row, 3 + 3 * i + j] = asleep.covariance[start + i, start + j]
            table[row, 12], table[row, 13], table[row, 14] = existence, asleep.kind[best], asleep.track[best]
            for t in range(15, table.shape[1]):
                table[row, t] /= max(existence, 1e-300)
            row += 1
        b = last
    return row
