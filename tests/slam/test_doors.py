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


def test_a_clock_known_exactly(world, prior):
    _, scans = simulate(world, 0, 0)
    exact = np.diag([1.0, 1.0, 1.0, 0.0])
    motion = replace(world.motion, process_noise=exact @ world.motion.process_noise)
    history, _ = smoother.run(scans, (prior[0], exact @ prior[1]), motion, world.bs)
    assert np.isfinite(history.mean).all()
    assert np.allclose(history.mean[:, 3], prior[0][3], atol=1e-3)
