"""Which coarse search fits which link."""

from __future__ import annotations

from ..signal.model import SignalModel
from .dense import DenseSearch
from .mirror import MirroredSearch
from .search import StagedSearch

Search = StagedSearch | DenseSearch | MirroredSearch


def search_kind(model: SignalModel) -> type[StagedSearch] | type[DenseSearch] | type[MirroredSearch]:
    """The coarse search that fits a link's architecture."""
    if model.schedule.precoders is not None:
        return StagedSearch
    return DenseSearch if model.schedule.combiners is None else MirroredSearch
