"""Coarse search of beam-swept links: a staged matched filter over delay x AOA x AOD x speed.

The full grid of a swept link with cylindrical arrays has about 1e8 cells. Three stages narrow it down, none of them with a threshold:

1. energy (non-coherent over symbols) of every delay x AOA cell, from the receive covariance matrix per delay; the best cells stay;
2. coherent over the sweeps, non-coherent over the beams, for every speed at those cells; the best cell-speed pairs stay;
3. fully coherent over beams for every AOD.

The decision is left to the likelihood ratio after refinement. Combiner settings held in turn by a beam act as further receive elements.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..signal.algebra import Blocks, coherence, gram_diagonal
from ..signal.directions import Float, tangents
from ..signal.model import SignalModel
from ..signal.paths import Geometry
from .grids import DelayGrid, View, direction_grid
from .kernels import derotated, speed_energy
from .refine import metric

C64 = np.complex64


@dataclass(frozen=True, slots=True)
class Effort:
    """How much of the grid a search looks at: the most energetic delays (None: all), then cells, then cell-speed pairs."""

    delays: int | None
    cells: int
    pairs: int
    candidates: int


@dataclass(frozen=True, eq=False)
class StagedSearch:
    """Dictionaries of the staged search, prepared once.

    Attributes
    ----------
    delay : delay cells
    arrivals, departures : (A, 3), (D, 3) direction cells
    speeds : (V,) [m/s]
    order : (Q, B) symbol numbers (of the first combiner setting)
    gather : (N,) symbol order in which the combiner settings of a beam are adjacent, or None with a single setting
    arrival_vectors : (S * M, A) unit-norm receive responses, conjugated for matched filtering
    arrival_pairs : (2 * (S * M)^2, A) their outer products, real and imaginary parts
    departure_vectors : (Q, D) unit-norm beam gains, conjugated
    cosine, sine : (Q, B, V) of the phase that undoes a trial speed
    full, quick : efforts of the final and of the early passes, in which only strong paths are wanted
    """

    delay: DelayGrid
    arrivals: Float
    departures: Float
    speeds: Float
    order: np.typing.NDArray[np.intp]
    gather: np.typing.NDArray[np.intp] | None
    arrival_vectors: np.typing.NDArray[C64]
    arrival_pairs: np.typing.NDArray[np.float32]
    departure_vectors: np.typing.NDArray[C64]
    cosine: np.typing.NDArray[np.float32]
    sine: np.typing.NDArray[np.float32]
    full: Effort
    quick: Effort = Effort(delays=40, cells=400, pairs=400, candidates=6)

    @staticmethod
    def build(
        model: SignalModel,
        max_delay: float,
        max_speed: float,
        arrival_view: View,
        departure_view: View,
        oversampling: float = 1.5,
        retained: float = 0.65,
        keep_cells: int = 6000,
        keep_pairs: int = 5000,
        candidates: int = 10,
    ) -> StagedSearch:
        """Prepare the dictionaries; ``retained`` is the least energy a direction keeps in its nearest cell."""
        waveform, schedule = model.waveform, model.schedule
        slots = schedule.slots()
        delay = DelayGrid.build(
            waveform.frequencies, waveform.spacing, waveform.bandwidth, max_delay, oversampling
        )
        time = model.bands[0].modes[1]
        settings = [0] if schedule.combiners is None else list(schedule.combiner_index[slots[0, 0]])

        def received(response):
            if schedule.combiners is None:
                return response
            return np.concatenate([response @ time.combiners[s].T for s in settings], axis=1)

        book = schedule.precoders[schedule.precoder_index[slots[0, :, 0]]]

        def beams(response):
            return response.conj() @ book.T

        arrivals = direction_grid(arrival_view, model.receiver, retained, received)
        departures = direction_grid(departure_view, model.transmitter, retained, beams)
        vectors = [
            seen(array.response(grid)[0]).T
            for seen, array, grid in (
                (received, model.receiver, arrivals),
                (beams, model.transmitter, departures),
            )
        ]
        arrival, departure = (v / np.maximum(np.linalg.norm(v, axis=0), 1e-300) for v in vectors)
        pairs = (arrival[:, None] * arrival.conj()).reshape(-1, arrival.shape[1])
        speeds = speed_grid(model, max_speed, oversampling)
        phase = -2 * np.pi / waveform.wavelength * schedule.times[slots[:, :, 0]].T[:, :, None] * speeds
        gather = None if len(settings) == 1 else slots.ravel()
        order = (
            slots[:, :, 0].T if gather is None else np.arange(slots[:, :, 0].size).reshape(slots.shape[:2]).T
        )
        return StagedSearch(
            delay,
            arrivals,
            departures,
            speeds,
            np.ascontiguousarray(order),
            gather,
            arrival.conj().astype(C64),
            np.concatenate([pairs.real, -pairs.imag]).astype(np.float32),
            departure.conj().astype(C64),
            np.cos(phase).astype(np.float32),
            np.sin(phase).astype(np.float32),
            Effort(None, keep_cells, keep_pairs, candidates),
        )

    def filtered(self, model: SignalModel, signal):
        """Matched filter of a whitened signal over the delay cells (L, snapshots, elements)."""
        if self.gather is not None:
            signal = signal[:, self.gather]
        rows = self.order.size
        return self.delay.apply(signal.reshape(len(signal), -1)).reshape(len(self.delay.delays), rows, -1)

    def without(self, model: SignalModel, filtered, blocks: Blocks, gain):
        """The filtered signal less that of given paths (a new array)."""
        modes = blocks[0]
        left = self.delay.apply((modes[0][:, 0] * gain[:, None]).T.astype(C64))
        right = modes[1][:, 0]
        for mode in modes[2:]:
            right = (right[:, :, None] * mode[:, None, 0]).reshape(len(gain), -1)
        if self.gather is not None:
            right = right.reshape(len(gain), len(self.gather), -1)[:, self.gather].reshape(len(gain), -1)
        return filtered - (left @ right.astype(C64)).reshape(filtered.shape)

    def candidates(self, model: SignalModel, filtered, effort: Effort) -> Geometry:
        """The best mutually incoherent grid points in a filtered residual, strongest first."""
        chosen = None
        if effort.delays is not None and effort.delays < len(filtered):
            parts = filtered.reshape(len(filtered), -1).view(np.float32)
            chosen = np.sort(_largest(np.einsum("lx,lx->l", parts, parts), effort.delays))
            filtered = filtered[chosen]
        delay, arrival, symbols = self._cells(filtered, effort.cells)
        cell, speed, beams = self._pairs(symbols, effort.pairs)
        best = _largest(self._departures(beams), 8 * effort.candidates)
        # All AODs of the best pairs compete again: a pair's second-best beam may be the true one where an array has near-ambiguities.
        part = beams[best] @ self.departure_vectors
        row, departure = np.unravel_index(
            _largest((part.real**2 + part.imag**2).ravel(), 24 * effort.candidates), part.shape
        )
        best = best[row]
        delay = delay[cell[best]]
        geometry = Geometry(
            self.delay.delays[delay if chosen is None else chosen[delay]],
            self.arrivals[arrival[cell[best]]],
            self.departures[departure],
            self.speeds[speed[best]],
        )
        return geometry.take(lobes(model, geometry, effort.candidates))

    def _cells(self, filtered, keep: int):
        """Stage 1: delay and AOA numbers of the most energetic cells, and their symbols (cells, N)."""
        covariance = np.matmul(filtered.conj().swapaxes(1, 2), filtered).reshape(len(filtered), -1)
        # Re(a^H R a) of all cells as one real product.
        energy = np.concatenate([covariance.real, covariance.imag], axis=1) @ self.arrival_pairs
        best = np.sort(_largest(energy.ravel(), keep))
        delay, arrival = np.unravel_index(best, energy.shape)
        symbols = np.empty((len(best), filtered.shape[1]), C64)
        edges = np.searchsorted(delay, np.arange(len(filtered) + 1))
        for number in np.flatnonzero(np.diff(edges)):
            part = slice(edges[number], edges[number + 1])
            np.matmul(self.arrival_vectors.T[arrival[part]], filtered[number].T, out=symbols[part])
        return delay, arrival, symbols

    def _pairs(self, symbols, keep: int):
        """Stage 2: cell and speed numbers of the best pairs, and their derotated beams (pairs, Q)."""
        energy = np.empty((len(symbols), len(self.speeds)), np.float32)
        speed_energy(symbols, self.order, self.cosine, self.sine, energy)
        cell, speed = np.unravel_index(_largest(energy.ravel(), keep), energy.shape)
        beams = np.empty((len(cell), len(self.order)), C64)
        derotated(symbols, self.order, self.cosine, self.sine, cell, speed, beams)
        return cell, speed, beams

    def _departures(self, beams, chunk: int = 512):
        """Stage 3: the energy of every pair at its best AOD; in chunks that stay in the cache."""
        energy = np.empty(len(beams), np.float32)
        for start in range(0, len(beams), chunk):
            part = beams[start : start + chunk] @ self.departure_vectors
            energy[start : start + chunk] = (part.real**2 + part.imag**2).max(axis=1)
        return energy


def speed_grid(model: SignalModel, max_speed: float, oversampling: float) -> Float:
    """Trial speeds [m/s] over +-max_speed, ``oversampling`` per wavelength over duration."""
    duration = np.ptp(model.schedule.times)
    if duration == 0 or max_speed == 0:
        return np.zeros(1)
    count = int(np.ceil(2 * max_speed * duration / model.waveform.wavelength * oversampling)) + 1
    return np.linspace(-max_speed, max_speed, count)


def _largest(values, count: int):
    """Indices of the ``count`` largest values, largest first."""
    count = min(count, len(values))
    best = np.argpartition(values, len(values) - count)[len(values) - count :]
    return best[np.argsort(values[best])[::-1]]


def lobes(model: SignalModel, geometry: Geometry, count: int, radius: float = 1.6):
    """Indices of up to ``count`` points, in the given order, that lie in different lobes of the ambiguity function.

    Two points share a lobe if they are within ``radius`` in the metric of the normalized information (a uniform aperture has its
    first null at 1.8). Mere coherence would let one grid point hide a different lobe, and the higher peak may be in that one.
    """
    matrices = metric(gram_diagonal(model.evaluate(geometry), model.columns), model.active)
    left = np.ones(len(geometry), bool)
    kept: list[int] = []
    while left.any() and len(kept) < count:
        first = int(np.argmax(left))
        kept.append(first)
        step = displacement(geometry.take([first]), geometry)
        left &= np.einsum("pa,ab,pb->p", step, matrices[first], step) > radius**2
        left[first] = False
    return np.array(kept, int)


def displacement(start: Geometry, end: Geometry) -> Float:
    """Steps (P, 6) that lead from ``start`` (broadcast) to ``end``, directions along great circles."""
    columns = [(end.delay - start.delay)[:, None]]
    for one, other in ((start.arrival, end.arrival), (start.departure, end.departure)):
        along = np.einsum("pti,pi->pt", np.broadcast_to(tangents(one), (len(end), 2, 3)), other)
        angle = np.arctan2(np.linalg.norm(along, axis=1), np.sum(one * other, axis=1))
        columns.append(along * (angle / np.maximum(np.sin(angle), 1e-12))[:, None])
    return np.concatenate([*columns, (end.speed - start.speed)[:, None]], axis=1)


def distinct(model: SignalModel, geometry: Geometry, energy, count: int, limit: float):
    """Indices of up to ``count`` points, strongest first, whose signatures are less than ``limit`` coherent with all kept before.

    Coherence rather than distance in the parameters: it knows about endfire aliases and about any array's ambiguities.
    """
    overlap = coherence(model, geometry)
    kept: list[int] = []
    for index in np.argsort(energy)[::-1]:
        if all(overlap[index, kept] < limit):
            kept.append(int(index))
            if len(kept) == count:
                break
    return np.array(kept, int)
