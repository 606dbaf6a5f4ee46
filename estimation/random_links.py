"""Links drawn from all that is supported, and what the estimators make of them: with a right model and a wrong one.

Nothing here is tuned to a link: carriers, combs, arrays, schedules, path numbers and strengths all come from a seed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .estimators.nomp import Nomp
from .evaluate import associate, summarize
from .scenarios import at_snr
from .signal.arrays import Array, cylinder, ura
from .signal.impairments import Impairments
from .signal.model import SignalModel
from .signal.paths import PARAMETERS, PathTable
from .signal.patterns import CosinePattern, DipolePattern, outward
from .signal.schedule import Schedule, digital, random_phase_beams, sweep
from .signal.waveform import SPEED_OF_LIGHT, Waveform, comb

SEARCHED = 25.0
"""Largest radial velocity [m/s] of paths and searches."""
LARGEST = 60_000
"""Samples of a drawn link."""
WRONG = {
    "clean": Impairments(),
    "positions 0.005": Impairments(position=0.005),
    "positions 0.01": Impairments(position=0.01),
    "gain 0.5 dB, 5 deg": Impairments(gain_db=0.5, phase_deg=5),
    "phase noise 3 deg": Impairments(phase_noise_deg=3),
    "phase noise 10 deg": Impairments(phase_noise_deg=10),
}


def random_array(rng: np.random.Generator) -> Array:
    """A cylinder or a panel, of isotropic, patch or dipole elements."""
    if rng.random() < 0.5:
        bare = cylinder(int(rng.integers(6, 15)), int(rng.integers(2, 4)), spacing=rng.uniform(0.42, 0.5))
        patch = outward(bare.positions)
    else:
        bare = ura(int(rng.integers(2, 5)), int(rng.integers(2, 7)), rng.uniform(0.42, 0.5))
        patch = CosinePattern()
    return replace(bare, pattern=[None, patch, DipolePattern()][rng.integers(3)])


def random_link(rng: np.random.Generator) -> SignalModel:
    """A digital, swept, hybrid or combined link of at most :data:`LARGEST` samples whose speeds are unambiguous."""
    while True:
        carrier = float(rng.choice([3.5e9, 6.7e9, 15e9, 28e9, 60e9]))
        wavelength = SPEED_OF_LIGHT / carrier
        transmitter, receiver = random_array(rng), random_array(rng)
        pilots = int(np.exp(rng.uniform(np.log(16), np.log(200))))
        spacing = rng.uniform(0.5e6, 4e6)
        waveform = comb(carrier, spacing, pilots)
        if rng.random() < 0.2:
            tones = np.sort(rng.choice(3 * pilots, pilots, replace=False)) * spacing / 2
            waveform = Waveform(carrier, tones - tones.mean())
        slow = wavelength / (2 * 1.3 * SEARCHED)  # s, between looks through the same beam
        kind = rng.choice(["digital", "swept", "hybrid", "combined"])
        if kind == "digital":
            schedule = digital(int(rng.integers(4, 17)), min(slow, 1e-3))
        else:
            combiners = None
            if kind != "swept":
                ports = receiver.elements // 2
                square = rng.standard_normal((2, receiver.elements, receiver.elements, 2)) @ [1, 1j]
                unitary = np.linalg.qr(square[0])[0]
                combiners = np.stack([unitary[:, :ports], unitary[:, ports : 2 * ports]])
            beams = 1 if kind == "combined" else int(min(transmitter.elements, rng.integers(8, 25)))
            book = random_phase_beams(beams, transmitter.elements, rng) if beams > 1 else np.ones((1, 1))
            looks = beams * (1 if combiners is None else 2)
            order = "linear" if kind == "combined" else "permuted"
            schedule = sweep(
                book, int(rng.integers(4, 9)), min(slow, 1e-3) / looks, order=order, combiners=combiners, rng=rng
            )
            if kind == "combined":
                schedule = Schedule(schedule.times, None, None, schedule.combiners, schedule.combiner_index)
        model = SignalModel(waveform, schedule, transmitter, receiver)
        if np.prod(model.shape) <= LARGEST:
            return model


def random_paths(model: SignalModel, rng: np.random.Generator, decibels=(18.0, 45.0)) -> PathTable:
    """Two to eight paths of so much rho within all that the link can tell, at least two cells of delay or speed apart."""
    count = int(rng.integers(2, 9))
    longest = min(model.max_delay, 40 / model.waveform.bandwidth)
    cells = np.array([1 / model.waveform.bandwidth, model.waveform.wavelength / np.ptp(model.schedule.times)])
    for _ in range(10_000):
        delay, speed = rng.uniform(0, longest, count), rng.uniform(-0.95, 0.95, count) * SEARCHED
        gap = np.abs(np.stack([delay, speed])[:, :, None] - np.stack([delay, speed])[:, None]) / cells[:, None, None]
        if (np.max(gap, axis=0) + 9 * np.eye(count)).min() > 2:
            break
        count = max(2, count - (rng.random() < 0.01))
    ends = []
    for array in (model.receiver, model.transmitter):
        ahead = 1.1 if isinstance(array, Array) and array.normal is not None else np.pi
        ends.append(np.c_[rng.uniform(-ahead, ahead, count), rng.uniform(-0.7, 0.7, count)])
    unit = PathTable(delay, ends[0], ends[1], speed, np.exp(2j * np.pi * rng.random(count)))
    return at_snr(model, unit, 10 ** (rng.uniform(decibels[0], decibels[1], count) / 10))


def right_model(links: int, snapshots: int, seed: int = 1000) -> list[dict]:
    """Figures of ``links`` random links, ``snapshots`` bursts each, estimated with their own model."""
    rows = []
    for number in range(links):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
        model = random_link(rng)
        estimator = Nomp(model, max_speed=SEARCHED)
        matches = []
        for _ in range(snapshots):
            paths = random_paths(model, rng)
            found = estimator.run(Impairments().signal(model, paths, 1.0, rng))
            matches.append(associate(model, found, paths, 1.0))
        total = summarize(matches)
        present = sum(len(m.rho) for m in matches)
        rows.append(
            {
                "link": number,
                "shape": list(model.shape),
                "rmse_over_crb": dict(zip(PARAMETERS, total.rmse_over_crb.tolist(), strict=False)),
                "nees_over_6": total.nees_over_n,
                "nees_interval": total.nees_interval.tolist(),
                "false_per_snapshot": total.false_per_snapshot,
                "found": sum(int(m.detected.sum()) for m in matches) / present,
                "gross": total.gross,
                "paths": present,
            }
        )
    return rows


def wrong_model(snapshots: int, seed: int = 1000) -> dict[str, dict]:
    """Ghosts, own-covariance NEES and paths found under each of :data:`WRONG`, and with the strongest path too fast: a new
    random link, its strongest path 50 dB, in every burst.
    """
    rows = {}
    for name in (*WRONG, "40 m/s"):
        ghosts, nees, found = [], [], []
        for number in range(snapshots):
            rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
            model = random_link(rng)
            estimator = Nomp(model, max_speed=SEARCHED, threshold=27.0)
            paths = random_paths(model, rng)
            lead = at_snr(model, paths.take([0]), [1e5])
            paths = replace(paths, gain=np.r_[lead.gain, paths.gain[1:]])
            if name == "40 m/s":
                paths = replace(paths, radial_velocity=np.r_[40.0, paths.radial_velocity[1:]])
            signal = WRONG.get(name, Impairments()).signal(model, paths, 1.0, rng, number)
            match = associate(model, estimator.run(signal), paths, 1.0)
            ghosts.append(max(match.false + int(match.detected.sum()) - len(paths), 0))
            nees += list(match.nees / match.error.shape[1])
            found.append(match.detected.mean())
        rows[name] = {
            "ghosts_per_snapshot": float(np.mean(ghosts)),
            "nees_over_6": float(np.mean(nees)),
            "found": float(np.mean(found)),
        }
    return rows
