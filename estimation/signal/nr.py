"""Positioning signals of 5G NR as waveforms: PRS of the base station and SRS of the terminal, with staggered combs.

Every symbol has a pilot on each ``comb``-th subcarrier, shifted from symbol to symbol, so that the symbols together have one on
all of them (or on every second): the range of delays is that of the whole grid, the power of each symbol that of a comb. What
comes after correlation with the known sequence is the channel at the pilots; the sequence itself plays no part.

TS 38.211: PRS in 7.4.1.7.3 (combs 2, 4, 6 and 12), SRS for positioning in 6.4.1.4.3 (combs 2, 4 and 8).
"""

from __future__ import annotations

import numpy as np

from ..errors import ModelError
from .directions import Float
from .waveform import Waveform, comb

SUBCARRIERS = 12
"""Of a resource block."""
PRS = {2: (0, 1), 4: (0, 2, 1, 3), 6: (0, 3, 1, 4, 2, 5), 12: (0, 6, 3, 9, 1, 7, 4, 10, 2, 8, 5, 11)}
"""Shifts k' of a PRS by its comb, Table 7.4.1.7.3-1; repeated where it lasts longer."""
SRS = {2: (0, 1), 4: (0, 2, 1, 3), 8: (0, 4, 2, 6, 1, 5, 3, 7)}
"""Shifts of an SRS for positioning by its comb, Table 6.4.1.4.3-2; repeated where it lasts longer."""
PRS_SYMBOLS = {2: (2, 4, 6, 12), 4: (4, 12), 6: (6, 12), 12: (12,)}
SRS_SYMBOLS = {2: (1, 2, 4), 4: (2, 4, 8, 12), 8: (4, 8, 12)}
"""Symbols that a resource of each comb may last."""


def prs(
    carrier: float, spacing: float, blocks: int, comb_size: int = 4, symbols: int | None = None, offset: int = 0
) -> tuple[Waveform, Float]:
    """A downlink PRS resource.

    Parameters
    ----------
    carrier, spacing : of the OFDM grid [Hz]; its resource blocks lie symmetrically about the carrier
    blocks : resource blocks of twelve subcarriers
    comb_size : 2, 4, 6 or 12
    symbols : of the resource; default: as many as the comb has shifts
    offset : subcarrier at which the first symbol's comb starts, below ``comb_size``

    Returns
    -------
    Waveform, (L,)
        Of a comb, and the shifts of its symbols [Hz]: ``stagger`` of :func:`~estimation.sweep`.
    """
    return _staggered("prs", (PRS, PRS_SYMBOLS), carrier, spacing, blocks, comb_size, symbols, offset)


def srs(
    carrier: float, spacing: float, blocks: int, comb_size: int = 4, symbols: int | None = None, offset: int = 0
) -> tuple[Waveform, Float]:
    """An uplink SRS resource for positioning: as :func:`prs`, with combs of 2, 4 or 8.

    Ports of a terminal that differ by cyclic shifts are told apart by the correlation with the sequence; the schedule of
    several is :func:`~estimation.simultaneous`.
    """
    return _staggered("srs", (SRS, SRS_SYMBOLS), carrier, spacing, blocks, comb_size, symbols, offset)


def staggered(spacing: float, comb_size: int, shifts) -> Float:
    """(L,) [Hz] by how much combs that start at subcarriers ``shifts`` lie above one about the middle."""
    return (np.asarray(shifts, float) - (comb_size - 1) / 2) * spacing


def _staggered(name, tables, carrier, spacing, blocks, comb_size, symbols, offset) -> tuple[Waveform, Float]:
    shifts, lengths = tables
    if comb_size not in shifts:
        raise ModelError(f"{name}: comb_size must be one of {', '.join(map(str, shifts))}; got {comb_size}")
    count = len(shifts[comb_size]) if symbols is None else symbols
    if count not in lengths[comb_size]:
        allowed = ", ".join(map(str, lengths[comb_size]))
        raise ModelError(f"{name}: with a comb of {comb_size} a resource lasts {allowed} symbols; got {count}")
    if not 0 <= offset < comb_size:
        raise ModelError(f"{name}: offset must be a subcarrier below the comb's {comb_size}, got {offset}")
    if blocks < 1 or SUBCARRIERS * blocks % comb_size:
        raise ModelError(
            f"{name}: {blocks} blocks of {SUBCARRIERS} subcarriers are no whole number of combs of {comb_size}"
        )
    own = (np.resize(shifts[comb_size], count) + offset) % comb_size
    waveform = comb(carrier, spacing, SUBCARRIERS * blocks // comb_size, comb_size)
    return waveform, staggered(spacing, comb_size, own)
