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
def peak_power(parts):
    """Largest ``|x|^2`` of a complex array given as interleaved real parts (2n,)."""
    peak = np.float32(0)
    for i in range(len(parts) // 2):
        re, im = parts[2 * i], parts[2 * i + 1]
        peak = max(peak, re * re + im * im)
    return peak


@compiled
def above(parts, least, index, power):
    """Positions and ``|x|^2`` of the entries above ``least``, as many as fit; returns their number."""
    count = 0
    for i in range(len(parts) // 2):
        re, im = parts[2 * i], parts[2 * i + 1]
        value = re * re + im * im
        if value > least and count < len(index):
            index[count] = i
            power[count] = value
            count += 1
    return count
