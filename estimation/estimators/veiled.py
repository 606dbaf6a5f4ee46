"""Weak paths behind what a model gets wrong of strong ones.

The errors of a strong path fill the list of candidates, none of which stands out of them; a path elsewhere that would is not
on it. So the fibers in which the errors lie leave the data, and the search looks again.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import chi2

from ..signal.algebra import Blocks
from ..signal.model import SignalModel
from .floor import FITTED, LARGEST, RATE, Floor
from .kinds import Search
from .refine import Linearization


def hidden(model: SignalModel, raw, credible, level: float) -> bool:
    """Whether candidates with statistics ``raw`` exceed the threshold and none of them, as it is believed, does."""
    plain = model.subbands == 1 and model.weight is None
    return bool(plain and len(raw) and raw.max() > level and credible.max(initial=0.0) <= level)


def without_errors(search: Search, floor: Floor, filtered: Any, level: float) -> Any:
    """A filtered signal without the known paths and the fibers along which they have left more than noise."""
    lin = floor.known
    assert lin is not None
    blocks, gain = _with_errors(floor, lin, level)
    return search.without(filtered, blocks, gain)


def _with_errors(floor: Floor, lin: Linearization, level: float) -> tuple[Blocks, np.ndarray]:
    """Blocks and gains of the known paths and, as further ones, of their errors."""
    vectors = [mode[:, 0] for mode in lin.blocks[0]]
    added: list[list[np.ndarray]] = []
    for path in np.flatnonzero(LARGEST * lin.drop > level * floor.variance):
        unit = [v[path] / max(np.linalg.norm(v[path]), 1e-300) for v in vectors]
        for mode, own in enumerate(unit):
            fiber = floor.along(lin.geometry.take([path]), mode, int(path))
            free = len(own) - FITTED
            if free > 0 and 2 * np.linalg.norm(fiber) ** 2 / floor.variance > chi2.isf(RATE, 2 * free):
                added.append([fiber if m == mode else u for m, u in enumerate(unit)])
    all_of = [np.concatenate([v, *([error[m][None] for error in added])]) for m, v in enumerate(vectors)]
    return [[v[:, None] for v in all_of]], np.concatenate([lin.gain, np.ones(len(added))])
