"""Coarse search of fully digital links: the matched-filter spectrum over delay x speed x AOA x AOD, complete and
coherent.

Speeds and delays come first, then the directions at either end, a few delays at a time, so that intermediate results
stay in the cache; all of it on folded data (:mod:`~.folding`). Found paths leave the spectrum during the scan for high
cells, row by row, as outer products of the dictionaries' responses.

Six dimensions of coarse cells leave a path between them with a third of its energy on average. So a high cell is
judged by its neighborhood: along each mode, the best of a few points between the cells.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..signal.algebra import Blocks
from ..signal.arrays import Complex
from ..signal.directions import Float, displaced
from ..signal.model import SignalModel
from ..signal.paths import Geometry
from .cells import Cells, Single, line_points, ring
from .folding import Folding, Matrix, joined, product, product_right
from .grids import DelayGrid, View, direction_grid, speed_grid
from .kernels import scan, screen
from .lobes import LobeMap
from .polish import LEAST_NOVELTY, MatchedProjector, ResidualProjector
from .pool import Pool
from .projector import Projector
from .search import C64, Effort, largest

NOISE_CELL = 7.0
"""Cells below this many noise variances are not looked at: a path worth reporting keeps more in its best
cell, but for rare scalloping.
"""
TRIFLE = 0.03
"""A known path stays in rows of the spectrum where it has less than this share of the noise variance."""
PROMISING = 0.7
"""Cells whose neighborhood has less than this share of an energy do not reach it when refined."""
MOST = 20_000
"""High cells of one scan; a scan that finds more raises its level."""
BLOCK = 1 << 16
"""Cells worked on at a time: half a megabyte, so that intermediate results stay near the core."""


class Matched:
    """Planes of a filtered signal, folded but for the cells: ``first`` (2, K, V, N_R N_T) matched to speeds, ``partial``
    (2, L, V, N_R, N_T) to delays also, ``cells`` (2, L, V, A, D) to everything.
    """

    def __init__(self, pool: Pool, shape: tuple[int, ...], samples: tuple[int, ...]) -> None:
        delays, speeds, _, _ = shape
        pilots, _, *arrays = samples
        self.first = pool.lend(self, (2, pilots, speeds, int(np.prod(arrays))))
        self.partial = pool.lend(self, (2, delays, speeds, *arrays))
        self.cells = pool.lend(self, (2, *shape))


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """A filtered signal less known paths: the factors (P, L), (P, V), (P, A) and (P, D) of those in its cells, and their
    energies (P,).
    """

    matched: Matched
    known: tuple[Single, Single, Single, Single]
    energy: Float

    def novelty(self, cells) -> Float:
        """Share (C,) of the energy at ``cells`` (4, C) that the known paths could not explain."""
        share = np.ones(cells.shape[1])
        if len(self.energy):
            at = np.prod([factor[:, index] for factor, index in zip(self.known, cells, strict=True)], axis=0)
            share -= np.max(np.abs(at) ** 2 / self.energy[:, None], axis=0)
        return np.maximum(share, LEAST_NOVELTY)


@dataclass(frozen=True, eq=False)
class DenseSearch:
    """Dictionaries of the separable search, prepared once.

    Attributes
    ----------
    delay, speeds, arrivals, departures : cells
    cells : the same in the order of the spectrum's axes, with neighborhoods
    offsets : the points about a cell: delays (J,) [s], speeds (J,) [m/s], tangent steps (A, J, 2), (D, J, 2) [rad]
    folding : coordinates of the data
    filters : matched filters of the four modes in those coordinates, (L, K), (V, N), (A, N_R), (D, N_T); none for delays
        that are transformed
    rates : (V, N) speed vectors of the cells and their pseudo-inverse (N, V)
    lobes : tells which grid points belong together
    full : effort of a pass; there is no cheaper one
    """

    delay: DelayGrid
    speeds: Float
    arrivals: Float
    departures: Float
    cells: tuple[Cells, Cells, Cells, Cells]
    offsets: tuple[Float, Float, Float, Float]
    folding: Folding
    filters: tuple[Matrix | None, Matrix, Matrix, Matrix]
    rates: tuple[Complex, Complex]
    lobes: LobeMap
    full: Effort
    pool: Pool = field(default_factory=Pool, repr=False)

    @staticmethod
    def build(
        model: SignalModel,
        max_delay: float,
        max_speed: float,
        arrival_view: View,
        departure_view: View,
        oversampling: float = 1.25,
        retained: float = 0.5,
        candidates: int = 8,
    ) -> DenseSearch:
        """Prepare the dictionaries; ``retained`` is the least energy a direction keeps in its nearest cell."""
        waveform = model.waveform
        delay = DelayGrid.build(waveform.frequencies, waveform.spacing, waveform.bandwidth, max_delay, oversampling)
        arrivals = direction_grid(arrival_view, model.heard, retained)
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
            (model.heard, arrivals, lobes.arrival_metric, slice(1, 3)),
            (model.transmitter, departures, lobes.departure_metric, slice(3, 5)),
        ):
            step = ring(metrics, 0.55, model.active[part])
            points = displaced(np.repeat(grid, step.shape[1], axis=0), step.reshape(-1, 2))
            vectors, around = (array.response(d)[0] for d in (grid, points))
            if array is model.transmitter:
                vectors, around = vectors.conj(), around.conj()
            cells.append(Cells.build(vectors, around.reshape(*step.shape[:2], -1), 8))
            steps.append(step)
        folding = Folding.build(model)
        filters = [axis.steering(c.vectors).conj() for axis, c in zip(folding.axes, cells, strict=True)]
        return DenseSearch(
            delay,
            speeds,
            arrivals,
            departures,
            (cells[0], cells[1], cells[2], cells[3]),
            (lines[0], lines[1], steps[0], steps[1]),
            folding,
            (None if delay.matrix is None else filters[0], filters[1], filters[2], filters[3]),
            (cells[1].vectors, np.linalg.pinv(cells[1].vectors, rcond=1e-4)),
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
        costs = [8 if f is None or np.iscomplexobj(f) else 4 for f in self.filters]
        length = self.delay.length
        matched = 5 * length * np.log2(length) if length else costs[0] * delays * pilots
        first = ports * elements * (costs[1] * pilots * symbols + matched)
        last = delays * departures * (costs[3] * ports * elements + costs[2] * arrivals * ports)
        return float(speeds * (first + last))

    def filtered(self, data: Projector) -> Spectrum:
        """Spectrum of a signal, its cells normalized to unit noise gain."""
        _, pilots, symbols, ports, elements = data.planes.shape
        delays, speeds, _, departures = self.shape
        delay, speed, arrival, departure = self.filters
        matched = Matched(self.pool, self.shape, (pilots, symbols, ports, elements))
        # Speeds first: their cells are fewer than the symbols, and everything after is the smaller.
        first = product(speed, data.planes.reshape(2, pilots, symbols, -1), matched.first).reshape(2, pilots, -1)
        partial = matched.partial.reshape(2, delays, -1)
        if delay is None:
            rows = self.delay.apply(self.folding.axes[0].unfold_rows(joined(first))) * C64(1 / np.sqrt(pilots))
            partial[0], partial[1] = rows.real, rows.imag
        else:
            product(delay, first, partial)
        count = max(BLOCK // (speeds * ports * departures), 1)
        for start in range(0, delays, count):
            block = slice(start, start + count)
            part = product_right(partial[:, block].reshape(2, -1, elements), departure)
            product(arrival, part.reshape(2, -1, speeds, ports, departures), matched.cells[:, block])
        none = [np.empty((0, size), C64) for size in self.shape]
        return Spectrum(matched, (none[0], none[1], none[2], none[3]), np.empty(0))

    def without(self, filtered: Spectrum, blocks: Blocks, gain, spare=None) -> Spectrum:
        """The spectrum with given paths taken out of its cells; nothing is copied, so no ``spare`` is needed."""
        modes = [mode[:, 0] for mode in blocks[0]]
        energy = np.abs(gain) ** 2 * np.prod([np.sum(np.abs(mode) ** 2, axis=1) for mode in modes], axis=0)
        return replace(filtered, known=self._factors(modes, gain), energy=np.maximum(energy, 1e-300))

    def _factors(self, modes, gain) -> tuple[Single, Single, Single, Single]:
        """Responses of the dictionaries to paths, in the layout of :class:`Spectrum`."""
        frequency, *rest = modes
        if self.filters[0] is None:
            scale = gain[:, None] / np.sqrt(frequency.shape[1])
            first = np.ascontiguousarray(self.delay.apply((frequency * scale).T.astype(C64)).T)
        else:
            first = (frequency * gain[:, None] @ self.cells[0].vectors.conj().T).astype(C64)
        others = ((v @ c.vectors.conj().T).astype(C64) for v, c in zip(rest, self.cells[1:], strict=True))
        return first, *others

    def candidates(
        self, filtered: Spectrum, effort: Effort, variance: float, interest: float = np.inf, scale: Float | None = None
    ) -> Geometry:
        """The best points of a residual spectrum, each in a lobe of its own, best first: those that may reach an energy of
        ``interest`` or be the best; ``scale`` (L,) gives all delays the same noise.
        """
        equal = np.ones(self.shape[0], np.float32) if scale is None else scale
        first, *middle, departure = filtered.known
        strongest = np.max(np.abs(departure) ** 2, axis=1, initial=1e-30)
        index, power = np.empty(MOST, np.int64), np.empty(MOST, np.float32)
        count, least = scan(
            filtered.matched.cells,
            first,
            *middle,
            np.stack([departure.real, departure.imag]),
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
        known = [np.stack([f.T.real, f.T.imag]) for f in filtered.known]
        screen(filtered.matched.cells, *known, high, *tables, energy, best)
        energy *= equal[high[0]] ** 2
        order = largest(energy, 12 * effort.candidates)
        hopes = energy[order] / filtered.novelty(high[:, order])
        order = order[hopes > PROMISING * min(interest, energy[order[0]])]
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
        return MatchedProjector(
            data.model, self.folding, self.delay, self.rates, filtered.matched.partial, points.delay, lin
        )


def spacing(grid: Float) -> float:
    """Distance of the points of an even grid; 0 for a single one."""
    return float(grid[1] - grid[0]) if len(grid) > 1 else 0.0
