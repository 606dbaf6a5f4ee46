"""Pilot waveform: which subcarriers are observed around which carrier."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import ModelError
from .directions import Float

SPEED_OF_LIGHT = 299_792_458.0


@dataclass(frozen=True, eq=False)
class Waveform:
    """Pilot subcarriers.

    Parameters
    ----------
    carrier : carrier frequency [Hz]
    frequencies : (K,) increasing pilot frequencies relative to the carrier [Hz]; a path's gain is referred to
        frequency 0
    """

    carrier: float
    frequencies: Float

    def __post_init__(self) -> None:
        frequencies = np.asarray(self.frequencies, float)
        if not (np.isfinite(self.carrier) and self.carrier > 0):
            raise ModelError(f"Waveform: carrier must be a positive frequency in Hz, got {self.carrier}")
        if frequencies.ndim != 1 or not len(frequencies) or not np.isfinite(frequencies).all():
            raise ModelError("Waveform: frequencies must be a finite vector (K,) in Hz relative to the carrier")
        if len(frequencies) > 1 and np.min(np.diff(frequencies)) <= 0:
            raise ModelError("Waveform: frequencies must be strictly increasing")
        object.__setattr__(self, "frequencies", frequencies)

    @property
    def wavelength(self) -> float:
        """Carrier wavelength [m]."""
        return SPEED_OF_LIGHT / self.carrier

    @property
    def subcarriers(self) -> int:
        """Number of pilot subcarriers K."""
        return len(self.frequencies)

    @property
    def spacing(self) -> float | None:
        """Pilot spacing [Hz] if uniform, else None."""
        if self.subcarriers < 2:
            return None
        steps = np.diff(self.frequencies)
        return float(steps.mean()) if np.ptp(steps) < 1e-6 * steps.mean() else None

    @property
    def bandwidth(self) -> float:
        """Pilot spacing times number for a uniform comb, the occupied span otherwise [Hz]."""
        span = float(np.ptp(self.frequencies))
        return span + (self.spacing or 0.0)

    @property
    def max_delay(self) -> float:
        """Unambiguous delay range [s]: the reciprocal of the pilot spacing (of the smallest one for a
        non-uniform comb).
        """
        return self.reach()

    def reach(self, offsets: Float | None = None) -> float:
        """The same of pilots that are shifted by ``offsets`` (N,) [Hz] from symbol to symbol, all symbols together."""
        if self.subcarriers < 2:
            return 0.0
        if offsets is None:
            return 1.0 / (self.spacing or float(np.min(np.diff(self.frequencies))))
        every = np.unique(np.round((self.frequencies + np.unique(offsets)[:, None]).ravel(), 3))  # to a millihertz
        return 1.0 / float(np.min(np.diff(every)))


def comb(carrier: float, spacing: float, pilots: int, step: int = 1) -> Waveform:
    """``pilots`` subcarriers, every ``step``-th of an OFDM grid of ``spacing`` [Hz], centered on the carrier."""
    index = np.arange(pilots) - (pilots - 1) / 2
    return Waveform(carrier, index * spacing * step)
