"""Exceptions of the ``estimation`` package.

Every error raised on purpose derives from :class:`EstimationError`; its message names what is wrong, where,
the offending value and the remedy.
"""

from __future__ import annotations


class EstimationError(Exception):
    """Base of all errors raised on purpose by ``estimation``."""


class SignalError(EstimationError):
    """A received signal does not fit its model (shape, type, non-finite samples)."""


class ModelError(EstimationError):
    """Arrays, waveform, schedule or estimator parameters that cannot be used together."""
