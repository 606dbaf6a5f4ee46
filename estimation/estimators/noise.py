"""How strong the noise of a burst is and of which kind, with the clock that runs meanwhile."""

from __future__ import annotations

from dataclasses import dataclass

from ..signal.arrays import Complex
from .clock import ENDLESS, Clock
from .haze import Haze
from .refine import Linearization

DOUBT = 5.0
"""Standard deviations by which a burst may exceed the noise that it was said to have."""
LEAST_NOISE = 1e-9
"""Noise is never taken to be weaker than this share of the signal: single-precision samples cannot tell."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Energy and number of samples of a burst, the noise variance if it is known, a factor on it where caution is due,
    whether the search ended before it was done, the covariance over the ports if that is why, what was taken for no path, and
    how long there is to work on it.
    """

    energy: float
    samples: int
    known: float | None
    inflation: float = 1.0
    limited: bool = False
    ports: Complex | None = None
    hazes: tuple[Haze, ...] = ()
    clock: Clock = ENDLESS

    def variance(self, lin: Linearization | None) -> float:
        """What the paths leave unexplained per degree of freedom (eight real parameters each), unless the known variance
        can be true.
        """
        paths, explained = (0, 0.0) if lin is None else (len(lin.gain), lin.explained)
        rest = max(self.energy - explained, LEAST_NOISE * self.energy)
        free = max(self.samples - 4 * paths, 1)
        if self.known is not None and rest / free < self.known * (1 + DOUBT / free**0.5):
            return self.inflation * self.known
        return self.inflation * rest / free
