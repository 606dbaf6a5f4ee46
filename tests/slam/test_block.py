"""A lap round a block: objects out of sight are remembered, and found again as themselves."""

import numpy as np
import pytest

from dopslam.evaluate.metrics import nees, state_errors
from dopslam.filters import FILTERS
from dopslam.pipeline.problem import told
from dopslam.records import Kind
from dopslam.simulate.block import CORNER, SIDE, block, lap
from dopslam.simulate.world import draw_scans
from dopslam.slam.filter import run


def test_a_lap_closes_and_runs_along_its_heading():
    round_trip = 4 * SIDE + 2 * np.pi * CORNER
    way = lap(np.linspace(0, round_trip, 2001))
    assert np.allclose(way[0, :2], way[-1, :2], atol=1e-9)
    step = np.diff(way[:, :2], axis=0)
    middle = lap(0.5 * (np.linspace(0, round_trip, 2001)[1:] + np.linspace(0, round_trip, 2001)[:-1]))[:, 2]
    along = step[:, 0] * np.cos(middle) + step[:, 1] * np.sin(middle)
    assert np.allclose(along, np.hypot(*step.T), rtol=1e-3)


@pytest.mark.mc
def test_after_two_laps_the_map_is_whole_and_single():
    rng = np.random.default_rng(1000)
    world, states = block(800, 60, rng)
    scans = draw_scans(world, states, rng, rng)
    history, _ = run(told(world), scans, FILTERS["joint"]())
    seen = np.unique(scans.label[scans.label >= 0])
    for kind in (Kind.VA, Kind.SP):
        true = world.position[seen[world.kind[seen] == kind]]
        mapped = history.reported(799, kind, 0.5)
        assert len(mapped) == len(true)
        assert np.linalg.norm(true[:, None] - mapped[None], axis=-1).min(axis=1).max() < 1.0
    error = state_errors(history.mean, states)
    assert 2.5 < nees(error[:, :4], history.covariance[:, :4, :4]).mean() < 6.0
