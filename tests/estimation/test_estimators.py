"""Estimators of digital and hybrid links, and the failure modes that a trial implementation ran into."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimation import (
    CosinePattern,
    Detections,
    Esprit,
    ModelError,
    Nomp,
    PathTable,
    Sage,
    Schedule,
    SignalModel,
    View,
    comb,
    cylinder,
    digital,
    exponential_profile,
    snr,
    synthesize,
    unit_vectors,
    ura,
)
from estimation.estimators import report
from estimation.estimators.projector import Projector
from estimation.estimators.refine import information, linearize
from estimation.evaluate import associate
from estimation.scenarios import FRONT, Draw, at_snr, draw_paths, hybrid_link

VIEWS = {"arrival_view": FRONT, "departure_view": FRONT}


@pytest.fixture(scope="module")
def link() -> SignalModel:
    """A sixteenth of the reference link: 65 k samples."""
    return SignalModel(comb(28e9, 6.25e6, 64), digital(16, 125e-6), ura(2, 4), ura(2, 4))


@pytest.fixture(scope="module")
def nomp(link) -> Nomp:
    """Calibrated on few bursts."""
    return Nomp(link, calibration=8, **VIEWS)


def found_all(model, detections, paths, variance=1.0) -> bool:
    """Exactly the true paths, none of them grossly wrong."""
    match = associate(model, detections, paths, variance)
    inside = np.all(np.abs(match.error) < 6 * np.sqrt(np.diagonal(match.bound, axis1=1, axis2=2)))
    return bool(match.detected.all() and match.false == 0 and inside)


@pytest.mark.parametrize("kind", [Nomp, Sage, Esprit])
def test_all_estimators_find_strong_paths(link, nomp, kind):
    estimator = kind(link, threshold=nomp.threshold, **VIEWS)
    rng = np.random.default_rng(4)
    for _ in range(2):
        paths = at_snr(link, draw_paths(link, rng, Draw(paths=4, separation=1.5)), [1e6, 3e5, 1e5, 1e5])
        assert found_all(link, estimator.run(synthesize(link, paths, 1.0, rng)), paths)


def test_esprit_alone_is_near_and_serves_as_a_start(link, nomp):
    rng = np.random.default_rng(6)
    paths = at_snr(link, draw_paths(link, rng, Draw(paths=3, separation=2)), [1e6, 1e6, 1e6])
    signal = synthesize(link, paths, 1.0, rng)
    rough = Esprit(link, threshold=nomp.threshold, refine=False, **VIEWS).run(signal)
    assert len(rough) == 3
    assert found_all(link, nomp.run(signal, prior=rough), paths)
    with pytest.raises(ModelError, match="fully digital"):
        Esprit(hybrid_link(), threshold=25.0)
    with pytest.raises(ModelError, match="displacements"):
        Esprit(replace(link, receiver=cylinder(7, 1, radius=0.9)), threshold=25.0)


def test_hybrid_link(tmp_path):
    model = hybrid_link()
    estimator = Nomp(model, threshold=26.0, **VIEWS)
    rng = np.random.default_rng(8)
    for _ in range(3):
        paths = at_snr(model, draw_paths(model, rng, Draw(paths=4)), 10 ** rng.uniform(2.0, 3.5, 4))
        assert found_all(model, estimator.run(synthesize(model, paths, 1.0, rng)), paths)


def test_combiners_with_a_digital_transmitter():
    """No beams to sweep: the staged search reads the link backwards, where the combiners are the beams."""
    rng = np.random.default_rng(18)
    combiners = rng.standard_normal((4, 8, 4)) + 1j * rng.standard_normal((4, 8, 4))
    index = np.concatenate([rng.permutation(4) for _ in range(6)])
    schedule = Schedule(40e-6 * np.arange(24), None, None, combiners, index)
    model = SignalModel(comb(28e9, 6.25e6, 32), schedule, ura(2, 4), ura(2, 4))
    estimator = Nomp(model, threshold=26.0, **VIEWS)
    for _ in range(3):
        paths = draw_paths(model, rng, Draw(paths=3))
        paths = at_snr(model, paths, 10 ** rng.uniform(2.2, 4.0, 3))
        assert found_all(model, estimator.run(synthesize(model, paths, 1.0, rng)), paths)


def test_warm_start_agrees_and_forgets_what_is_gone(link, nomp):
    rng = np.random.default_rng(9)
    paths = at_snr(link, draw_paths(link, rng, Draw(paths=4)), [1e4, 3e3, 1e3, 300])
    signal = synthesize(link, paths, 1.0, rng)
    cold = nomp.run(signal)
    ghost = PathTable([50e-9], [[0.1, 0.1]], [[0.2, -0.2]], [3.0], [1.0])
    prior = PathTable(
        *(
            np.concatenate(p)
            for p in zip(
                (cold.delay, cold.aoa, cold.aod, cold.radial_velocity, cold.gain),
                (ghost.delay, ghost.aoa, ghost.aod, ghost.radial_velocity, ghost.gain),
                strict=True,
            )
        )
    )
    warm = nomp.run(signal, prior=prior)
    assert len(warm) == len(cold) == 4
    assert np.allclose(warm.delay, cold.delay, atol=1e-3 / 400e6) and np.allclose(warm.snr, cold.snr, rtol=1e-3)
    assert isinstance(warm, Detections) and warm.p_d(warm.snr[0]) > 0.99


@pytest.mark.mc
def test_dense_multipath_is_whitened(link):
    covariance = exponential_profile(link.waveform, 3.0, 20e-9, 20e-9)
    truth = replace(link, pilot_covariance=covariance)
    rng = np.random.default_rng(12)
    white, aware = (
        Nomp(link, threshold=24.0, **VIEWS),
        Nomp(link, threshold=24.0, dense_multipath=True, **VIEWS),
    )
    false = np.zeros(2)
    for _ in range(2):
        paths = draw_paths(link, rng, Draw(paths=3))
        paths = replace(
            paths,
            gain=paths.gain
            * np.sqrt(
                np.array([1e4, 3e3, 1e3]) / snr(truth, replace(paths, gain=np.exp(1j * np.angle(paths.gain))), 1.0)
            )
            / np.abs(paths.gain),
        )
        signal = synthesize(truth, paths, 1.0, rng)
        for number, estimator in enumerate((white, aware)):
            match = associate(truth, estimator.run(signal), paths, 1.0)
            false[number] += match.false
            assert number == 0 or match.detected.all()
    assert false[0] >= 3 and false[1] == 0


def test_squint_makes_ghosts_only_when_the_model_ignores_it():
    narrow = SignalModel(comb(28e9, 6.25e6, 64), digital(4, 125e-6), ura(2, 16), ura(2, 4))
    wide = replace(narrow, subbands=8)
    path = PathTable([80e-9], [[0.6, 0.1]], [[0.95, 0.1]], [20.0], [1.0])
    rng = np.random.default_rng(13)
    path = at_snr(wide, path, [10**5.5])
    signal = synthesize(wide, path, 1.0, rng)
    ignorant = Nomp(narrow, threshold=26.0, **VIEWS)
    assert len(ignorant.run(signal)) > 1
    assert found_all(wide, Nomp(wide, threshold=26.0, **VIEWS).run(signal), path)


class TestFailureModes:
    """Regression tests of what broke in trials (estimation notes, 2.6)."""

    def test_close_pair_is_two_paths_not_three(self, link, nomp):
        """1. A path added before the joint fit has converged leaves a wrong local optimum with three paths
        for two.
        """
        for seed in range(4):
            rng = np.random.default_rng(100 + seed)
            one = draw_paths(link, rng, Draw(paths=1))
            both = PathTable(
                np.r_[one.delay, one.delay + 0.5 / 400e6],
                np.repeat(one.aoa, 2, 0),
                np.repeat(one.aod, 2, 0),
                np.repeat(one.radial_velocity, 2),
                np.exp(2j * np.pi * rng.random(2)),
            )
            level = np.sqrt(1e4 / np.prod(link.shape))
            both = replace(both, gain=both.gain * level)
            detections = nomp.run(synthesize(link, both, 1.0, rng))
            assert len(detections) == 2
            assert np.all(detections.flags & 1)

    def test_endfire_alias_is_not_a_second_path(self, link):
        """2. The two ends of a half-wavelength axis are one direction: candidates are told apart by
        coherence.
        """
        wide = View((-1.5, 1.5), (-0.6, 0.6))
        estimator = Nomp(link, threshold=24.0, arrival_view=wide, departure_view=wide)
        for seed in range(4):
            rng = np.random.default_rng(200 + seed)
            path = PathTable(
                [80e-9],
                [[1.48 * (-1) ** seed, 0.0]],
                [[0.3, 0.1]],
                [5.0],
                [np.sqrt(1e4 / np.prod(link.shape))],
            )
            assert len(estimator.run(synthesize(link, path, 1.0, rng))) == 1

    def test_degenerate_pair_becomes_one(self, link, nomp):
        """3. Two components that a refitted single one replaces within the threshold are one path."""
        rng = np.random.default_rng(300)
        one = at_snr(link, draw_paths(link, rng, Draw(paths=1)), [1e3])
        signal = synthesize(link, one, 1.0, rng)
        near = PathTable(
            np.r_[one.delay - 0.15 / 400e6, one.delay + 0.15 / 400e6],
            np.repeat(one.aoa, 2, 0),
            np.repeat(one.aod, 2, 0),
            np.repeat(one.radial_velocity, 2),
            np.ones(2),
        )
        assert len(nomp.run(signal, prior=near)) == 1

    def test_weak_path_beside_a_very_strong_one(self, link, nomp):
        """4. Single-precision energy differences (3e-7 of the total) must not decide: 60 dB beside 20 dB."""
        for seed in range(3):
            rng = np.random.default_rng(400 + seed)
            paths = at_snr(link, draw_paths(link, rng, Draw(paths=2, separation=2)), [1e7, 150.0])
            assert found_all(link, nomp.run(synthesize(link, paths, 1.0, rng)), paths)

    def test_delay_beyond_one_period_keeps_the_gain(self, link, nomp):
        """5. Wrapping a delay by one period flips the gain's sign for an even number of centered pilots."""
        rng = np.random.default_rng(500)
        path = at_snr(link, draw_paths(link, rng, Draw(paths=1)), [1e5])
        beyond = replace(path, delay=path.delay + link.waveform.max_delay)
        detections = nomp.run(synthesize(link, beyond, 1.0, rng))
        assert detections.delay[0] == pytest.approx(path.delay[0], abs=1e-11)
        assert detections.gain[0] == pytest.approx(-path.gain[0], abs=0.05 * abs(path.gain[0]))

    def test_sidelobes_are_not_paths(self, link, nomp):
        """6. Peaks of one pass are taken within 10 dB only: a strong path alone gives one detection."""
        for seed in range(4):
            rng = np.random.default_rng(600 + seed)
            path = at_snr(link, draw_paths(link, rng, Draw(paths=1)), [10**5.5])
            assert len(nomp.run(synthesize(link, path, 1.0, rng))) == 1

    @pytest.mark.parametrize("angle", [0.0, 2.55, 3.0])
    def test_close_pair_in_phase_and_in_opposition(self, angle):
        """7. In phase, two paths 0.3 bins apart leave side lobes below the threshold; in opposition the first single
        path lies beside both, and a joint fit from there is stuck.
        """
        model = SignalModel(comb(28e9, 6.25e6, 64), digital(16, 125e-6), ura(4, 4), ura(4, 4))
        estimator = Nomp(model, threshold=24.1, **VIEWS)
        sines = np.array([0.03, 0.18]) / np.cos(0.25)
        for seed in range(2):
            both = PathTable(
                [50e-9, 50e-9],
                np.c_[np.arcsin(sines), [0.25, 0.25]],
                [[0.75, -0.13], [0.75, -0.13]],
                [-0.6, -0.6],
                np.sqrt(2e4 / np.prod(model.shape)) * np.exp([0.3j, 0.3j + 1j * angle]),
            )
            rng = np.random.default_rng(700 + seed)
            match = associate(model, estimator.run(synthesize(model, both, 1.0, rng)), both, 1.0)
            assert match.detected.all() and match.false == 0


def test_a_fit_that_ends_behind_a_planar_array_is_reported_in_front(link, nomp):
    rng = np.random.default_rng(21)
    paths = at_snr(link, draw_paths(link, rng, Draw(paths=2, separation=2)), [1e4, 1e3])
    behind = replace(paths, aoa=np.c_[np.pi - paths.aoa[:, 0], paths.aoa[:, 1]])
    detections = nomp.run(synthesize(link, paths, 1.0, rng), prior=behind)
    assert found_all(link, detections, paths) and not np.any(detections.flags & 2)


def test_direction_covariance_stays_regular_near_the_pole():
    model = SignalModel(comb(28e9, 6.25e6, 32), digital(8, 125e-6), cylinder(8, 3), cylinder(8, 3))
    path = PathTable([60e-9], [[0.4, np.pi / 2 - 1e-5]], [[-1.0, 0.3]], [4.0], [1.0])
    path = at_snr(model, path, [1e4])
    rng = np.random.default_rng(0)
    # Rings half a wavelength apart cannot tell the poles from one another.
    upper = View(elevation=(0.0, np.pi / 2))
    estimator = Nomp(model, threshold=25.0, arrival_view=upper, search_options={"retained": 0.6})
    detections = estimator.run(synthesize(model, path, 1.0, rng))
    assert len(detections) == 1 and detections.flags[0] & 8
    covariance = detections.direction_covariance("aoa")[0]
    assert np.isfinite(covariance).all() and np.sqrt(np.trace(covariance)) < 0.05
    error = unit_vectors(detections.aoa[0]) - unit_vectors(path.aoa[0])
    assert np.linalg.norm(error) < 5 * np.sqrt(np.trace(covariance))


def test_a_path_that_a_step_takes_behind_the_array_gets_no_gain(link):
    """Paper B's courtyard: the planar array on the wall has nothing behind it, and the fit wandered there."""
    model = replace(link, receiver=replace(link.receiver, pattern=CosinePattern()))
    paths = PathTable([60e-9, 70e-9], [[0.4, 0.1], [np.pi, 0.0]], [[0.3, 0.0], [0.2, 0.0]], [0.0, 0.0], [1.0, 1.0])
    signal = synthesize(model, paths, 1e-6, np.random.default_rng(0))
    lin = linearize(Projector(model, signal, None), paths.geometry)
    assert lin.gain[1] == 0 and abs(lin.gain[0] - 1) < 1e-3
    assert np.isfinite(information(lin, model.active)).all() and np.isfinite(lin.drop).all()
    nomp = Nomp(model, threshold=25.0)
    told = report.detections(nomp, Projector(model, signal, None), lin, 1e-6)
    assert len(told) == 1 and np.isfinite(told.covariance).all() and abs(told.delay[0] - 60e-9) < 1e-12
    sage, gain = Sage(model, threshold=25.0), lin.gain.copy()
    assert np.array_equal(sage._maximize(Projector(model, signal, None), paths.geometry, gain, 1).delay, paths.delay)
    assert gain[1] == 0
