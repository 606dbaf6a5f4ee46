"""Coarse search of links that combine at the receiver and observe the transmitter's elements one by one.

Read backwards such a link is a beam-swept one: in the conjugated signal, with frequencies and times reversed, the
combiners' columns are beams that leave the receiver and the transmitter's elements are where they arrive; delays and
speeds stay. So the staged search does it all, with the two ends exchanged.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..signal.algebra import Blocks
from ..signal.directions import Float
from ..signal.model import SignalModel
from ..signal.modes import TimeMode
from ..signal.paths import Geometry
from ..signal.schedule import Schedule
from .grids import DelayGrid, View
from .polish import ResidualProjector
from .projector import Projector
from .search import Effort, StagedSearch


@dataclass(frozen=True, eq=False)
class MirroredSearch:
    """The staged search of the mirrored link, whose receiver has ``ports`` outputs per symbol."""

    search: StagedSearch
    ports: int

    @staticmethod
    def build(
        model: SignalModel, max_delay: float, max_speed: float, arrival_view: View, departure_view: View, **options
    ) -> MirroredSearch:
        """Prepare the dictionaries; ``options`` as in :meth:`StagedSearch.build`."""
        search = StagedSearch.build(mirrored(model), max_delay, max_speed, departure_view, arrival_view, **options)
        return MirroredSearch(search, model.shape[2])

    @property
    def delay(self) -> DelayGrid:
        """Delay cells."""
        return self.search.delay

    @property
    def arrivals(self) -> Float:
        """Direction cells at the receiver."""
        return self.search.departures

    @property
    def departures(self) -> Float:
        """Direction cells at the transmitter."""
        return self.search.arrivals

    @property
    def full(self) -> Effort:
        """Effort of the last passes."""
        return self.search.full

    @property
    def efforts(self) -> list[Effort]:
        """The passes in order."""
        return self.search.efforts

    def filtered(self, data: Projector):
        """Matched filter of a whitened signal (K, N, M, N_T) over the delay cells."""
        signal = data.signal
        return self.search.matched(signal[::-1, ::-1].conj().reshape(len(signal), -1, signal.shape[3]))

    def without(self, filtered, blocks: Blocks, gain, spare=None):
        """The filtered signal less that of given paths, in an array of its own or in ``spare``, an earlier result."""
        frequency, time, transmit = (mode[:, :1].conj() for mode in blocks[0])
        time = time.reshape(len(gain), -1, self.ports)[:, ::-1].reshape(len(gain), 1, -1)
        return self.search.without(filtered, [[frequency[:, :, ::-1], time, transmit]], gain.conj(), spare)

    def candidates(self, filtered, effort: Effort, *limits) -> Geometry:
        """The best mutually incoherent grid points in a filtered residual, strongest first; ``limits`` as in
        :meth:`StagedSearch.candidates`.
        """
        found = self.search.candidates(filtered, effort, *limits)
        return replace(found, arrival=found.departure, departure=found.arrival)

    def projector(self, data, filtered, lin, points: Geometry) -> ResidualProjector:
        """What candidates are polished on."""
        return ResidualProjector(data, lin)


def mirrored(model: SignalModel) -> SignalModel:
    """The beam-swept link that a link of combiners and a digital transmitter is when read backwards."""
    schedule, time = model.schedule, model.bands[0].modes[1]
    assert isinstance(time, TimeMode) and time.combiners is not None and schedule.combiner_index is not None
    settings, ports, elements = time.combiners.shape
    index = schedule.combiner_index[::-1, None] * ports + np.arange(ports)
    swept = Schedule(
        np.repeat(-schedule.times[::-1], ports),
        time.combiners.conj().reshape(settings * ports, elements),
        index.ravel(),
        offsets=None if schedule.offsets is None else np.repeat(-schedule.offsets[::-1], ports),
    )
    waveform = replace(model.waveform, frequencies=-model.waveform.frequencies[::-1])
    return SignalModel(waveform, swept, transmitter=model.receiver, receiver=model.transmitter)
