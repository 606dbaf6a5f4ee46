"""Small worlds and textbook filters for the SLAM tests."""

import numpy as np
import pytest

from dopslam.simulate.world import section_v


@pytest.fixture(scope="session")
def world():
    """Paper A, Section V."""
    return section_v(0.1)


@pytest.fixture(scope="session")
def prior(world):
    """Mean and covariance of the UE before the first step."""
    return world.prior_mean, np.asarray(world.prior_covariance)
