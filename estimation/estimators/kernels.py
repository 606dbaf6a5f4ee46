"""Compiled inner loops of the coarse search."""

from __future__ import annotations

import numpy as np

from ..jit import compiled

AHEAD = 64
"""Cells whose neighbors are fetched together."""
HALF = np.float32(np.sqrt(0.5))


@compiled
def add_power(values, out):
    """Add ``|value|^2`` to ``out`` (rows, V); ``values`` (rows, 2V) hold real, then imaginary parts."""
    rows, count = out.shape
    for row in range(rows):
        for column in range(count):
            re, im = values[row, column], values[row, column + count]
            out[row, column] += re * re + im * im


@compiled
def row_peaks(values, out):
    """Largest ``|value|^2`` of each row; ``values`` (rows, 2V) hold real, then imaginary parts."""
    count = values.shape[1] // 2
    for row in range(len(values)):
        peak = np.float32(0)
        for column in range(count):
            re, im = values[row, column], values[row, column + count]
            peak = max(peak, re * re + im * im)
        out[row] = peak


@compiled
def derotated(symbols, order, phase, cells, speeds, out):
    """Beams (pairs, Q) of chosen cell and speed pairs, coherent over the sweeps.

    ``symbols`` (cells, 2N) and ``order`` (Q, 2B) hold real, then imaginary parts; ``phase`` (V, Q, B)
    complex64.
    """
    beams, sweeps = phase.shape[1:]
    for pair in range(len(cells)):
        row = symbols[cells[pair]]
        turn = phase[speeds[pair]]
        for q in range(beams):
            re = np.float32(0)
            im = np.float32(0)
            for b in range(sweeps):
                x, y, e = row[order[q, b]], row[order[q, b + sweeps]], turn[q, b]
                re += x * e.real - y * e.imag
                im += x * e.imag + y * e.real
            out[pair, q] = complex(re, im)


@compiled
def folded(signal, pilots, symbols, ports, elements, mirrored, out):
    """Planes ``out`` (2, K, N, R, T) of a signal (K, N, 2 R T; real and imaginary parts in turn) in the coordinates of
    :mod:`~.folding`.

    Each axis is a triple: first samples of its pairs, second ones, samples alone. ``mirrored`` says that the last
    axis pairs its samples from the ends inwards.
    """
    # A pair of pilots by a pair of symbols at a time: four rows that stay in the cache.
    size = signal.shape[2] // 2
    re, im = np.empty((4, size), np.float32), np.empty((4, size), np.float32)
    pairs, others, width = len(pilots[0]), len(symbols[0]), out.shape[4]
    one, other, lone = ports
    halves = len(one)
    for k in range(pairs + len(pilots[2])):
        two_k = k < pairs
        k1 = pilots[0][k] if two_k else pilots[2][k - pairs]
        k2 = pilots[1][k] if two_k else k1
        for n in range(others + len(symbols[2])):
            two_n = n < others
            n1 = symbols[0][n] if two_n else symbols[2][n - others]
            n2 = symbols[1][n] if two_n else n1
            for r in range(4):
                if (r < 2 or two_k) and (r % 2 == 0 or two_n):
                    row = signal[k1 if r < 2 else k2, n1 if r % 2 == 0 else n2]
                    a, b = re[r], im[r]
                    for i in range(size):
                        a[i] = row[2 * i]
                        b[i] = row[2 * i + 1]
            if two_k:
                _fold_rows(re, im, 0, 2)
                if two_n:
                    _fold_rows(re, im, 1, 3)
            if two_n:
                _fold_rows(re, im, 0, 1)
                if two_k:
                    _fold_rows(re, im, 2, 3)
            for r in range(4):
                if (r < 2 or two_k) and (r % 2 == 0 or two_n):
                    i = k if r < 2 and two_k else k + pairs
                    j = n if r % 2 == 0 and two_n else n + others
                    a, b = re[r].reshape((-1, width)), im[r].reshape((-1, width))
                    real, imag = out[0, i, j], out[1, i, j]
                    for m in range(halves):
                        _fold_rows(a, b, one[m], other[m])
                    for m in range(len(a)):
                        port = one[m] if m < halves else other[m - halves] if m < 2 * halves else lone[m - 2 * halves]
                        if mirrored:
                            _fold_mirrored(a[port], b[port], real[m], imag[m])
                        else:
                            _fold_tabled(a[port], b[port], elements, real[m], imag[m])


@compiled
def _fold_rows(re, im, i, j):
    half = HALF
    a, b, c, d = re[i], im[i], re[j], im[j]
    for m in range(len(a)):
        x, y = a[m] - c[m], b[m] - d[m]
        a[m] = half * (a[m] + c[m])
        b[m] = half * (b[m] + d[m])
        c[m] = half * y
        d[m] = -half * x


@compiled
def _fold_mirrored(x, y, u, v):
    half, last, count = HALF, len(x) - 1, len(x) // 2
    for t in range(count):
        u[t] = half * (x[t] + x[last - t])
        v[t] = half * (y[t] + y[last - t])
    for t in range(count):
        u[t + count] = half * (y[t] - y[last - t])
        v[t + count] = half * (x[last - t] - x[t])
    if len(x) % 2:
        u[last], v[last] = x[count], y[count]


@compiled
def _fold_tabled(x, y, elements, u, v):
    half, count = HALF, len(elements[0])
    if count == 0:
        u[:], v[:] = x, y
        return
    for t in range(count):
        i, j = elements[0][t], elements[1][t]
        u[t], v[t] = half * (x[i] + x[j]), half * (y[i] + y[j])
        u[t + count], v[t + count] = half * (y[i] - y[j]), half * (x[j] - x[i])
    for t in range(len(elements[2])):
        u[t + 2 * count], v[t + 2 * count] = x[elements[2][t]], y[elements[2][t]]


@compiled
def scan(cells, first, speed, arrival, departure, trifle, scale, floor, share, index, power):
    """Positions and ``|x|^2`` of the entries of a spectrum less its known paths that stand above ``floor`` and
    ``share`` of the peak so far; returns their number and the level that the last of them had to pass.

    ``cells`` are planes (2, L, V, A, D). The paths are outer products of ``first`` (P, L), ``speed`` (P, V),
    ``arrival`` (P, A) and ``departure`` planes (2, P, D); in rows where the energy of the first three falls below
    ``trifle`` (P,) a path is left. ``scale`` (L,) multiplies all values. A full list raises the level to twice its own
    and goes on.
    """
    _, delays, speeds, arrivals, departures = cells.shape
    re, im = np.empty(departures, np.float32), np.empty(departures, np.float32)
    values, along = np.empty(departures, np.float32), np.empty(len(first), np.complex64)
    least, count = floor, 0
    for i in range(delays):
        gain = scale[i] * scale[i]
        for j in range(speeds):
            for p in range(len(first)):
                along[p] = first[p, i] * speed[p, j]
            for k in range(arrivals):
                left = 0
                for p in range(len(first)):
                    c = along[p] * arrival[p, k]
                    x, y = c.real, c.imag
                    if x * x + y * y > trifle[p]:
                        if left == 0:
                            for d in range(departures):
                                re[d] = cells[0, i, j, k, d] - (x * departure[0, p, d] - y * departure[1, p, d])
                                im[d] = cells[1, i, j, k, d] - (x * departure[1, p, d] + y * departure[0, p, d])
                        else:
                            for d in range(departures):
                                re[d] -= x * departure[0, p, d] - y * departure[1, p, d]
                                im[d] -= x * departure[1, p, d] + y * departure[0, p, d]
                        left += 1
                if left == 0:
                    for d in range(departures):
                        re[d], im[d] = cells[0, i, j, k, d], cells[1, i, j, k, d]
                # Counting fits vector registers, finding the largest does not.
                high = 0
                for d in range(departures):
                    values[d] = gain * (re[d] * re[d] + im[d] * im[d])
                    high += values[d] > least
                if high == 0:
                    continue
                for d in range(departures):
                    least = max(least, share * values[d])
                start = ((i * speeds + j) * arrivals + k) * departures
                for d in range(departures):
                    if values[d] > least:
                        if count == len(index):
                            least *= np.float32(2)
                            kept = 0
                            for n in range(count):
                                if power[n] > least:
                                    index[kept], power[kept] = index[n], power[n]
                                    kept += 1
                            count = kept
                        if count < len(index) and values[d] > least:
                            index[count], power[count] = start + d, values[d]
                            count += 1
    return count, least


@compiled
def screen(cells, first, speed, arrival, departure, high, n0, w0, n1, w1, n2, w2, n3, w3, energy, best):
    """Energy that high cells have at the best points about them, and which points those are.

    For a single path the spectrum is a product over the four axes, and so are the gains from moving along each;
    ``cells`` planes (2, L, V, A, D) less the known paths, whose factors are planes (2, L, P), (2, V, P), (2, A, P)
    and (2, D, P); ``high`` (4, H) the cells; ``n`` (C, n) and ``w`` (C, J, n) neighbors and weights of an axis as in
    :class:`~.cells.Cells`.
    """
    paths = first.shape[2]
    flat = cells.reshape(cells.size)
    step = np.array([cells[0, 0].size, cells[0, 0, 0].size, cells.shape[4], 1])
    ends = np.cumsum(np.array([n0.shape[1], n1.shape[1], n2.shape[1], n3.shape[1]]))
    near, share = np.empty((AHEAD, 2, ends[3]), np.float32), np.empty((2, paths), np.float32)
    re, im = np.empty(ends[3], np.float32), np.empty(ends[3], np.float32)
    for begin in range(0, high.shape[1], AHEAD):
        # Neighbors lie far apart in memory: fetched for many cells before any is looked at, their waits overlap.
        many = min(AHEAD, high.shape[1] - begin)
        for g in range(many):
            i, j, k, d = high[0, begin + g], high[1, begin + g], high[2, begin + g], high[3, begin + g]
            at = i * step[0] + j * step[1] + k * step[2] + d
            _fetch(flat, at - i * step[0], step[0], i, n0, near, g, 0)
            _fetch(flat, at - j * step[1], step[1], j, n1, near, g, ends[0])
            _fetch(flat, at - k * step[2], step[2], k, n2, near, g, ends[1])
            _fetch(flat, at - d, 1, d, n3, near, g, ends[2])
        for g in range(many):
            h = begin + g
            i, j, k, d = high[0, h], high[1, h], high[2, h], high[3, h]
            # One axis at a time; the known paths are products of the other three.
            for p in range(paths):
                _keep(share, p, _at(speed, j, p) * _at(arrival, k, p) * _at(departure, d, p))
            start, peak, best[0, h] = _best_point(near, g, 0, i, n0, w0, share, first, re, im)
            total = peak
            for p in range(paths):
                _keep(share, p, _at(first, i, p) * _at(arrival, k, p) * _at(departure, d, p))
            _, peak, best[1, h] = _best_point(near, g, ends[0], j, n1, w1, share, speed, re, im)
            total *= peak / start
            for p in range(paths):
                _keep(share, p, _at(first, i, p) * _at(speed, j, p) * _at(departure, d, p))
            _, peak, best[2, h] = _best_point(near, g, ends[1], k, n2, w2, share, arrival, re, im)
            total *= peak / start
            for p in range(paths):
                _keep(share, p, _at(first, i, p) * _at(speed, j, p) * _at(arrival, k, p))
            _, peak, best[3, h] = _best_point(near, g, ends[2], d, n3, w3, share, departure, re, im)
            energy[h] = total * (peak / start)


@compiled
def _fetch(flat, base, stride, cell, neighbors, near, slot, start):
    plane = len(flat) // 2
    for m in range(neighbors.shape[1]):
        at = base + neighbors[cell, m] * stride
        near[slot, 0, start + m], near[slot, 1, start + m] = flat[at], flat[plane + at]


@compiled
def _at(factor, row, path):
    return complex(factor[0, row, path], factor[1, row, path])


@compiled
def _keep(share, path, value):
    share[0, path], share[1, path] = value.real, value.imag


@compiled
def _best_point(near, slot, start, cell, neighbors, weights, share, factor, re, im):
    """Energy at the cell, at the best point along one axis, and the number of that point; ``near[slot]`` from ``start``
    on are the neighbors.

    Everything is addressed in place: making a slice would take longer than what is computed from it.
    """
    count, paths = neighbors.shape[1], share.shape[1]
    for m in range(count):
        row = neighbors[cell, m]
        x, y = near[slot, 0, start + m], near[slot, 1, start + m]
        for p in range(paths):
            x -= share[0, p] * factor[0, row, p] - share[1, p] * factor[1, row, p]
            y -= share[0, p] * factor[1, row, p] + share[1, p] * factor[0, row, p]
        re[m], im[m] = x, y
    # The first neighbor is the cell itself.
    own = re[0] * re[0] + im[0] * im[0]
    peak, best = np.float32(0), 0
    for j in range(weights.shape[1]):
        x, y = np.float32(0), np.float32(0)
        for m in range(count):
            a, b = weights[cell, j, m].real, weights[cell, j, m].imag
            x += re[m] * a - im[m] * b
            y += re[m] * b + im[m] * a
        value = x * x + y * y
        if value > peak:
            peak, best = value, j
    return own, peak, best
