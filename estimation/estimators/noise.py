"""How strong the noise of a burst is, and how long there is to work on it."""

from __future__ import annotations

import time
from dataclasses import dataclass

from .refine import Linearization

LEAST_NOISE = 1e-9
"""Noise is never taken to be weaker than this share of the signal: single-precision samples cannot tell."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Energy and number of samples of a burst, the noise variance if it is known, a factor on it where caution is due, and
    whether the search ended before it was done.
    """

    energy: float
    samples: int
    known: float | None
    inflation: float = 1.0
    limited: bool = False

    def variance(self, lin: Linearization | None) -> float:
        """Known, or what the paths leave unexplained per degree of freedom (eight real parameters each)."""
        if self.known is not None:
            return self.known * self.inflation
        paths, explained = (0, 0.0) if lin is None else (len(lin.gain), lin.explained)
        rest = max(self.energy - explained, LEAST_NOISE * self.energy)
        return self.inflation * rest / max(self.samples - 4 * paths, 1)


@dataclass(frozen=True, slots=True)
class Clock:
    """When a burst must be done with, in seconds of :func:`time.monotonic`; None: whenever."""

    end: float | None

    @staticmethod
    def of(seconds: float | None) -> Clock:
        """A clock that starts now."""
        return Clock(None if seconds is None else time.monotonic() + seconds)

    @property
    def over(self) -> bool:
        """Whether the time is up."""
        return self.end is not None and time.monotonic() >= self.end


ENDLESS = Clock(None)
"""All the time that it takes."""
