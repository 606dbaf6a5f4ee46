"""The fast noise generator: distribution, independence, reproducibility."""

from __future__ import annotations

import numpy as np
from scipy import stats

from estimation import white_noise


def test_noise_is_circular_gaussian():
    noise = white_noise((1000, 1000), 2.0, np.random.default_rng(0)).ravel()
    parts = noise.view(np.float32).astype(float)
    count = len(parts)
    assert np.all(np.isfinite(parts))
    assert abs(parts.mean()) < 4 / np.sqrt(count)
    assert abs(parts.var() - 1) < 4 * np.sqrt(2 / count)
    assert abs(stats.kurtosis(parts)) < 4 * np.sqrt(24 / count)
    assert abs(np.mean(noise.real * noise.imag)) < 4 / np.sqrt(count / 2)
    assert stats.kstest(parts[:200_000], "norm").pvalue > 1e-3
    assert stats.kstest(np.abs(noise[:200_000]) ** 2, "expon", args=(0, 2.0)).pvalue > 1e-3
    # Two-sided tails as heavy as they should be.
    for level in (3.0, 4.0, 5.0):
        expected = count * 2 * stats.norm.sf(level)
        assert abs(np.sum(np.abs(parts) > level) - expected) < 5 * np.sqrt(expected) + 1


def test_noise_is_white():
    noise = white_noise((1 << 18,), 1.0, np.random.default_rng(1))
    for lag in (1, 2, 3, 16, 1024, 4096):
        assert abs(np.vdot(noise[:-lag], noise[lag:])) < 5 * np.sqrt(len(noise))
    spectrum = np.abs(np.fft.fft(noise)) ** 2 / len(noise)
    assert spectrum.max() < np.log(len(noise)) + 12
    assert stats.kstest(spectrum, "expon").pvalue > 1e-3


def test_noise_depends_on_the_generator_only():
    first, again = (white_noise((7, 300), 1.0, np.random.default_rng(5)) for _ in range(2))
    other = white_noise((7, 300), 1.0, np.random.default_rng(6))
    assert np.array_equal(first, again)
    assert abs(np.corrcoef(first.real.ravel(), other.real.ravel())[0, 1]) < 0.1
    generator = np.random.default_rng(5)
    bursts = [white_noise((4096,), 1.0, generator) for _ in range(2)]
    assert abs(np.vdot(*bursts)) < 5 * np.sqrt(4096)
