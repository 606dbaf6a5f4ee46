"""Links and random path sets that the studies and the tests share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .estimators.grids import View
from .fisher import snr
from .signal.arrays import Array, cylinder, ura
from .signal.model import SignalModel
from .signal.paths import PathTable
from .signal.schedule import digital, random_phase_beams, sweep
from .signal.waveform import comb

FRONT = View((-1.15, 1.15), (-0.6, 0.6))
"""What the reference link's planar arrays look at: up to 66 degrees in azimuth, 34 in elevation."""


def reference_link(subcarriers: int = 64, symbols: int = 16, receiver=(4, 4), transmitter=(8, 8)) -> SignalModel:
    """The digital link of the studies (or another of its kind)."""
    return SignalModel(comb(28e9, 6.25e6, subcarriers), digital(symbols, 125e-6), ura(*transmitter), ura(*receiver))


def hybrid_link(seed: int = 3) -> SignalModel:
    """Eq. (2) with precoders and combiners: 64 subcarriers, 4 sweeps of 32 random beams x 4 orthonormal
    combiners of 4 ports, 131 k samples.
    """
    rng = np.random.default_rng(seed)
    square = np.linalg.qr(rng.standard_normal((16, 16)) + 1j * rng.standard_normal((16, 16)))[0]
    combiners = np.moveaxis(square.reshape(16, 4, 4), 1, 0)
    schedule = sweep(random_phase_beams(32, 64, rng), 4, 8.92e-6, combiners=combiners, rng=rng)
    return SignalModel(comb(28e9, 6.25e6, 64), schedule, ura(8, 8), ura(4, 4))


def swept_link(seed: int = 7) -> SignalModel:
    """The radio of ring_road: 400 pilots every 480 kHz, 8 sweeps of 16 random beams, cylinders 16 x 2 and 8 x
    2, 0.82 M samples.
    """
    rng = np.random.default_rng(seed)
    schedule = sweep(random_phase_beams(16, 32, rng), 8, 35.68e-6, rng=rng)
    return SignalModel(comb(28e9, 120e3, 400, 4), schedule, cylinder(16, 2), cylinder(8, 2))


@dataclass(frozen=True)
class Draw:
    """How path sets are drawn: number, separation in at least one mode [bins], delays [s], speeds [m/s],
    strengths below the first [dB].
    """

    paths: int = 8
    separation: float = 1.0
    delays: tuple[float, float] = (20e-9, 140e-9)
    speeds: tuple[float, float] = (-22.0, 22.0)
    decibels: tuple[float, float] = (-30.0, -5.0)


def draw_paths(model: SignalModel, rng: np.random.Generator, draw: Draw = Draw()) -> PathTable:
    """A path of unit gain and weaker ones in front of planar arrays, each pair separated in at least one
    mode.
    """
    count = draw.paths
    period = np.ptp(model.schedule.times) or 1.0
    for _ in range(1000):
        delay, speed = rng.uniform(*draw.delays, count), rng.uniform(*draw.speeds, count)
        cosines = np.stack([rng.uniform(-0.85, 0.85, (2, count)), rng.uniform(-0.5, 0.5, (2, count))], axis=-1)
        elevation = np.arcsin(cosines[..., 1])
        sine = cosines[..., 0] / np.cos(elevation)
        if np.any(np.abs(sine) > 0.91):
            continue
        bins = [delay * model.waveform.bandwidth, speed * period / model.waveform.wavelength]
        for array, cosine in zip((model.receiver, model.transmitter), cosines, strict=True):
            assert isinstance(array, Array)
            bins += [
                cosine[:, 0] * np.ptp(array.positions[:, 1]),
                cosine[:, 1] * np.ptp(array.positions[:, 2]),
            ]
        gap = np.max([np.abs(b[:, None] - b) for b in bins], axis=0) + 1e9 * np.eye(count)
        if gap.min() >= draw.separation:
            break
    azimuth = np.arcsin(sine)
    strength = np.concatenate([[0.0], rng.uniform(*draw.decibels, count - 1)])
    gain = 10 ** (strength / 20) * np.exp(2j * np.pi * rng.random(count))
    angles = np.stack([azimuth, elevation], axis=-1)
    return PathTable(delay, angles[0], angles[1], speed, gain)


def at_snr(model: SignalModel, paths: PathTable, rho) -> PathTable:
    """The same paths with gains such that their post-integration SNRs in unit noise are ``rho`` (P,), linear."""
    unit = replace(paths, gain=np.exp(1j * np.angle(paths.gain)))
    return replace(unit, gain=unit.gain * np.sqrt(np.asarray(rho) / snr(model, unit, 1.0)))
