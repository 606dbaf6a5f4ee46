"""Which coarse search fits which link."""

from __future__ import annotations

from ..errors import ModelError
from ..signal.model import SignalModel
from .dense import DenseSearch
from .mirror import MirroredSearch
from .search import StagedSearch

Search = StagedSearch | DenseSearch | MirroredSearch


def search_kind(model: SignalModel) -> type[StagedSearch] | type[DenseSearch] | type[MirroredSearch]:
    """The coarse search that fits a link's architecture.

    Raises
    ------
    ModelError
        If there is none: pilots that shift, between elements that are all observed.
    """
    if model.schedule.precoders is not None:
        return StagedSearch
    if model.schedule.combiners is not None:
        return MirroredSearch
    if model.schedule.offsets is not None:
        raise ModelError(
            "Schedule: pilots that shift from symbol to symbol need precoders or combiners; a transmitter whose elements are "
            "told apart has them as precoders of their own, estimation.simultaneous(elements, symbols, period, stagger)"
        )
    return DenseSearch
