"""What the EK-PMB refuses before compiled code sees it, and states that are known exactly."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.errors import FilterError
from dopslam.simulate.world import simulate
from dopslam.slam.pmb import ek_pmb, smoother


@pytest.mark.parametrize(("column", "value"), [(0, 1e300), (2, 1e9), (5, -1e12)])
def test_numbers_that_would_overflow_are_refused(world, prior, column, value):
    _, scans = simulate(world, 0, 0)
    z = scans.z.copy()
    z[7, column] = value
    with pytest.raises(FilterError, match=f"row 7, component {column}"):
        ek_pmb.run(replace(scans, z=z), prior, world.motion, world.bs)


@pytest.mark.parametrize("run", [ek_pmb.run, smoother.run])
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_a_prior_that_is_no_number_is_refused(world, prior, run, value):
    _, scans = simulate(world, 0, 0)
    mean, covariance = prior[0].copy(), prior[1].copy()
    mean[1] = value
    with pytest.raises(FilterError, match="prior mean"):
        run(scans, (mean, prior[1]), world.motion, world.bs)
    covariance[2, 2] = value
    with pytest.raises(FilterError, match="prior covariance"):
        run(scans, (prior[0], covariance), world.motion, world.bs)


def test_a_scan_of_too_many_measurements_is_refused_with_the_limit(world):
    _, scans = simulate(world, 0, 0)
    many = np.zeros(5000, int)
    with pytest.raises(FilterError, match="step 0 holds 5000 measurements, at most 2000"):
        replace(
            scans, z=scans.z[many], covariance=scans.covariance[many], offsets=np.array([0, 5000]),
            snr=None, interval=None, anchor=many, label=None,
        )  # fmt: skip


def test_a_clock_known_exactly(world, prior):
    _, scans = simulate(world, 0, 0)
    exact = np.diag([1.0, 1.0, 1.0, 0.0])
    motion = replace(world.motion, process_noise=exact @ world.motion.process_noise)
    history, _ = smoother.run(scans, (prior[0], exact @ prior[1]), motion, world.bs)
    assert np.isfinite(history.mean).all()
    assert np.allclose(history.mean[:, 3], prior[0][3], atol=1e-3)
