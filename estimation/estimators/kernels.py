"""Compiled inner loops of the coarse search."""

from __future__ import annotations

import numpy as np

from ..jit import compiled


@compiled
def speed_energy(symbols, order, cosine, sine, out):
    """Energy (cells, V) coherent over the sweeps and summed over the beams, for every cell and trial speed.

    ``symbols`` (cells, N) complex64; ``order`` (Q, B) symbol numbers; ``cosine``, ``sine`` (Q, B, V) of the derotating phase. The beams of
    one cell stay in registers; only their energy is stored.
    """
    beams, sweeps = order.shape
    speeds = out.shape[1]
    real = np.empty(speeds, np.float32)
    imag = np.empty(speeds, np.float32)
    for cell in range(len(symbols)):
        row = out[cell]
        row[:] = 0
        for q in range(beams):
            real[:] = 0
            imag[:] = 0
            for b in range(sweeps):
                x = symbols[cell, order[q, b]]
                re, im = x.real, x.imag
                c, s = cosine[q, b], sine[q, b]
                for v in range(speeds):
                    real[v] += re * c[v] - im * s[v]
                    imag[v] += re * s[v] + im * c[v]
            for v in range(speeds):
                row[v] += real[v] * real[v] + imag[v] * imag[v]


@compiled
def derotated(symbols, order, cosine, sine, cells, speeds, out):
    """Beams (pairs, Q) of chosen cell and speed pairs, coherent over the sweeps."""
    beams, sweeps = order.shape
    for pair in range(len(cells)):
        cell, v = cells[pair], speeds[pair]
        for q in range(beams):
            total = np.complex64(0)
            for b in range(sweeps):
                total += symbols[cell, order[q, b]] * np.complex64(complex(cosine[q, b, v], sine[q, b, v]))
            out[pair, q] = total
