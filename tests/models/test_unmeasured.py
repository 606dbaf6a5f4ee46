"""What a link cannot observe tells a filter nothing, and costs no hypothesis anything."""

import numpy as np

from dopslam.models import unmeasured

WIDTHS = np.array([2e-6, 2 * np.pi, np.pi, 2 * np.pi, np.pi, 50.0])


def test_infinite_variances_become_wide_and_uncorrelated():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(5, 6, 6))
    covariance = root @ root.swapaxes(1, 2)
    whole, missing = unmeasured.filled(covariance, WIDTHS)
    np.testing.assert_array_equal(whole, covariance)
    assert not missing.any()
    blind = covariance.copy()
    blind[:, 4, :] = blind[:, :, 4] = 0
    blind[:, 4, 4] = np.inf
    found, missing = unmeasured.filled(blind, WIDTHS)
    assert missing.tolist() == [False] * 4 + [True, False]
    kept = [0, 1, 2, 3, 5]
    np.testing.assert_array_equal(found[:, kept][:, :, kept], covariance[:, kept][:, :, kept])
    np.testing.assert_allclose(np.sqrt(found[:, 4, 4]), 100 * np.pi / np.sqrt(2 * np.pi))
    assert np.all(np.linalg.eigvalsh(found) > 0)


def test_no_hypothesis_gains_by_what_nobody_saw():
    """The density of a wide Gaussian at its middle is one over the width that false paths are given."""
    peak = 1 / np.sqrt(2 * np.pi) / unmeasured.deviation(WIDTHS)
    one = np.arange(6) == 4
    width = unmeasured.volume(WIDTHS, one) / unmeasured.volume(WIDTHS, np.zeros(6, bool)) * WIDTHS[4]
    assert np.isclose(peak[4] * width, 1.0)
