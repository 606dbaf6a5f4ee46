"""Operations on clouds of stacked particles: walks, resampling, moments, births.

A cloud is an array (..., N) of single precision: x, y [m] and amplitude u of N particles per feature and type. The kernels
work on one row at a time, release the interpreter's lock and write only their own output, so that threads share them
out; random numbers are drawn beforehand. The results do not depend on the number of threads.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np

from dopslam.compute.compiled import compiled_without_lock
from dopslam.slam.belief.kernels import PS, VA, VA_AOD
from dopslam.slam.belief.motion import BIAS, HEADING
from dopslam.slam.belief.records import Parameters, Scan

_SMALL = 20_000  # particles below which threads cost more than they save


def in_threads(function: Callable, tasks: Sequence[tuple]) -> list:
    """``[function(*task) for task in tasks]`` on all cores this process may use; small tasks stay in this thread."""
    workers = min(len(os.sched_getaffinity(0)), len(tasks))
    if workers < 2:
        return [function(*task) for task in tasks]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(lambda task: function(*task), tasks))


def stride(size: int) -> int:
    """A step near the golden section that visits all of ``size`` indices."""
    step = int(0.6180339887 * size) | 1
    while np.gcd(step, size) != 1:
        step += 2
    return step


def walked(rng: np.random.Generator, cloud: np.ndarray, position: float, amplitude: float) -> np.ndarray:
    """Random walks of positions [m] and (relative) amplitudes of (T, 3, K, N), from one pool of normals read at random
    offsets per row."""
    types, _, features, size = cloud.shape
    pool = rng.standard_normal(4 * size + 1024, dtype=np.float32)
    offsets = rng.integers(0, 3 * size + 1024, (types, features, 3))
    out = np.empty_like(cloud)
    steps = np.float32(position), np.float32(amplitude)
    _share(_walk, size, [
        (cloud[t, :, k], out[t, :, k], pool, offsets[t, k], *steps) for t in range(types) for k in range(features)
    ])  # fmt: skip
    return out


@compiled_without_lock
def _walk(row, out, pool, offsets, position, amplitude):
    floor, one = np.float32(0.5), np.float32(1.0)
    for a in range(2):
        start = offsets[a]
        for i in range(row.shape[1]):
            out[a, i] = row[a, i] + position * pool[start + i]
    start = offsets[2]
    for i in range(row.shape[1]):
        out[2, i] = max(row[2, i] * (one + amplitude * pool[start + i]), floor)


def log_gammas(lam: np.ndarray, weight: np.ndarray, none: np.ndarray) -> np.ndarray:
    """Σ_k ln [Σ_t W_kt λ_kt(i) + none_k] of every particle, (N,), from λ (T, K, N) and W (K, T)."""
    size = lam.shape[2]
    result = np.zeros(size)
    parts = 4 if size >= _SMALL else 1
    bounds = np.linspace(0, size, parts + 1).astype(int)
    _share(_add_log_gammas, size, [
        (result[a:b], lam[:, :, a:b], weight, none) for a, b in pairwise(bounds)
    ])  # fmt: skip
    return result


@compiled_without_lock
def _add_log_gammas(log_weight, lam, weight, none):
    types, features, size = lam.shape
    product = np.ones(size)
    for k in range(features):
        for i in range(size):
            total = none[k]
            for t in range(types):
                total += weight[k, t] * lam[t, k, i]
            product[i] *= max(total, 1e-300)
            if product[i] > 1e150 or product[i] < 1e-150:  # one logarithm for many factors
                log_weight[i] += np.log(max(product[i], 1e-300))
                product[i] = 1.0
    for i in range(size):
        log_weight[i] += np.log(product[i])


def moments(cloud: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means (T, K, 3) and the central moments xx, xy, yy, uu (T, K, 4) of every row's particles."""
    types, _, features, size = cloud.shape
    mean, spread = np.zeros((types, features, 3)), np.zeros((types, features, 4))
    _share(_moments, size, [
        (cloud[t, :, k], mean[t, k], spread[t, k]) for t in range(types) for k in range(features)
    ])  # fmt: skip
    return mean, spread


@compiled_without_lock
def _moments(row, mean, spread):
    size = row.shape[1]
    x0, y0, u0 = float(row[0, 0]), float(row[1, 0]), float(row[2, 0])
    sx, sy, su, xx, xy, yy, uu = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(size):
        a, b, c = row[0, i] - x0, row[1, i] - y0, row[2, i] - u0
        sx += a
        sy += b
        su += c
        xx += a * a
        xy += a * b
        yy += b * b
        uu += c * c
    sx, sy, su = sx / size, sy / size, su / size
    mean[0], mean[1], mean[2] = x0 + sx, y0 + sy, u0 + su
    spread[0], spread[1] = xx / size - sx * sx, xy / size - sx * sy
    spread[2], spread[3] = yy / size - sy * sy, uu / size - su * su


def mean_missed(u: np.ndarray, table: np.ndarray, step: float) -> np.ndarray:
    """(K,) mean of 1 − p_d over the particles (K, N), from its table."""
    return np.array(_share(_mean_missed, u.shape[1], [(row, table, np.float32(step)) for row in u]))


@compiled_without_lock
def _mean_missed(u, table, step):
    last = np.float32(table.size - 1.001)
    total = 0.0
    for i in range(u.size):
        position = min(u[i] / step, last)
        index = int(position)
        share = position - np.float32(index)
        total += table[index] * (np.float32(1.0) - share) + table[index + 1] * share
    return total / u.size


def resample_rows(rng: np.random.Generator, rows: np.ndarray, lam: np.ndarray, keep: np.ndarray, out: np.ndarray):
    """Systematic resampling of the kept rows by λ (T, K, N) into the first rows of ``out`` (T, 3, ≥K', N); copies are
    scattered over the row."""
    types, _, _, size = rows.shape
    points, starts, step = rng.random((types, keep.size)), rng.integers(0, size, (types, keep.size)), stride(size)
    _share(_resample, size, [
        (rows[t, :, k], lam[t, k], points[t, j], starts[t, j], step, out[t, :, j])
        for t in range(types) for j, k in enumerate(keep)
    ])  # fmt: skip


@compiled_without_lock
def _resample(row, lam, point, start, stride, out):
    size = lam.size
    total = 0.0
    for i in range(size):
        total += lam[i]
    step = total / size
    threshold, source, cumulative, place = point * step, 0, float(lam[0]), start
    for _ in range(size):
        while cumulative < threshold and source < size - 1:
            source += 1
            cumulative += lam[source]
        out[0, place] = row[0, source]
        out[1, place] = row[1, source]
        out[2, place] = row[2, source]
        threshold += step
        place += stride
        if place >= size:
            place -= size


def _share(function: Callable, size: int, tasks: list[tuple]) -> list:
    """:func:`in_threads` for large clouds."""
    return in_threads(function, tasks) if size >= _SMALL else [function(*task) for task in tasks]


def sample_births(
    rng: np.random.Generator, parameters: Parameters, agent: np.ndarray, scan: Scan, likely: np.ndarray, out: np.ndarray
):
    """Particles x, y, u of the features born from the ``likely`` measurements into ``out`` (T, 3, B, N)."""
    size = len(agent)
    heading = agent[:, HEADING]
    columns = np.stack([agent[:, 0], agent[:, 1], np.cos(heading), np.sin(heading), agent[:, BIAS]])
    pool = rng.standard_normal(4 * size + 1024)
    tasks = []
    for j, m in enumerate(likely):
        sigma = np.sqrt(np.diag(scan.covariance[m]))
        deviation = float(np.sqrt(parameters.amplitude.variance(scan.amplitude[m])))
        for t, form in enumerate(parameters.types):
            draws = rng.integers(0, 3 * size + 1024, 3), rng.random(), int(rng.integers(0, size))
            tasks.append(
                (
                    int(form), columns, parameters.anchor, scan.distance[m], scan.aoa[m], scan.aod[m],
                    scan.amplitude[m], sigma, deviation, pool, *draws, stride(size), out[t, :, j],
                )
            )  # fmt: skip
    _share(_sample_birth, size, tasks)


@compiled_without_lock
def _sample_birth(
    form, agent, anchor, distance, aoa, aod, amplitude, sigma, deviation, pool, offsets, point, start, stride, out
):  # fmt: skip
    """Particles of one birth: proposed from two measured quantities, resampled by the chord of the third, scattered over
    the row.

    agent (5, N) = x, y, cosine and sine of the heading, bias; normals are read from ``pool`` at ``offsets``.
    """
    size = agent.shape[1]
    qx, qy, weight, exponent = np.empty(size), np.empty(size), np.empty(size), np.zeros(size)
    turn = sigma[2] if form == PS else sigma[1]
    gain = 0.5 / sigma[1] ** 2 if form == PS else 0.5 / sigma[2] ** 2
    least = np.inf
    for i in range(size):
        length = distance - agent[4, i] + sigma[0] * pool[offsets[0] + i]
        # A turn by a small angle as a point on the circle: x = tan(angle / 2) to second order.
        half = 0.5 * turn * pool[offsets[1] + i]
        half *= 1 + half * half / 3
        norm = 1 / (1 + half * half)
        c, s = (1 - half * half) * norm, 2 * half * norm
        px, py, ca, sa = agent[0, i], agent[1, i], agent[2, i], agent[3, i]
        if form == PS:
            nx, ny = aod[0] * c - aod[1] * s, aod[1] * c + aod[0] * s
            wx, wy = px - anchor[0], py - anchor[1]
            slack = length * length - wx * wx - wy * wy
            reach = max(0.5 * slack / (length - wx * nx - wy * ny), 1e-3)
            x, y = anchor[0] + reach * nx, anchor[1] + reach * ny
            ex, ey = x - px, y - py
            inverse = 1 / (np.sqrt(ex * ex + ey * ey) + 1e-12)
            ex, ey = ex * inverse, ey * inverse
            across, along = ca * ex + sa * ey - aoa[0], ca * ey - sa * ex - aoa[1]
            weight[i] = reach / max(1 + ex * nx + ey * ny, 1e-9) if slack > 0 else 0.0
            exponent[i] = gain * (across * across + along * along)
        else:
            zx, zy = ca * aoa[0] - sa * aoa[1], sa * aoa[0] + ca * aoa[1]
            ex, ey = zx * c - zy * s, zy * c + zx * s
            x, y = px + length * ex, py + length * ey
            weight[i] = max(length, 1e-3)
            if form == VA_AOD:
                nx, ny = x - anchor[0], y - anchor[1]
                inverse = 1 / (np.sqrt(nx * nx + ny * ny) + 1e-12)
                nx, ny = nx * inverse, ny * inverse
                en = 2 * (ex * nx + ey * ny)
                across, along = en * nx - ex - aod[0], en * ny - ey - aod[1]
                exponent[i] = gain * (across * across + along * along)
        qx[i], qy[i] = x, y
        if weight[i] > 0:
            least = min(least, exponent[i])
    total = 0.0
    for i in range(size):
        if least == np.inf:  # no particle allows the form: any of them
            weight[i] = 1.0
        elif form != VA:
            weight[i] *= np.exp(least - exponent[i])
        total += weight[i]
    step = total / size
    threshold, source, cumulative, place = point * step, 0, weight[0], start
    for i in range(size):
        while cumulative < threshold and source < size - 1:
            source += 1
            cumulative += weight[source]
        out[0, place], out[1, place] = qx[source], qy[source]
        out[2, place] = max(amplitude + deviation * pool[offsets[2] + i], 0.5)
        threshold += step
        place += stride
        if place >= size:
            place -= size
