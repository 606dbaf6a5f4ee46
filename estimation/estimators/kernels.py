"""Compiled inner loops of the coarse search."""

from __future__ import annotations

import numpy as np

from ..jit import compiled

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
def scan(cells, first, speed, arrival, departure, trifle, scale, floor, share, index, power):
    """Positions and ``|x|^2`` of the entries of a spectrum less its known paths that stand above ``floor`` and
    ``share`` of the peak so far; returns their number and the level that the last of them had to pass.

    ``cells`` (L, V, A, 2D) hold real and imaginary parts in turn. The paths are outer products of ``first`` (P, L),
    ``speed`` (P, V), ``arrival`` (P, A) and ``departure`` (P, 2, 2D), which has each row and j times the row; in rows
    where the energy of the first three falls below ``trifle`` (P,) a path is left. ``scale`` (L,) multiplies all
    values. A full list raises the level to twice its own and goes on.
    """
    delays, speeds, arrivals, width = cells.shape
    count_d = width // 2
    row, values = np.empty(width, np.float32), np.empty(count_d, np.float32)
    along = np.empty(len(first), np.complex64)
    least, count = floor, 0
    for i in range(delays):
        gain = scale[i] * scale[i]
        for j in range(speeds):
            for p in range(len(first)):
                along[p] = first[p, i] * speed[p, j]
            for k in range(arrivals):
                source = cells[i, j, k]
                for d in range(width):
                    row[d] = source[d]
                for p in range(len(first)):
                    c = along[p] * arrival[p, k]
                    re, im = c.real, c.imag
                    if re * re + im * im > trifle[p]:
                        plain, turned = departure[p, 0], departure[p, 1]
                        for d in range(width):
                            row[d] -= re * plain[d] + im * turned[d]
                for d in range(count_d):
                    re, im = row[2 * d], row[2 * d + 1]
                    values[d] = gain * (re * re + im * im)
                # Counting fits vector registers, finding the largest does not.
                high = 0
                for d in range(count_d):
                    high += values[d] > least
                if high == 0:
                    continue
                for d in range(count_d):
                    least = max(least, share * values[d])
                start = ((i * speeds + j) * arrivals + k) * count_d
                for d in range(count_d):
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
def screen(values, first, speed, arrival, departure, high, n0, w0, n1, w1, n2, w2, n3, w3, energy, best):
    """Energy that high cells have at the best points about them, and which points those are.

    For a single path the spectrum is a product over the four axes, and so are the gains from moving along each;
    ``values`` (L, V, A, D) less the known paths, whose factors are (P, L), (P, V), (P, A) and (P, D); ``high`` (4, H)
    the cells; ``n`` (C, n) and ``w`` (C, J, n) neighbors and weights of an axis as in :class:`~.cells.Cells`.
    """
    paths = len(first)
    near = np.empty(n2.shape[1] + n3.shape[1] + n0.shape[1] + n1.shape[1], np.complex64)
    for h in range(high.shape[1]):
        i, j, k, d = high[0, h], high[1, h], high[2, h], high[3, h]
        for m in range(n0.shape[1]):
            near[m] = values[n0[i, m], j, k, d]
        for p in range(paths):
            c = speed[p, j] * arrival[p, k] * departure[p, d]
            for m in range(n0.shape[1]):
                near[m] -= c * first[p, n0[i, m]]
        # The first neighbor is the cell itself.
        start = near[0].real * near[0].real + near[0].imag * near[0].imag
        total = _best_point(near, w0[i], best[0], h)
        for m in range(n1.shape[1]):
            near[m] = values[i, n1[j, m], k, d]
        for p in range(paths):
            c = first[p, i] * arrival[p, k] * departure[p, d]
            for m in range(n1.shape[1]):
                near[m] -= c * speed[p, n1[j, m]]
        total *= _best_point(near, w1[j], best[1], h) / start
        for m in range(n2.shape[1]):
            near[m] = values[i, j, n2[k, m], d]
        for p in range(paths):
            c = first[p, i] * speed[p, j] * departure[p, d]
            for m in range(n2.shape[1]):
                near[m] -= c * arrival[p, n2[k, m]]
        total *= _best_point(near, w2[k], best[2], h) / start
        for m in range(n3.shape[1]):
            near[m] = values[i, j, k, n3[d, m]]
        for p in range(paths):
            c = first[p, i] * speed[p, j] * arrival[p, k]
            for m in range(n3.shape[1]):
                near[m] -= c * departure[p, n3[d, m]]
        energy[h] = total * _best_point(near, w3[d], best[3], h) / start


@compiled
def _best_point(near, weights, best, h):
    peak = np.float32(0)
    for j in range(len(weights)):
        re = np.float32(0)
        im = np.float32(0)
        for k in range(weights.shape[1]):
            x, w = near[k], weights[j, k]
            re += x.real * w.real - x.imag * w.imag
            im += x.real * w.imag + x.imag * w.real
        value = re * re + im * im
        if value > peak:
            peak = value
            best[h] = j
    return peak
