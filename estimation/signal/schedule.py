"""Pilot schedule: what is sent and received at which time.

Symbol ``n`` is at ``times[n]`` (relative to the burst center), is precoded with the pilot vector ``p_n`` and
combined with the matrix ``W_n`` of eq. (2). Both are codebooks with an index per symbol; either may be
absent, and that end is then fully digital. Its pilots may lie beside those of the waveform, as in the staggered combs of
positioning signals (:mod:`~.nr`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import ModelError
from .directions import Float

Complex = np.typing.NDArray[Any]  # complex128; what numpy infers is wider
Index = np.typing.NDArray[np.intp]
ORDERS = ("linear", "permuted", "same_permutation", "dwell")


@dataclass(frozen=True, eq=False)
class Schedule:
    """Times, pilot vectors and combiners of the N symbols of one burst.

    Parameters
    ----------
    times : (N,) symbol times [s], centered by the constructor (the middle of first and last is 0)
    precoders : (Q, N_T) pilot vectors, or None for a transmitter whose elements are observed separately
    precoder_index : (N,) row of ``precoders`` used by each symbol
    combiners : (S, N_R, M) combining matrices, or None for a digital receiver
    combiner_index : (N,) which combiner each symbol uses
    offsets : (N,) by how much the pilots of each symbol lie above the waveform's [Hz], or None for not at all
    """

    times: Float
    precoders: Complex | None = None
    precoder_index: Index | None = None
    combiners: Complex | None = None
    combiner_index: Index | None = None
    offsets: Float | None = None

    def __post_init__(self) -> None:
        times = np.asarray(self.times, float)
        if times.ndim != 1 or not len(times) or not np.isfinite(times).all():
            raise ModelError("Schedule: times must be a finite vector (N,) in seconds")
        object.__setattr__(self, "times", times - 0.5 * (times.min() + times.max()))
        if self.offsets is not None:
            offsets = np.asarray(self.offsets, float)
            if offsets.shape != times.shape or not np.isfinite(offsets).all():
                raise ModelError(
                    f"Schedule: offsets must be a finite frequency in Hz for each of {len(times)} symbols, got shape "
                    f"{offsets.shape}"
                )
            object.__setattr__(self, "offsets", offsets if offsets.any() else None)
        for name, dimensions in (("precoder", 2), ("combiner", 3)):
            book, index = getattr(self, name + "s"), getattr(self, name + "_index")
            if book is None:
                continue
            book = np.asarray(book, complex)
            if book.ndim != dimensions or not np.isfinite(book).all():
                raise ModelError(
                    f"Schedule: {name}s must be a finite array of {dimensions} dimensions, got shape {book.shape}"
                )
            index = np.zeros(len(times), int) if index is None and len(book) == 1 else np.asarray(index)
            if index.shape != times.shape or index.min() < 0 or index.max() >= len(book):
                raise ModelError(
                    f"Schedule: {name}_index must hold one row number below {len(book)} for each of "
                    f"{len(times)} symbols"
                )
            object.__setattr__(self, name + "s", book)
            object.__setattr__(self, name + "_index", index)

    @property
    def symbols(self) -> int:
        """Number of symbols N."""
        return len(self.times)

    def slots(self) -> Index:
        """Symbol numbers (B, Q, S) by sweep, precoder and combiner: as many of each pair as there are of the rarest (a
        symbol may have been lost).

        Raises
        ------
        ModelError
            if a pair of a precoder and a combiner in use never occurs.
        """
        q = np.zeros(self.symbols, int) if self.precoder_index is None else self.precoder_index
        s = np.zeros(self.symbols, int) if self.combiner_index is None else self.combiner_index
        beams, q = np.unique(q, return_inverse=True)
        settings, s = np.unique(s, return_inverse=True)
        pair = q * len(settings) + s
        uses = np.bincount(pair, minlength=len(beams) * len(settings))
        if not uses.min():
            raise ModelError(
                "Schedule: a staged search needs every pair of beam and combiner at least once; "
                f"here {int(np.sum(uses == 0))} of {len(uses)} never occur"
            )
        order = np.lexsort((self.times, pair))
        first = np.concatenate([[0], np.cumsum(uses)[:-1]])
        order = order[first[:, None] + np.arange(uses.min())].reshape(len(beams), len(settings), uses.min())
        return np.moveaxis(order, 2, 0)


def digital(symbols: int, period: float) -> Schedule:
    """``symbols`` symbols ``period`` [s] apart, both ends fully digital."""
    return Schedule(period * np.arange(symbols))


def sweep(
    beams: Complex,
    sweeps: int,
    period: float,
    order: str = "permuted",
    combiners: Complex | None = None,
    rng: np.random.Generator | None = None,
    stagger: Float | None = None,
) -> Schedule:
    """All ``beams`` (Q, N_T), ``sweeps`` times, one symbol each ``period`` [s].

    ``order``: ``linear``; ``permuted`` (a fresh random permutation in every sweep, the one without Doppler
    ambiguity);
    ``same_permutation``; ``dwell`` (all repetitions of a beam in a row). With ``combiners`` (S, N_R, M) each
    beam is held for the S
    combiners in turn, which keeps the combiners of one beam close in time. With ``stagger`` (L,) it is held for L symbols
    (times S) whose pilots are shifted by so much [Hz]: one whole pattern of a staggered comb.
    """
    beams = np.asarray(beams, complex)
    if order not in ORDERS:
        raise ModelError(f"sweep: order must be one of {', '.join(ORDERS)}; got {order!r}")
    if rng is None:
        if order in ("permuted", "same_permutation"):
            raise ModelError(f"sweep: order {order!r} needs rng=np.random.default_rng(seed)")
        rng = np.random.default_rng(0)  # never drawn from
    count, settings = len(beams), 1 if combiners is None else len(combiners)
    shifts = np.zeros(1) if stagger is None else np.asarray(stagger, float)
    if order == "dwell":
        index = np.repeat(np.arange(count), sweeps)
    elif order == "permuted":
        index = np.concatenate([rng.permutation(count) for _ in range(sweeps)])
    elif order == "same_permutation":
        index = np.tile(rng.permutation(count), sweeps)
    else:
        index = np.tile(np.arange(count), sweeps)
    held = len(shifts) * settings
    times = period * np.arange(count * sweeps * held)
    return Schedule(
        times,
        beams,
        np.repeat(index, held),
        combiners,
        None if combiners is None else np.tile(np.arange(settings), count * sweeps * len(shifts)),
        None if stagger is None else np.tile(np.repeat(shifts, settings), count * sweeps),
    )


def simultaneous(elements: int, symbols: int, period: float, stagger: Float | None = None) -> Schedule:
    """``symbols`` symbols every ``period`` [s] in each of which all ``elements`` send and can be told apart (by cyclic shifts
    or covers, as the ports of an SRS): each is a precoder of its own at that time, the first element's symbol first.

    ``stagger`` (L,) are the shifts of the pilots [Hz] from symbol to symbol, over and over.
    """
    times = period * np.arange(symbols)
    shifts = None if stagger is None else np.resize(np.asarray(stagger, float), symbols)
    return Schedule(
        np.repeat(times, elements),
        antenna_switching(elements),
        np.tile(np.arange(elements), symbols),
        offsets=None if shifts is None else np.repeat(shifts, elements),
    )


def random_phase_beams(count: int, elements: int, rng: np.random.Generator) -> Complex:
    """Unit-norm beams (count, elements) with independent uniform phases."""
    return np.exp(2j * np.pi * rng.random((count, elements))) / np.sqrt(elements)


def dft_beams(rows: int, columns: int) -> Complex:
    """Orthonormal two-dimensional DFT beams (rows * columns, rows * columns) of a :func:`~estimation.ura`."""

    def dft(n: int) -> Complex:
        index = np.arange(n) - (n - 1) / 2
        return np.exp(2j * np.pi * np.outer(index, index) / n) / np.sqrt(n)

    return np.kron(dft(rows), dft(columns))


def antenna_switching(elements: int) -> Complex:
    """One element after the other: the identity codebook (elements, elements)."""
    return np.eye(elements, dtype=complex)
