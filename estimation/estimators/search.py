"""Coarse search of beam-swept links: a staged matched filter over delay x AOA x AOD x speed.

The full grid of a swept link with cylindrical arrays has about 1e8 cells. Three stages narrow it down, none
of them with a threshold:

1. energy (non-coherent over symbols) of every delay x AOA cell, from the receive covariance matrix per delay;
the best cells stay;
2. coherent over the sweeps, non-coherent over the beams, for every speed at those cells; the best cell-speed
pairs stay;
3. fully coherent over beams for every AOD.

Where the pilots shift from symbol to symbol, cells beyond the comb's own range of delays are told apart with the speeds in
the second stage. The decision is left to the likelihood ratio after refinement. Combiner settings held in turn by a beam act as
further receive elements.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg.blas import cgemm  # pyright: ignore[reportAttributeAccessIssue]

from ..signal.algebra import Blocks
from ..signal.arrays import Complex
from ..signal.directions import Float
from ..signal.model import SignalModel
from ..signal.modes import TimeMode
from ..signal.paths import Geometry
from .grids import DelayGrid, View, direction_grid, over_ranges, speed_grid
from .kernels import add_power, derotated, row_peaks
from .lobes import RADIUS, LobeMap
from .polish import CellProjector, ResidualProjector
from .projector import Projector
from .realforms import real_pairs, real_product, real_rows, stacked_product

C64 = np.complex64
RIVAL = 0.35
"""Another lobe is worth a look if its best grid cell holds this share of the found peak's energy
(its delay and speed are those of the wrong lobe, and the cell is off the peak)."""
CHUNK = 512
"""Rows worked on at a time, so that intermediate results stay in the second-level cache."""


@dataclass(frozen=True, slots=True)
class Effort:
    """How much of the grid a search looks at: the most energetic delays (None: all), then cells, then
    cell-speed pairs.
    """

    delays: int | None
    cells: int
    pairs: int
    candidates: int


@dataclass(frozen=True, eq=False)
class StagedSearch:
    """Dictionaries of the staged search, prepared once.

    Attributes
    ----------
    delay : delay cells of one symbol
    delays : (A * L,) [s] of all symbols together, range by range of one symbol
    arrivals, departures : (A, 3), (D, 3) direction cells
    speeds : (V,) [m/s]
    order : (Q, 2B) where the real, then the imaginary parts of the sweeps of each beam are found
    gather : (N,) symbol order in which the combiner settings of a beam are adjacent, or None with a single
        setting
    arrival_vectors : (A, 2, 2 * S * M) unit-norm receive responses, conjugated, as in :func:`real_rows`
    arrival_pairs : ((2 * S * M)^2, A) their outer products, in the real form of :func:`real_pairs`
    departure_vectors : (2 * Q, 2 * D) unit-norm beam gains, conjugated, in the real form of
        :func:`real_product`
    derotation : (Q, 2 * B, 2 * A * V) phases that undo a trial speed in one of A ranges of delay, for stacked real and
        imaginary parts
    phase : (A * V, Q, B) the same as complex numbers
    shifts : (snapshots,) [Hz] of the pilots in the order of the slots, or None
    lobes : tells which grid points belong together
    precoders, combiners : (Q, N_T) and S times (M, N_R), in the order of the slots
    full, quick : efforts of the final and of the early passes, in which only strong paths are wanted
    """

    delay: DelayGrid
    delays: Float
    arrivals: Float
    departures: Float
    speeds: Float
    order: np.typing.NDArray[np.intp]
    gather: np.typing.NDArray[np.intp] | None
    arrival_vectors: np.typing.NDArray[np.float32]
    arrival_pairs: np.typing.NDArray[np.float32]
    departure_vectors: np.typing.NDArray[np.float32]
    derotation: np.typing.NDArray[np.float32]
    phase: np.typing.NDArray[C64]
    lobes: LobeMap
    full: Effort
    precoders: Complex
    combiners: list[Complex] | None
    shifts: Float | None = None
    quick: Effort = Effort(delays=40, cells=400, pairs=400, candidates=6)

    @property
    def snapshots(self) -> int:
        """Symbols per delay cell once combiner settings are stacked."""
        return (int(self.order.max()) + 1) // 2

    @property
    def efforts(self) -> list[Effort]:
        """The passes in order."""
        return [self.quick, self.full]

    def projector(self, data, filtered, lin, points: Geometry) -> CellProjector | ResidualProjector:
        """What candidates are polished on."""
        if data.model.subbands > 1:
            return ResidualProjector(data, lin)
        within = points.delay if self.shifts is None else points.delay % data.model.waveform.max_delay
        return CellProjector(data.model, self.delay, filtered, within, self.gather)

    @staticmethod
    def build(
        model: SignalModel,
        max_delay: float,
        max_speed: float,
        arrival_view: View,
        departure_view: View,
        oversampling: float = 1.5,
        retained: float = 0.7,
        keep_cells: int = 6000,
        keep_pairs: int = 6000,
        candidates: int = 10,
    ) -> StagedSearch:
        """Prepare the dictionaries; ``retained`` is the least energy a direction keeps in its nearest cell."""
        waveform, schedule = model.waveform, model.schedule
        slots = schedule.slots()
        reach = max_delay if schedule.offsets is None else min(max_delay, waveform.max_delay)
        delay = DelayGrid.build(waveform.frequencies, waveform.spacing, waveform.bandwidth, reach, oversampling)
        time = model.bands[0].modes[1]
        assert isinstance(time, TimeMode) and schedule.precoders is not None and schedule.precoder_index is not None
        settings = [0] if schedule.combiner_index is None else list(schedule.combiner_index[slots[0, 0]])
        combiners = None if time.combiners is None else [time.combiners[s] for s in settings]
        book = schedule.precoders[schedule.precoder_index[slots[0, :, 0]]]

        def received(response):
            return response if combiners is None else np.concatenate([response @ c.T for c in combiners], axis=1)

        def sent(response):
            return response.conj() @ book.T

        arrivals = direction_grid(arrival_view, model.heard, retained, received)
        departures = direction_grid(departure_view, model.transmitter, retained, sent)
        vectors = [
            received(model.heard.response(arrivals)[0]).T,
            sent(model.transmitter.response(departures)[0]).T,
        ]
        arrival, departure = (v / np.maximum(np.linalg.norm(v, axis=0), 1e-300) for v in vectors)
        speeds = speed_grid(model, max_speed, oversampling)
        phase = -2 * np.pi / waveform.wavelength * schedule.times[slots[:, :, 0]].T[:, :, None] * speeds
        delays = delay.delays
        if schedule.offsets is not None:
            phase, delays = over_ranges(model, slots, phase, delays, max_delay)
        # Where a symbol was lost the search does without those that would make up for it; fits use all that there are.
        gather = None if len(settings) == 1 and slots.size == schedule.symbols else slots.ravel()
        first = slots[:, :, 0]
        order = (first if gather is None else np.arange(first.size).reshape(first.shape)).T
        shifts = schedule.offsets
        if shifts is not None and gather is not None:
            shifts = shifts[first.ravel()]
        return StagedSearch(
            delay,
            delays,
            arrivals,
            departures,
            speeds,
            np.concatenate([order, order + first.size], axis=1),
            gather,
            real_rows(arrival.conj()),
            real_pairs(arrival).astype(np.float32),
            real_product(departure.conj()),
            np.stack([stacked_product(np.exp(1j * q)) for q in phase]),
            np.ascontiguousarray(np.exp(1j * phase).transpose(2, 0, 1)).astype(C64),
            LobeMap.build(model, delays, arrivals, departures, speeds),
            Effort(None, keep_cells, keep_pairs, candidates),
            book,
            combiners,
            shifts,
        )

    def filtered(self, data: Projector):
        """Matched filter of a whitened signal over the delay cells (L, snapshots, elements)."""
        return self.matched(data.signal)

    def matched(self, signal):
        """The same of a signal as it is."""
        if self.gather is not None:
            signal = signal[:, self.gather]
        return self.delay.apply(signal.reshape(len(signal), -1)).reshape(len(self.delay.delays), self.snapshots, -1)

    def without(self, filtered, blocks: Blocks, gain, spare=None):
        """The filtered signal less that of given paths, in an array of its own or in ``spare``, an earlier result."""
        modes = blocks[0]
        left = self.delay.apply((modes[0][:, 0] * gain[:, None]).T.astype(C64))
        right = modes[1][:, 0].astype(C64)
        for mode in modes[2:]:
            right = (right[:, :, None] * mode[:, None, 0].astype(C64)).reshape(len(gain), -1)
        if self.gather is not None:
            width = filtered[0].size // len(self.gather)
            right = right.reshape(len(gain), -1, width)[:, self.gather].reshape(len(gain), -1)
        rows = filtered.reshape(len(filtered), -1)
        out = np.empty_like(rows) if spare is None else spare.reshape(rows.shape)
        return subtracted(rows, left.T, right, out).reshape(filtered.shape)

    def candidates(
        self,
        filtered,
        effort: Effort,
        variance: float = 0.0,
        interest: float = np.inf,
        scale: Float | None = None,
    ) -> Geometry:
        """The best mutually incoherent grid points in a filtered residual, strongest first; ``scale`` (L,) gives all
        delays the same noise.
        """
        if scale is not None:
            filtered = filtered * scale[:, None, None]
        chosen = None
        if effort.delays is not None and effort.delays < len(filtered):
            parts = filtered.reshape(len(filtered), -1).view(np.float32)
            chosen = np.sort(largest(np.einsum("lx,lx->l", parts, parts), effort.delays))
            filtered = filtered[chosen]
        delay, arrival, symbols = self._cells(filtered, effort.cells)
        numbers = delay if chosen is None else chosen[delay]
        if self.shifts is not None:
            symbols = self._unshifted(symbols, numbers)
        cell, trial, beams = self._pairs(symbols, effort.pairs)
        best = largest(self._departures(beams), 8 * effort.candidates)
        # All AODs of the best pairs compete again: a pair's second-best beam may be the true one
        # where an array has near-ambiguities.
        part = beams[best].view(np.float32) @ self.departure_vectors
        power = part[:, : len(self.departures)] ** 2 + part[:, len(self.departures) :] ** 2
        row, departure = np.unravel_index(largest(power.ravel(), 24 * effort.candidates), power.shape)
        best = best[row]
        reach, speed = np.divmod(trial[best], len(self.speeds))
        delay = numbers[cell[best]] + reach * len(self.delay.delays)
        index = np.stack([delay, arrival[cell[best]], departure, speed])
        kept = self.lobes.first_of_each(index[0], index[1], index[2], index[3], effort.candidates)
        delay, arrival, departure, speed = index[:, kept]
        return Geometry(self.delays[delay], self.arrivals[arrival], self.departures[departure], self.speeds[speed])

    def alternatives(self, model: SignalModel, cells: CellProjector, found: Geometry, energy: Float) -> Geometry:
        """Directions in other lobes that could explain found peaks about as well, at the same delay and speed.

        An array's near-ambiguity (two rings, for instance, nearly confuse steep elevations above and below) may give the
        wrong lobe the better grid point; the peaks themselves must decide.
        """
        blocks = model.evaluate(found)[0]
        data = cells.at_delay(blocks[0][:, :1], np.arange(len(found))).reshape(len(found), self.snapshots, -1)
        order = np.arange(model.schedule.symbols) if self.gather is None else self.gather
        times = model.schedule.times[order].reshape(self.snapshots, -1)
        doppler = np.exp(-2j * np.pi / model.waveform.wavelength * times * found.speed[:, None, None])
        if self.shifts is not None:
            doppler *= np.exp(2j * np.pi * self.shifts[:, None] * found.delay[:, None, None])
        still = data * np.repeat(doppler, data.shape[2] // doppler.shape[2], axis=2)
        sweeps = self.phase.shape[2]
        received = self.received(model.heard.response(found.arrival)[0])
        sent = self.sent(model.transmitter.response(found.departure)[0])
        slots = self.order[:, :sweeps]
        beams = np.einsum("pnm,pm->pn", still, received.conj())[:, slots].sum(axis=2)
        ports = np.einsum("pqm,pq->pm", still[:, slots].sum(axis=2), sent.conj())
        scale = model.waveform.subcarriers * sweeps
        points = Geometry.empty()
        for end, values, vectors, grid, squared in (
            (
                "departure",
                beams,
                self.sent(model.transmitter.response(self.departures)[0]),
                self.departures,
                received,
            ),
            ("arrival", ports, self.received(model.heard.response(self.arrivals)[0]), self.arrivals, sent),
        ):
            power = np.abs(values @ vectors.conj().T) ** 2 / np.maximum(np.sum(np.abs(vectors) ** 2, axis=1), 1e-300)
            power /= np.maximum(scale * np.sum(np.abs(squared) ** 2, axis=1)[:, None], 1e-300)
            nearest = np.argmax(getattr(found, end) @ grid.T, axis=1)
            table = self.lobes.departures if end == "departure" else self.lobes.arrivals
            rival = np.where(table[nearest] > RADIUS**2, power, 0.0)
            for p, row in enumerate(rival):
                for _ in range(3):
                    best = int(np.argmax(row))
                    if row[best] <= RIVAL * energy[p]:
                        break
                    points = points.joined(replace(found.take([p]), **{end: grid[[best]]}))
                    row[table[best] <= RADIUS**2] = 0.0
        return points

    def received(self, response):
        """What a receive response (P, N_R) looks like behind all combiner settings (P, S * M)."""
        if self.combiners is None:
            return response
        return np.concatenate([response @ c.T for c in self.combiners], axis=1)

    def sent(self, response):
        """The gains (P, Q) of all beams for a transmit response (P, N_T)."""
        return response.conj() @ self.precoders.T

    def _unshifted(self, symbols, delay):
        """Symbols (cells, 2N) of delay cells with the phases undone that shifted pilots give them."""
        assert self.shifts is not None
        real, imag = np.split(symbols, 2, axis=1)
        turned = (real + 1j * imag) * np.exp(2j * np.pi * self.delay.delays[delay][:, None] * self.shifts)
        return np.concatenate([turned.real, turned.imag], axis=1, dtype=np.float32)

    def _cells(self, filtered, keep: int):
        """Stage 1: delay and AOA numbers of the most energetic cells, and their symbols (cells, 2N): real,
        then imaginary parts.
        """
        # All products of real and imaginary parts; the energy Re(a^H R a) of every cell is linear in them.
        parts = filtered.view(np.float32)
        products = np.matmul(parts.swapaxes(1, 2), parts).reshape(len(filtered), -1)
        energy = products @ self.arrival_pairs
        best = np.sort(largest(energy.ravel(), keep))
        delay, arrival = np.unravel_index(best, energy.shape)
        symbols = np.empty((len(best), 2 * filtered.shape[1]), np.float32)
        edges = np.searchsorted(delay, np.arange(len(filtered) + 1))
        width = parts.shape[2]
        for number in np.flatnonzero(np.diff(edges)):
            start, stop = edges[number], edges[number + 1]
            rows = self.arrival_vectors[arrival[start:stop]].reshape(-1, width)
            np.matmul(rows, parts[number].T, out=symbols[start:stop].reshape(len(rows), -1))
        return delay, arrival, symbols

    def _pairs(self, symbols, keep: int):
        """Stage 2: cell and speed numbers (range by range) of the best pairs, and their derotated beams (pairs, Q)."""
        energy = np.zeros((len(symbols), len(self.phase)), np.float32)
        beams, sweeps = self.order.shape
        rotated = np.empty((CHUNK, 2 * len(self.phase)), np.float32)
        for start in range(0, len(symbols), CHUNK):
            total = energy[start : start + CHUNK]
            swept = np.take(symbols[start : start + CHUNK], self.order.ravel(), axis=1)
            swept = swept.reshape(len(total), beams, sweeps)
            for q in range(beams):
                np.matmul(swept[:, q], self.derotation[q], out=rotated[: len(total)])
                add_power(rotated[: len(total)], total)
        cell, speed = np.unravel_index(largest(energy.ravel(), keep), energy.shape)
        chosen = np.empty((len(cell), beams), C64)
        derotated(symbols, self.order, self.phase, cell, speed, chosen)
        return cell, speed, chosen

    def _departures(self, beams):
        """Stage 3: the energy of every pair at its best AOD."""
        energy = np.empty(len(beams), np.float32)
        parts = beams.view(np.float32)
        for start in range(0, len(beams), CHUNK):
            row_peaks(parts[start : start + CHUNK] @ self.departure_vectors, energy[start : start + CHUNK])
        return energy


BLOCK = 1 << 17
"""Cells (or samples) worked on at a time: one megabyte, so that intermediate results stay in the second-level cache."""


def subtracted(rows, left, right, out):
    """``rows - left^T @ right`` (R, C) for factors (P, R) and (P, C), written to ``out``."""
    count = max(BLOCK // rows.shape[1], 1)
    for start in range(0, len(rows), count):
        part = slice(start, start + count)
        out[part] = rows[part]
        # In place; BLAS wants column order, that is the transposes.
        cgemm(-1.0, right.T, left[:, part], 1.0, out[part].T, overwrite_c=True)
    return out


def largest(values, count: int):
    """Indices of the ``count`` largest values, largest first."""
    count = min(count, len(values))
    best = np.argpartition(values, len(values) - count)[len(values) - count :]
    return best[np.argsort(values[best])[::-1]]


def distinct(overlap, energy, count: int, limit: float):
    """Indices of up to ``count`` points, strongest first, whose signatures are less than ``limit`` coherent
    with all kept before.

    Coherence ``overlap`` (P, P) rather than distance in the parameters: it knows about endfire aliases and
    any array's ambiguities.
    """
    kept: list[int] = []
    for index in np.argsort(energy)[::-1]:
        if all(overlap[index, kept] < limit):
            kept.append(int(index))
            if len(kept) == count:
                break
    return np.array(kept, int)
