"""How long there is to work on a burst."""

from __future__ import annotations

import time
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Clock:
    """When a burst must be done with, in seconds of :func:`time.monotonic`; None: whenever."""

    end: float | None

    @staticmethod
    def of(seconds: float | None) -> Clock:
        """A clock that starts now."""
        return Clock(None if seconds is None else time.monotonic() + seconds)

    @property
    def left(self) -> float | None:
        """Seconds that are left, None if there is no end."""
        return None if self.end is None else max(self.end - time.monotonic(), 0.0)

    @property
    def over(self) -> bool:
        """Whether the time is up."""
        return self.end is not None and time.monotonic() >= self.end


ENDLESS = Clock(None)
"""All the time that it takes."""
