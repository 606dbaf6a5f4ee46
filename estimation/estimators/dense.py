"""Coarse search of fully digital links: the matched-filter spectrum over delay x speed x AOA x AOD, complete and
coherent.

The delays come first (by FFT), then every mode is multiplied by its dictionary in turn, a few delays at a time,
so that intermediate results stay in the cache. Found paths are subtracted in the spectrum itself, as outer
products of the dictionaries' responses, block by block together with the scan for high cells.

Six dimensions of coarse cells leave a path between them with a third of its energy on average. So a high cell is
judged by its neighborhood: along each mode, the best of a few points between the cells.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..signal.algebra import Blocks
from ..signal.directions import Float, displaced
from ..signal.model import SignalModel
from ..signal.paths import Geometry
from .cells import Cells, Single, line_points, ring
from .grids import DelayGrid, View, direction_grid, speed_grid
from .kernels import scan, screen
from .lobes import LobeMap
from .polish import MatchedProjector, ResidualProjector
from .search import C64, Effort, largest

NOISE_CELL = 7.0
"""Cells below this many noise variances are not looked at: a path worth reporting keeps more in its best
cell, but for rare scalloping.
"""
TRIFLE = 0.01
"""A known path stays in rows of the spectrum where it has less than this share of the noise variance."""
PROMISING = 0.75
"""Cells whose neighborhood has less than this share of an energy do not reach it when refined (1 in 300 do)."""
MOST = 20_000
"""High cells of one scan; a scan that finds more raises its level."""
BLOCK = 1 << 17
"""Cells worked on at a time: one megabyte, so that intermediate results stay near the core."""


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """A filtered signal: ``partial`` (L, V, N_R, N_T) matched to delays and speeds, ``cells`` (L, V, A, D) to everything.

    ``known`` are the factors (P, L), (P, V), (P, A) and (P, D) of paths that are to be taken out of the cells.
    """

    partial: Single
    cells: Single
    known: tuple[Single, Single, Single, Single]


@dataclass(frozen=True, eq=False)
class DenseSearch:
    """Dictionaries of the separable search, prepared once.

    Attributes
    ----------
    delay, speeds, arrivals, departures : cells
    cells : the same in the order of the spectrum's axes, with neighborhoods
    offsets : the points about a cell: delays (J,) [s], speeds (J,) [m/s], tangent steps (A, J, 2), (D, J, 2) [rad]
    lobes : tells which grid points belong together
    full : effort of a pass; there is no cheaper one
    """

    delay: DelayGrid
    speeds: Float
    arrivals: Float
    departures: Float
    cells: tuple[Cells, Cells, Cells, Cells]
    offsets: tuple[Float, Float, Float, Float]
    lobes: LobeMap
    full: Effort

    @staticmethod
    def build(
        model: SignalModel,
        max_delay: float,
        max_speed: float,
        arrival_view: View,
        departure_view: View,
        oversampling: float = 1.25,
        retained: float = 0.5,
        candidates: int = 12,
    ) -> DenseSearch:
        """Prepare the dictionaries; ``retained`` is the least energy a direction keeps in its nearest cell."""
        waveform = model.waveform
        delay = DelayGrid.build(waveform.frequencies, waveform.spacing, waveform.bandwidth, max_delay, oversampling)
        arrivals = direction_grid(arrival_view, model.receiver, retained)
        departures = direction_grid(departure_view, model.transmitter, retained)
        speeds = speed_grid(model, max_speed, oversampling, registers=False)
        lobes = LobeMap.build(model, delay.delays, arrivals, departures, speeds)
        rates = -2j * np.pi * delay.tones, 2j * np.pi / waveform.wavelength * model.schedule.times
        lines = [spacing(grid) * np.linspace(-0.5, 0.5, 5) for grid in (delay.delays, speeds)]
        cells = [
            Cells.build(np.exp(np.outer(grid, rate)), line_points(rate, grid, offset), 5)
            for grid, rate, offset in zip((delay.delays, speeds), rates, lines, strict=True)
        ]
        steps = []
        for array, grid, metrics, part in (
            (model.receiver, arrivals, lobes.arrival_metric, slice(1, 3)),
            (model.transmitter, departures, lobes.departure_metric, slice(3, 5)),
        ):
            step = ring(metrics, 0.55, model.active[part])
            points = displaced(np.repeat(grid, step.shape[1], axis=0), step.reshape(-1, 2))
            vectors, around = (array.response(d)[0] for d in (grid, points))
            if array is model.transmitter:
                vectors, around = vectors.conj(), around.conj()
            cells.append(Cells.build(vectors, around.reshape(*step.shape[:2], -1), 8))
            steps.append(step)
        return DenseSearch(
            delay,
            speeds,
            arrivals,
            departures,
            tuple(cells),
            (*lines, *steps),
            lobes,
            Effort(None, 0, 0, candidates),
        )

    @property
    def efforts(self) -> list[Effort]:
        """The passes in order."""
        return [self.full]

    @property
    def shape(self) -> tuple[int, ...]:
        """(L, V, A, D) of the spectrum."""
        return tuple(len(c.vectors) for c in self.cells)

    def operations(self, model: SignalModel) -> float:
        """Floating-point operations of :meth:`filtered`: the least that one search costs."""
        pilots, symbols, ports, elements = model.shape
        delays, speeds, arrivals, departures = self.shape
        length = self.delay.length
        matched = 5 * length * np.log2(length) if length else 8 * delays * pilots
        last = departures * ports * elements + arrivals * departures * ports
        return speeds * (ports * elements * (8.0 * pilots * symbols + matched) + 8.0 * delays * last)

    def filtered(self, signal) -> Spectrum:
        """Spectrum of a signal (K, N, N_R, N_T), its cells normalized to unit noise gain."""
        pilots, _, ports, elements = signal.shape
        delays, speeds, _, departures = self.shape
        speed, arrival, departure = (c.vectors.conj() for c in self.cells[1:])
        # Speeds first: their cells are fewer than the symbols, and everything after is the smaller.
        speed = speed * C64(1 / np.sqrt(pilots))
        partial = self.delay.apply(np.matmul(speed, signal.reshape(*signal.shape[:2], -1)))
        out = np.empty(self.shape, C64)
        count = max(BLOCK // (speeds * ports * departures), 1)
        for start in range(0, delays, count):
            part = partial[start : start + count].reshape(-1, elements) @ departure.T
            np.matmul(arrival, part.reshape(-1, speeds, ports, departures), out=out[start : start + count])
        return Spectrum(partial.reshape(delays, speeds, ports, elements), out, self._factors(None, None))

    def without(self, filtered: Spectrum, blocks: Blocks, gain) -> Spectrum:
        """The spectrum with given paths taken out of its cells."""
        return replace(filtered, known=self._factors([mode[:, 0] for mode in blocks[0]], gain))

    def _factors(self, modes, gain) -> tuple[Single, Single, Single, Single]:
        """Responses of the dictionaries to paths, in the layout of :class:`Spectrum`."""
        if modes is None:
            return tuple(np.empty((0, size), C64) for size in self.shape)
        frequency, *rest = modes
        scale = gain[:, None] / np.sqrt(frequency.shape[1])
        first = np.ascontiguousarray(self.delay.apply((frequency * scale).T.astype(C64)).T)
        others = (
            (v @ c.vectors.conj().T).astype(C64) for v, c in zip(rest, self.cells[1:], strict=True)
        )
        return first, *others

    def candidates(
        self, filtered: Spectrum, effort: Effort, variance: float, interest: float = np.inf, scale: Float | None = None
    ) -> Geometry:
        """The best points of a residual spectrum, each in a lobe of its own, best first: those that may reach an energy of
        ``interest`` or be the best; ``scale`` (L,) gives all delays the same noise.
        """
        equal = np.ones(self.shape[0], np.float32) if scale is None else scale
        first, *middle, departure = filtered.known
        rows = np.stack([departure, 1j * departure], axis=1).astype(C64).view(np.float32)
        strongest = np.max(np.abs(departure) ** 2, axis=1, initial=1e-30)
        index, power = np.empty(MOST, np.int64), np.empty(MOST, np.float32)
        count, least = scan(
            filtered.cells.view(np.float32),
            first,
            *middle,
            rows,
            (TRIFLE * variance / strongest).astype(np.float32),
            equal,
            np.float32(NOISE_CELL * variance),
            np.float32(0.1),
            index,
            power,
        )
        index = index[:count][power[:count] > least]
        if not len(index):
            return Geometry.empty()
        high = np.stack(np.unravel_index(index, self.shape))
        energy, best = np.empty(len(index), np.float32), np.empty((4, len(index)), np.int64)
        tables = [table for c in self.cells for table in (c.neighbors, c.shifts)]
        screen(filtered.cells, *filtered.known, high, *tables, energy, best)
        energy *= equal[high[0]] ** 2
        order = largest(energy, 12 * effort.candidates)
        order = order[energy[order] > PROMISING * min(interest, energy[order[0]])]
        (delay, speed, arrival, departure), near = high[:, order], best[:, order]
        points = Geometry(
            self.delay.delays[delay] + self.offsets[0][near[0]],
            displaced(self.arrivals[arrival], self.offsets[2][arrival, near[2]]),
            displaced(self.departures[departure], self.offsets[3][departure, near[3]]),
            self.speeds[speed] + self.offsets[1][near[1]],
        )
        return points.take(self.lobes.first_of_points(points, arrival, departure, effort.candidates))

    def projector(self, data, filtered: Spectrum, lin, points: Geometry) -> ResidualProjector | MatchedProjector:
        """What candidates are polished on."""
        if data.model.subbands > 1:
            return ResidualProjector(data, lin)
        return MatchedProjector(data.model, self.delay, self.cells[1].vectors, filtered.partial, points.delay, lin)


def spacing(grid: Float) -> float:
    """Distance of the points of an even grid; 0 for a single one."""
    return float(grid[1] - grid[0]) if len(grid) > 1 else 0.0
