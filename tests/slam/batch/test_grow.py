"""Growing from the surest window: a chain of snapshots that is astray over half of the run is made good."""

import numpy as np

from dopslam.slam.batch.grow import grow
from dopslam.slam.batch.rows import part
from dopslam.slam.batch.smoother import Choices
from dopslam.slam.batch.track import Chain

from .conftest import STD, case


def test_a_part_is_the_run_of_its_scans(drive):
    some = part(drive.data, 3, 7)
    assert some.steps == 4
    rows = slice(drive.data.offsets[3], drive.data.offsets[7])
    np.testing.assert_array_equal(some.z, drive.data.z[rows])
    np.testing.assert_array_equal(some.step, drive.data.step[rows] - 3)


def test_a_track_grows_over_what_the_snapshots_lost():
    drive = case(7, steps=20)
    state = drive.state.copy()
    state[11:] += np.array([60.0, -80.0, 2.0, 40.0])  # confidently wrong
    chain = Chain(drive.chain.motion, state[0], np.zeros((4, 4)), drive.chain.pace)
    rng = np.random.default_rng(0)

    def locate(step, mean, covariance):
        """Modes of a scan: far off, and near."""
        near = drive.truth[step] + rng.standard_normal(4) * STD
        return np.array([near + np.array([30.0, 30.0, 1.0, 10.0]), near]), np.tile(np.diag(STD**2), (2, 1, 1))

    grown = grow(drive.data, chain, state, drive.covariance, Choices(), locate)
    error = np.linalg.norm(grown.estimate.state[1:, :2] - drive.truth[:, :2], axis=1)
    assert error.max() < 3.0
    assert len(grown.owner) == len(drive.data.z)
