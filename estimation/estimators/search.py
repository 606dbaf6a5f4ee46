"""Coarse search of beam-swept links: a staged matched filter over delay x AOA x AOD x speed.

The full grid of a swept link with cylindrical arrays has about 2e8 cells. Three stages narrow it down, none of them with a threshold:

1. energy (non-coherent over symbols) of every delay x AOA cell, from the receive covariance matrix per delay; the best cells stay;
2. coherent over the sweeps, non-coherent over the beams, for every speed at those cells; the best cell-speed pairs stay;
3. fully coherent over beams for every AOD.

The decision is left to the likelihood ratio after refinement. A symbol is (sweep b, beam q, combiner s); combiner settings act as further
receive elements once the phase of a trial speed is taken out of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..signal.algebra import coherence
from ..signal.directions import Float
from ..signal.model import SignalModel
from ..signal.paths import Geometry
from .grids import DelayGrid, View, direction_grid

C64 = np.complex64


@dataclass(frozen=True, eq=False)
class StagedSearch:
    """Dictionaries of the staged search, prepared once.

    Attributes
    ----------
    delay : delay cells
    arrivals, departures : (A, 3), (D, 3) direction cells
    speeds : (V,) [m/s]
    slots : (B, Q, S) symbol numbers
    arrival_vectors : (S * M, A) unit-norm receive responses, conjugated for matched filtering
    departure_vectors : (Q, D) unit-norm beam gains, conjugated
    derotation : (Q, B, V) phases that undo a trial speed
    keep_cells, keep_pairs : how many survive stages 1 and 2
    """

    delay: DelayGrid
    arrivals: Float
    departures: Float
    speeds: Float
    slots: np.typing.NDArray[np.intp]
    arrival_vectors: np.typing.NDArray[C64]
    departure_vectors: np.typing.NDArray[C64]
    derotation: np.typing.NDArray[C64]
    keep_cells: int
    keep_pairs: int

    @staticmethod
    def build(model: SignalModel, max_delay: float, max_speed: float, arrival_view: View, departure_view: View, oversampling: float = 1.5,
              retained: float = 0.75, keep_cells: int = 6000, keep_pairs: int = 6000) -> StagedSearch:
        """Prepare the dictionaries; ``retained`` is the least energy a direction keeps in its nearest cell."""
        waveform, schedule = model.waveform, model.schedule
        slots = schedule.slots()
        delay = DelayGrid.build(waveform.frequencies, waveform.spacing, waveform.bandwidth, max_delay, oversampling)
        arrivals = direction_grid(arrival_view, model.receiver, retained)
        vectors = model.receiver.response(arrivals)[0].T
        book = schedule.precoders[np.unique(schedule.precoder_index)]
        def beams(response):
            return response.conj() @ book.T
        departures = direction_grid(departure_view, model.transmitter, retained, beams)
        gains = beams(model.transmitter.response(departures)[0]).T
        duration = np.ptp(schedule.times)
        count = 1 if duration == 0 or max_speed == 0 else int(np.ceil(2 * max_speed * duration / waveform.wavelength * oversampling)) + 1
        speeds = np.linspace(-max_speed, max_speed, count) if count > 1 else np.zeros(1)
        times = schedule.times[slots[:, :, 0]]
        derotation = np.exp(-2j * np.pi / waveform.wavelength * times.T[:, :, None] * speeds)
        unit = [v / np.maximum(np.linalg.norm(v, axis=0), 1e-300) for v in (vectors, gains)]
        return StagedSearch(delay, arrivals, departures, speeds, slots, unit[0].conj().astype(C64), unit[1].conj().astype(C64),
                            derotation.astype(C64), keep_cells, keep_pairs)

    def candidates(self, model: SignalModel, residual, count: int = 12, pool: int = 240) -> tuple[Geometry, Float]:
        """The ``count`` best mutually incoherent grid points and their energies ``|<s, r>|^2 / |s|^2`` in a whitened residual."""
        filtered = self.delay.apply(residual)
        delay, arrival, cells = self._cells(filtered)
        pair, speed, beams = self._pairs(cells)
        energy = np.abs(beams @ self.departure_vectors) ** 2
        best = _largest(energy.ravel(), pool)
        row, departure = np.unravel_index(best, energy.shape)
        values = energy.ravel()[best] / (model.waveform.subcarriers * self.slots.shape[0])
        chosen = pair[row]
        geometry = Geometry(self.delay.delays[delay[chosen]], self.arrivals[arrival[chosen]], self.departures[departure],
                            self.speeds[speed[row]])
        keep = distinct(model, geometry, values, count)
        return geometry.take(keep), values[keep]

    def _cells(self, filtered):
        """Stage 1: delay and AOA numbers of the most energetic cells, and their symbols (cells, N)."""
        snapshots = filtered.reshape(*filtered.shape[:2], -1)
        covariance = np.matmul(snapshots.conj().swapaxes(1, 2), snapshots)
        pairs = (self.arrival_vectors.conj()[:, None] * self.arrival_vectors).reshape(-1, self.arrival_vectors.shape[1])
        flat = covariance.reshape(len(covariance), -1)
        # Re(a^H R a) as one real product.
        energy = flat.real @ pairs.real - flat.imag @ pairs.imag
        best = np.sort(_largest(energy.ravel(), self.keep_cells))
        delay, arrival = np.unravel_index(best, energy.shape)
        symbols = np.empty((len(best), snapshots.shape[1]), C64)
        edges = np.searchsorted(delay, np.arange(len(snapshots) + 1))
        for number in np.flatnonzero(np.diff(edges)):
            part = slice(edges[number], edges[number + 1])
            symbols[part] = (snapshots[number] @ self.arrival_vectors[:, arrival[part]]).T
        return delay, arrival, symbols

    def _pairs(self, symbols):
        """Stage 2: cell and speed numbers of the best pairs, and their derotated beams (pairs, Q)."""
        swept = symbols[:, self.slots[:, :, 0]]
        beams = np.matmul(swept.transpose(2, 0, 1), self.derotation)
        energy = np.einsum("qcv,qcv->cv", beams.real, beams.real) + np.einsum("qcv,qcv->cv", beams.imag, beams.imag)
        best = _largest(energy.ravel(), self.keep_pairs)
        cell, speed = np.unravel_index(best, energy.shape)
        return cell, speed, np.ascontiguousarray(beams[:, cell, speed].T)


def _largest(values, count: int):
    """Indices of the ``count`` largest values, largest first."""
    count = min(count, len(values))
    best = np.argpartition(values, len(values) - count)[len(values) - count:]
    return best[np.argsort(values[best])[::-1]]


def distinct(model: SignalModel, geometry: Geometry, energy: Float, count: int, limit: float = 0.5):
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
