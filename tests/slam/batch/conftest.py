"""Paper A's Section V as the whole-run smoother reads it, with a track that is known a little."""

from dataclasses import dataclass

import numpy as np
import pytest

from dopslam.models.scans import Scans
from dopslam.simulate.world import Situation, section_v, simulate
from dopslam.slam.batch.rows import Rows, rows_of
from dopslam.slam.batch.track import Chain

STD = np.array([0.3, 0.3, 0.004, 0.3])


@dataclass(frozen=True)
class Case:
    """A simulated run and a start for the smoother: (K + 1, n) states and covariances."""

    world: Situation
    truth: np.ndarray
    scans: Scans
    data: Rows
    chain: Chain
    state: np.ndarray
    covariance: np.ndarray


def case(seed, steps=16, doppler_std=0.1):
    world = section_v(doppler_std, steps=steps)
    truth, scans = simulate(world, seed, 0)
    rng = np.random.default_rng(seed)
    mean = world.prior_mean
    start = np.vstack([mean, truth + rng.standard_normal(truth.shape) * STD])
    covariance = np.tile(np.diag(STD**2), (steps + 1, 1, 1))
    data = rows_of(scans, world.bs, world.height, world.motion.speed)
    chain = Chain(world.motion, mean, np.linalg.inv(world.prior_covariance), np.ones(data.steps))
    return Case(world, truth, scans, data, chain, start, covariance)


@pytest.fixture(scope="session")
def drive():
    return case(3)
