"""Compiled inner loops of the coarse search."""

from __future__ import annotations

import numpy as np

from ..jit import compiled

STRIP = 256
"""Entries looked at together: the largest of them is found in vector registers."""


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
def scan(parts, floor, share, index, power):
    """Positions and ``|x|^2`` of the entries of a complex array (interleaved real parts, (2n,)) above ``floor`` and
    ``share`` of the peak so far; returns their number and the level that the last of them had to pass.

    A full list raises the level to twice its own and goes on.
    """
    size = len(parts) // 2
    values = np.empty(STRIP, np.float32)
    least, count = floor, 0
    for start in range(0, size, STRIP):
        width = min(STRIP, size - start)
        strip = parts[2 * start : 2 * (start + width)]
        for i in range(width):
            re, im = strip[2 * i], strip[2 * i + 1]
            values[i] = re * re + im * im
        # Counting fits vector registers, finding the largest does not.
        high = 0
        for i in range(width):
            high += values[i] > least
        if high == 0:
            continue
        for i in range(width):
            least = max(least, share * values[i])
        for i in range(width):
            if values[i] > least:
                if count == len(index):
                    least *= np.float32(2)
                    kept = 0
                    for j in range(count):
                        if power[j] > least:
                            index[kept], power[kept] = index[j], power[j]
                            kept += 1
                    count = kept
                if count < len(index) and values[i] > least:
                    index[count], power[count] = start + i, values[i]
                    count += 1
    return count, least


@compiled
def screen(values, shape, cells, n0, w0, n1, w1, n2, w2, n3, w3, energy, best):
    """Energy that high cells have at the best points about them, and which points those are.

    For a single path the spectrum is a product over the four axes, and so are the gains from moving along each;
    ``n`` (C, n) and ``w`` (C, J, n) are neighbors and weights of an axis as in :class:`~.cells.Cells`.
    """
    for p in range(cells.shape[1]):
        c0, c1, c2, c3 = cells[0, p], cells[1, p], cells[2, p], cells[3, p]
        s2 = shape[3]
        s1 = s2 * shape[2]
        s0 = s1 * shape[1]
        base = c0 * s0 + c1 * s1 + c2 * s2 + c3
        own = values[base]
        start = own.real * own.real + own.imag * own.imag
        total = start
        total *= _best_point(values, base - c0 * s0, s0, n0[c0], w0[c0], best[0], p) / start
        total *= _best_point(values, base - c1 * s1, s1, n1[c1], w1[c1], best[1], p) / start
        total *= _best_point(values, base - c2 * s2, s2, n2[c2], w2[c2], best[2], p) / start
        total *= _best_point(values, base - c3, 1, n3[c3], w3[c3], best[3], p) / start
        energy[p] = total


@compiled
def _best_point(values, base, stride, neighbors, weights, best, p):
    peak = np.float32(0)
    for j in range(len(weights)):
        re = np.float32(0)
        im = np.float32(0)
        for k in range(len(neighbors)):
            x, w = values[base + neighbors[k] * stride], weights[j, k]
            re += x.real * w.real - x.imag * w.imag
            im += x.real * w.imag + x.imag * w.real
        value = re * re + im * im
        if value > peak:
            peak = value
            best[p] = j
    return peak
