"""The fit with the true association: right where the model is right, and it says where covariances are too small."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.evaluate.run import true_association
from dopslam.models.measurement import measure
from dopslam.simulate.world import section_v, simulate
from dopslam.slam.pmb.filters import Joint
from dopslam.studies.known import fit
from dopslam.studies.montecarlo import Study


@pytest.mark.parametrize("share", [1.0, 0.8])
def test_the_cost_says_how_right_the_covariances_are(share):
    world, fits = section_v(), []
    problem = Study(world, Joint()).told
    count = len(world.kind)
    for run in range(4):
        states, scans = simulate(world, 3, run)
        exact = measure(
            states[:, None], world.position, world.kind, world.bs, height=world.height, speed=world.motion.speed
        ).reshape(-1, 6)
        ends = count * np.arange(len(states) + 1)
        label = true_association(scans, exact, ends, np.tile(np.arange(count), len(states)))
        told = replace(scans, covariance=share * scans.covariance)
        fits.append(fit(problem, told, states, world.kind, world.position, label))
    freedom = sum(f.freedom for f in fits)
    # Motion and prior, whose covariances are right, count for little beside the detections.
    assert sum(f.cost for f in fits) / freedom == pytest.approx(1 / share, abs=4 * np.sqrt(2 / freedom) / share + 0.03)
    rows = sum(f.rows.sum() for f in fits)
    assert sum(f.square.sum() for f in fits) / rows == pytest.approx(1 / share, abs=4 * np.sqrt(2 / rows) / share)
    assert 2.0 < np.mean([f.nees for f in fits]) < 7.0
