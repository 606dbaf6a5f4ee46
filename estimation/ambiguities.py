"""Is the schedule unambiguous? Doppler against beam order.

A swept beam codes the departure direction into the order of gains over time, and Doppler turns phases over
time: with DFT beams in a fixed order a multiple of wavelength over sweep time in speed looks like another
direction, and detections are off by exactly that. A fresh permutation in every sweep, or random-phase beams,
break the pattern.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from .estimators.grids import View, direction_grid
from .signal.directions import Float
from .signal.model import SignalModel

LIMIT = 0.9
"""Normalized correlation above which noise will pick the wrong peak at moderate SNR."""


class ScheduleWarning(UserWarning):
    """Doppler and beam order cannot be told apart."""


@dataclass(frozen=True, eq=False)
class Ambiguity:
    """Largest correlation of a path with one at another speed and any departure direction.

    Attributes
    ----------
    level : (D,) per probed direction, 0 (unambiguous) to 1 (indistinguishable)
    speed : (D,) speed difference at which it occurs [m/s]
    profile : (V,) the largest level over all directions, at ``speeds``
    speeds : (V,) speed differences examined [m/s]
    """

    level: Float
    speed: Float
    profile: Float
    speeds: Float

    @property
    def ambiguous_speeds(self) -> Float:
        """Local maxima of the profile above the limit [m/s]."""
        padded = np.concatenate([[-1.0], self.profile, [-1.0]])
        peak = (self.profile > LIMIT) & (padded[:-2] < self.profile) & (self.profile >= padded[2:])
        return self.speeds[peak]


def ambiguity(
    model: SignalModel, max_speed: float, departure_view: View | None = None, directions: int = 24
) -> Ambiguity:
    """Examine speed differences between the Doppler resolution and ``2 * max_speed`` [m/s]."""
    schedule, wavelength = model.schedule, model.waveform.wavelength
    duration = np.ptp(schedule.times)
    resolution = wavelength / duration if duration > 0 else np.inf
    if 2 * max_speed <= 1.5 * resolution:
        return Ambiguity(np.zeros(1), np.zeros(1), np.zeros(1), np.zeros(1))
    speeds = np.arange(1.5 * resolution, 2 * max_speed, resolution / 4)
    phase = np.exp(2j * np.pi / wavelength * np.outer(schedule.times, speeds))
    precoders = schedule.precoders
    if precoders is None:
        level = np.abs(phase.mean(axis=0))
        best = int(np.argmax(level))
        return Ambiguity(level[[best]], speeds[[best]], level, speeds)

    def beams(response):
        return response.conj() @ precoders.T

    grid = direction_grid(departure_view or View(), model.transmitter, 0.8, beams)
    gains = beams(model.transmitter.response(grid)[0])[:, schedule.precoder_index]
    gains = gains / np.maximum(np.linalg.norm(gains, axis=1, keepdims=True), 1e-300)
    probes = gains[np.unique(np.linspace(0, len(gains) - 1, directions).round().astype(int))]
    level, speed, profile = np.empty(len(probes)), np.empty(len(probes)), np.zeros(len(speeds))
    for number, probe in enumerate(probes):
        surface = np.abs((gains * probe.conj()) @ phase).max(axis=0)
        best = int(np.argmax(surface))
        level[number], speed[number] = surface[best], speeds[best]
        np.maximum(profile, surface, out=profile)
    return Ambiguity(level, speed, profile, speeds)


def check_schedule(model: SignalModel, max_speed: float, departure_view: View | None = None) -> Ambiguity:
    """Warn (:class:`ScheduleWarning`) if Doppler and beam order are ambiguous within ``max_speed``, and say
    at which speeds.
    """
    result = ambiguity(model, max_speed, departure_view)
    if result.level.max() > LIMIT:
        where = ", ".join(f"{s:.1f}" for s in result.ambiguous_speeds[:6])
        share = float(np.mean(result.level > LIMIT))
        warnings.warn(
            f"schedule: {share:.0%} of the departure directions are ambiguous in Doppler at speed "
            f"differences of {where} m/s "
            f"(correlation up to {result.level.max():.3f}); use a fresh permutation of the beams in "
            "every sweep, "
            "random-phase beams, or a smaller max_speed",
            ScheduleWarning,
            stacklevel=2,
        )
    return result
