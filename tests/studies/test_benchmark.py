"""The report of growth: exponents as they are defined, a table for landmarks, detections and clutter."""

import numpy as np

from dopslam.studies import benchmark


def test_exponents_are_those_of_powers():
    sizes = np.array([10.0, 20, 40, 200])
    np.testing.assert_allclose(benchmark.exponents(sizes, 3 * sizes**2.5), 2.5)
    np.testing.assert_allclose(benchmark.exponents([1, 2, 4], [1, 1, 8]), [0, 3], atol=1e-12)


def test_growth_is_reported_over_landmarks_detections_and_clutter():
    found = benchmark.growth(1, landmarks=(4, 8), detections=(4, 8), clutter=(4, 8), steps=3)
    for name in ("landmarks", "detections", "clutter"):
        table = found[name]
        assert len(table["us_per_step"]) == len(table["sizes"]) == len(table["exponents"]) + 1
        assert min(table["us_per_step"]) > 0 and np.isfinite(table["exponents"]).all()
