"""Coarse search of fully digital links: the matched-filter spectrum over delay x speed x AOA x AOD, complete and
coherent.

Each mode is multiplied by its dictionary in turn (the delays by FFT), limited to the field of view, and found
paths are subtracted in the spectrum itself as outer products of the dictionaries' responses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import cgemm

from ..signal.algebra import Blocks
from ..signal.directions import Float
from ..signal.model import SignalModel
from ..signal.paths import Geometry
from .grids import DelayGrid, View, direction_grid, speed_grid
from .kernels import above, peak_power
from .lobes import LobeMap
from .polish import ResidualProjector
from .search import C64, Effort, largest

NOISE_CELL = 6.5
"""Cells below this many noise variances are not looked at: a path worth reporting keeps more in its best
cell, but for rare scalloping.
"""


@dataclass(frozen=True, eq=False)
class DenseSearch:
    """Dictionaries of the separable search, prepared once.

    Attributes
    ----------
    delay, speeds, arrivals, departures : cells
    speed_matrix, arrival_matrix, departure_matrix : (V, N), (A, N_R), (D, N_T) conjugated unit-norm responses
    lobes : tells which grid points belong together
    full : effort of a pass; there is no cheaper one
    """

    delay: DelayGrid
    speeds: Float
    arrivals: Float
    departures: Float
    speed_matrix: np.typing.NDArray[C64]
    arrival_matrix: np.typing.NDArray[C64]
    departure_matrix: np.typing.NDArray[C64]
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
        retained: float = 0.4,
        candidates: int = 24,
    ) -> DenseSearch:
        """Prepare the dictionaries; ``retained`` is the least energy a direction keeps in its nearest cell."""
        waveform = model.waveform
        delay = DelayGrid.build(waveform.frequencies, waveform.spacing, waveform.bandwidth, max_delay, oversampling)
        arrivals = direction_grid(arrival_view, model.receiver, retained)
        departures = direction_grid(departure_view, model.transmitter, retained)
        speeds = speed_grid(model, max_speed, oversampling, registers=False)
        phase = -2j * np.pi / waveform.wavelength * np.outer(speeds, model.schedule.times)
        matrices = [
            np.exp(phase),
            model.receiver.response(arrivals)[0].conj(),
            model.transmitter.response(departures)[0],
        ]
        unit = [(m / np.linalg.norm(m, axis=1, keepdims=True)).astype(C64) for m in matrices]
        return DenseSearch(
            delay,
            speeds,
            arrivals,
            departures,
            *unit,
            LobeMap.build(model, delay.delays, arrivals, departures, speeds),
            Effort(None, 0, 0, candidates),
        )

    @property
    def efforts(self) -> list[Effort]:
        """The passes in order."""
        return [self.full]

    def filtered(self, signal):
        """Spectrum (L, V, A, D) of a signal (K, N, N_R, N_T), normalized to unit noise gain."""
        count, _, ports, elements = signal.shape
        data = np.matmul(self.speed_matrix, signal.reshape(count, signal.shape[1], -1))
        data = np.matmul(self.arrival_matrix, data.reshape(-1, ports, elements))
        data = data.reshape(-1, elements) @ self.departure_matrix.T
        data *= np.float32(1 / np.sqrt(count))
        return self.delay.apply(data.reshape(count, len(self.speeds), len(self.arrivals), -1))

    def without(self, filtered, blocks: Blocks, gain):
        """The spectrum less that of given paths (a new array)."""
        frequency, time, receive, transmit = (mode[:, 0] for mode in blocks[0])
        scale = gain[:, None] / np.sqrt(frequency.shape[1])
        first = self.delay.apply((frequency * scale).T.astype(C64)).T
        others = (time, self.speed_matrix), (receive, self.arrival_matrix), (transmit, self.departure_matrix)
        speed, arrival, departure = ((v @ matrix.T).astype(C64) for v, matrix in others)
        left = (first[:, :, None] * speed[:, None]).reshape(len(gain), -1)
        right = (arrival[:, :, None] * departure[:, None]).reshape(len(gain), -1)
        rest = filtered.reshape(left.shape[1], -1).copy()
        cgemm(-1.0, right.T, left, 1.0, rest.T, overwrite_c=True)
        return rest.reshape(filtered.shape)

    def candidates(self, filtered, effort: Effort, variance: float) -> Geometry:
        """The best grid points of a residual spectrum, each in a lobe of its own, strongest first."""
        flat = filtered.reshape(-1).view(np.float32)
        least = max(NOISE_CELL * variance, 0.1 * float(peak_power(flat)))
        index, power = np.empty(50_000, np.int64), np.empty(50_000, np.float32)
        count = above(flat, np.float32(least), index, power)
        if count == 0:
            return Geometry.empty()
        best = index[:count][largest(power[:count], 12 * effort.candidates)]
        delay, speed, arrival, departure = np.unravel_index(best, filtered.shape)
        cells = np.stack([delay, arrival, departure, speed])
        delay, arrival, departure, speed = cells[:, self.lobes.first_of_each(*cells, effort.candidates)]
        return Geometry(
            self.delay.delays[delay], self.arrivals[arrival], self.departures[departure], self.speeds[speed]
        )

    def projector(self, data, filtered, lin, points: Geometry) -> ResidualProjector:
        """What candidates are polished on."""
        return ResidualProjector(data, lin)

    def alternatives(self, model: SignalModel, cells, found: Geometry, energy: Float) -> Geometry:
        """None: the spectrum holds all lobes already."""
        return Geometry.empty()
