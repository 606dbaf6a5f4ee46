"""States known exactly, and detections far sharper than the motion: every filter runs, none below its numbers."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.filters import FILTERS
from dopslam.pipeline import problem as build
from dopslam.simulate.world import FixedNoise, section_v, simulate
from dopslam.slam.filter import run

MILLIMETRES = np.array([1e-3, 1e-4, 1e-4, 1e-4, 1e-4, 1e-3])  # about 45 dB of the ring road's link
TENTHS = MILLIMETRES / 10  # about 60 dB


def known(situation, entries):
    """The same world with entries of the state known at the start and moving without noise."""
    keep = np.ones(4)
    keep[list(entries)] = 0.0
    both = np.outer(keep, keep)
    motion = replace(situation.motion, process_noise=situation.motion.process_noise * both)
    return replace(situation, prior_covariance=situation.prior_covariance * both, motion=motion)


def filtered(situation, name):
    chosen = FILTERS[name]()
    chosen = replace(chosen, particles=200) if name == "bp" else chosen
    states, scans = simulate(situation, 11, 0)
    history, _ = run(build.told(situation), scans, chosen)
    scale = np.sqrt(np.maximum(np.einsum("kii->ki", history.covariance), 1e-30))
    assert np.linalg.eigvalsh(history.covariance / (scale[:, :, None] * scale[:, None, :])).min() > -1e-9
    return np.linalg.norm(history.mean[:, :2] - states[:, :2], axis=1), history


@pytest.mark.parametrize("name", ["joint", "marginal", "smoother", "mixture", "bp"])
@pytest.mark.parametrize("entries", [(3,), (2,), (0, 1, 2, 3)], ids=["clock", "heading", "all"])
def test_a_state_known_exactly_stays_so(name, entries):
    off, history = filtered(known(section_v(steps=12), entries), name)
    assert off.max() < (1e-5 if len(entries) == 4 else 1.5)
    assert np.allclose(history.covariance[:, entries, entries], 0.0, atol=1e-6)


@pytest.mark.parametrize("name", ["joint", "marginal", "smoother", "mixture"])
def test_a_motion_without_noise_and_a_place_known_exactly(name):
    situation = section_v(steps=12)
    silent = replace(situation, motion=replace(situation.motion, process_noise=np.zeros((4, 4))))
    assert filtered(silent, name)[0].max() < 1.0
    assert filtered(known(situation, (0, 1)), name)[0].max() < 1.0


@pytest.mark.parametrize("name", ["joint", "marginal", "smoother", "mixture", "bp"])
@pytest.mark.parametrize("std", [MILLIMETRES, TENTHS], ids=["45 dB", "60 dB"])
def test_sharp_detections_beside_a_coarse_motion(name, std):
    """Millimetres against twenty centimetres a step, with the clock unknown and known."""
    situation = replace(section_v(steps=12), noise=FixedNoise(std, 0.9, 50.0))
    for case in (situation, known(situation, (3,))):
        assert filtered(case, name)[0][2:].max() < 20 * std[0]
