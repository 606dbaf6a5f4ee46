"""Amplitude statistics against integrals, sampling and closed forms."""

import numpy as np
import pytest
from scipy import integrate, stats

from dopslam.errors import FilterError
from dopslam.models.amplitude import AmplitudeModel, Radio, flat_rms_bandwidth, squared_aperture
from dopslam.records import SPEED_OF_LIGHT

MODEL = AmplitudeModel(threshold=np.sqrt(10**0.9), samples=1024.0)


@pytest.mark.parametrize("u", [0.2, 2.0, 5.0, 30.0])
def test_truncated_rice_integrates_to_one(u):
    top = u + 40
    total, _ = integrate.quad(
        lambda z: np.exp(MODEL.log_likelihood(z, u)),
        MODEL.threshold,
        top,
        points=[max(u, MODEL.threshold)],
        limit=200,
    )
    assert total == pytest.approx(1, rel=1e-7)


def test_rice_is_scipys():
    z, u = np.meshgrid(np.linspace(1.0, 26, 30), [0.1, 3.0, 12.0])
    scale = np.sqrt(MODEL.variance(u))
    np.testing.assert_allclose(MODEL.log_rice(z, u), stats.rice.logpdf(z, u / scale, scale=scale), rtol=1e-9, atol=1e-9)


def test_detection_probability_counts_samples():
    rng = np.random.default_rng(0)
    for u in (1.0, 3.0, 4.0):
        hits = np.mean(MODEL.sample(rng, np.full(200_000, u)) > MODEL.threshold)
        assert hits == pytest.approx(float(MODEL.detection_probability(u)), abs=5e-3)


def test_missed_table():
    u = np.linspace(0, 40, 777)
    exact = np.maximum(1 - MODEL.detection_probability(u), 0.01)
    np.testing.assert_allclose(MODEL.missed_probability(u), exact, atol=1e-5)


@pytest.mark.parametrize("tail", [0.0, 0.1])
def test_false_alarm_density_and_samples(tail):
    model = AmplitudeModel(MODEL.threshold, 1024.0, tail_weight=tail)
    total, _ = integrate.quad(lambda z: np.exp(model.log_false_alarm(z)), model.threshold, 60, points=[4, 8], limit=200)
    assert total == pytest.approx(1, rel=1e-6)
    samples = model.sample_false_alarm(np.random.default_rng(1), 100_000)
    assert samples.min() > model.threshold
    below, _ = integrate.quad(lambda z: np.exp(model.log_false_alarm(z)), model.threshold, 3.2)
    assert np.mean(samples < 3.2) == pytest.approx(below, abs=6e-3)


def test_noise_only_rice_is_the_false_alarm_rayleigh():
    z = np.linspace(3, 6, 7)
    np.testing.assert_allclose(MODEL.log_rice(z, 0.0) + MODEL.threshold**2, MODEL.log_false_alarm(z), rtol=1e-12)


def test_fisher_deviations_of_the_pedestrian_radio():
    """Values of the synthetic experiment: 0.152 m, 7.16° and 2.80° at u = 1."""
    wavelength = SPEED_OF_LIGHT / 28e9
    radio = Radio(28e9, flat_rms_bandwidth(768e6), 0.9 * wavelength, 2.3 * wavelength)
    distance, aoa, aod = radio.unit_deviations
    assert distance == pytest.approx(0.152, abs=5e-4)
    assert np.degrees(aoa) == pytest.approx(7.16, abs=0.01)
    assert np.degrees(aod) == pytest.approx(2.80, abs=0.01)


def test_aperture_of_a_ring_is_isotropic():
    angles = 2 * np.pi * np.arange(16) / 16
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    np.testing.assert_allclose(squared_aperture(ring, np.linspace(0, 3, 5)), 0.5, rtol=1e-12)


def test_bad_parameters_are_named():
    with pytest.raises(FilterError, match="threshold"):
        AmplitudeModel(threshold=0.0, samples=1.0)
    with pytest.raises(FilterError, match="tail_weight"):
        AmplitudeModel(threshold=1.0, samples=1.0, tail_weight=1.5)
