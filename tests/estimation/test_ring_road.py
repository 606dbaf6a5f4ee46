"""The swept link of ring_road: cylinders at both ends, random-phase beams, staged search."""

from __future__ import annotations

import numpy as np
import pytest

from estimation import (
    ModelError,
    Nomp,
    PathTable,
    SignalError,
    SignalModel,
    View,
    comb,
    cylinder,
    random_phase_beams,
    snr,
    sweep,
    synthesize,
)
from estimation.evaluate import associate


@pytest.fixture(scope="module")
def link() -> SignalModel:
    """A quarter of ring_road's bandwidth and half its sweeps."""
    rng = np.random.default_rng(7)
    beams = random_phase_beams(16, 32, rng)
    return SignalModel(comb(28e9, 120e3, 100, 4), sweep(beams, 4, 35.68e-6, rng=rng), cylinder(16, 2), cylinder(8, 2))


@pytest.fixture(scope="module")
def estimator(link) -> Nomp:
    """Calibrated once."""
    return Nomp(link)


def some_paths(link, rho_db, rng) -> PathTable:
    """Paths of given post-integration SNR in unit noise, anywhere in view."""
    count = len(rho_db)
    unit = PathTable(
        rng.uniform(0.1e-6, 2e-6, count),
        np.c_[rng.uniform(-3, 3, count), rng.uniform(-0.5, 1.2, count)],
        np.c_[rng.uniform(-3, 3, count), rng.uniform(-1.2, 0.5, count)],
        rng.uniform(-22, 22, count),
        np.exp(2j * np.pi * rng.random(count)),
    )
    gain = unit.gain * np.sqrt(10 ** (np.asarray(rho_db) / 10) / snr(link, unit, 1.0))
    return PathTable(unit.delay, unit.aoa, unit.aod, unit.radial_velocity, gain)


def test_finds_every_path_and_nothing_else(link, estimator):
    rng = np.random.default_rng(11)
    for _ in range(3):
        paths = some_paths(link, [45, 35, 30, 24, 20], rng)
        detections = estimator.run(synthesize(link, paths, 1.0, rng))
        match = associate(link, detections, paths, 1.0)
        assert match.detected.all() and match.false == 0
        assert abs(detections.noise_variance - 1) < 0.02
        assert np.all(np.abs(match.error) < 6 * np.sqrt(np.diagonal(match.bound, axis1=1, axis2=2)))
        assert np.all(np.diff(detections.snr) <= 0)
        assert np.all(np.linalg.eigvalsh(detections.tangent_covariance * 1.0)[:, 0] > -1e-12)
        gains = detections.gain[match.found] / paths.gain[match.truth]
        assert np.all(np.abs(gains - 1) < 6 / np.sqrt(match.rho[match.truth]))


def test_noise_alone_gives_no_path_and_the_right_variance(link, estimator):
    rng = np.random.default_rng(3)
    silence = PathTable(*[np.empty(s) for s in ((0,), (0, 2), (0, 2), (0,), (0,))])
    for _ in range(4):
        detections = estimator.run(synthesize(link, silence, 3.0, rng))
        assert len(detections) == 0
        assert abs(detections.noise_variance / 3 - 1) < 0.02


def test_zero_signal_is_an_empty_set(link, estimator):
    detections = estimator.run(np.zeros(link.shape, np.complex64))
    assert len(detections) == 0 and detections.covariance.shape == (0, 6, 6)


def test_noise_free_signal_does_not_break(link, estimator):
    rng = np.random.default_rng(5)
    paths = some_paths(link, [40, 30], rng)
    detections = estimator.run(synthesize(link, paths))
    match = associate(link, detections, paths, 1.0)
    assert match.detected.all() and np.isfinite(detections.covariance).all()


def test_bad_input_is_refused(link, estimator):
    with pytest.raises(SignalError, match="shape"):
        estimator.run(np.zeros((4, 4)))
    bad = np.ones(link.shape, np.complex64)
    bad[3, 2, 1] = np.inf
    with pytest.raises(SignalError, match="infinite"):
        estimator.run(bad)
    with pytest.raises(ModelError, match="unambiguous"):
        Nomp(link, max_delay=1.0)
    with pytest.raises(ModelError, match="false_alarm_rate"):
        Nomp(link, false_alarm_rate=-1)
    with pytest.raises(ModelError, match="max_speed"):
        Nomp(link, max_speed=np.nan)
    with pytest.raises(ModelError, match="no direction"):
        Nomp(link, arrival_view=View(elevation=(2.0, 3.0)))


def test_false_alarm_rate_moves_the_threshold(link):
    strict, loose = (Nomp(link, false_alarm_rate=rate).threshold for rate in (0.001, 0.1))
    assert strict - loose == pytest.approx(np.log(100), abs=0.7)
