"""NIS of a run: by hand, on matched data near 1, and away from 1 where the filter is told a wrong R."""

from dataclasses import replace

import numpy as np

from dopslam.filters import FILTERS
from dopslam.pipeline import problem as build
from dopslam.simulate.world import section_v, simulate
from dopslam.slam.filter import run
from dopslam.slam.history import Diagnostics


def test_by_hand_steps_without_rows_or_figures_are_left_out():
    nothing = ((), (), ())
    told = Diagnostics(np.array([6.0, np.nan, 3.0, 9.0]), np.array([6, 6, 0, 3]), *nothing)
    assert told.nis_per_row == 15 / 9
    assert np.isnan(Diagnostics.none(4).nis_per_row)


def test_matched_data_are_near_one_and_a_wrong_r_is_not():
    world = section_v(steps=20)
    problem = build.told(world)
    found = {}
    for factor in (1.0, 0.25):
        ratios = []
        for number in range(4):
            _, scans = simulate(world, 11, number)
            ratios.append(
                run(problem, replace(scans, covariance=factor * scans.covariance), FILTERS["joint"]())[1].nis_per_row
            )
        found[factor] = np.mean(ratios)
    assert 0.8 < found[1.0] < 1.2
    assert found[0.25] > 1.3
