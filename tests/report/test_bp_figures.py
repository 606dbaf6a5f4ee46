"""Figures of the synthetic experiment: what is drawn is what the tables hold."""

import numpy as np

from dopslam.report.figures import save_all
from dopslam.slam.belief.experiment import Experiment, draw
from dopslam.studies.bp_cases import Case, run_case
from dopslam.studies.bp_figures import association_errors, belief_map, errors_over_time, feature_names, type_beliefs
from dopslam.studies.bp_run import run
from dopslam.studies.bp_study import start_box, summary
from dopslam.studies.loopy import error_distribution


def test_figures_show_the_tables(tmp_path):
    case = Case(Experiment(steps=5), particles=50)
    table = summary(run_case(case, 1))
    names = feature_names(case.experiment)
    assert names == ["VA 1", "VA 2", "PS 1"]
    beliefs, errors = type_beliefs(names, {"paper": table}), errors_over_time({"paper": table})
    line = beliefs.axes[0].lines[2]
    np.testing.assert_array_equal(line.get_ydata(), np.array(table["per_step"]["type_belief_true"])[:, 2])
    above, below = errors.axes
    np.testing.assert_allclose(above.lines[0].get_ydata(), 1e3 * np.array(table["per_step"]["rmse_position"]))
    np.testing.assert_allclose(below.lines[1].get_ydata(), np.degrees(table["per_step"]["bound_heading"]))
    truth, scans, _ = draw(case.experiment, np.random.default_rng(0))
    history = run(case.filter, np.random.default_rng(1), scans, start_box(case.experiment), 50)
    loopy = error_distribution(5)
    shares = association_errors(loopy).axes[0].lines[0].get_ydata()
    assert shares[0] == 1 and np.all(np.diff(shares) < 0)
    drawn = {"a": beliefs, "b": errors, "c": belief_map(case.experiment, truth, history, case.types)}
    for path in save_all(tmp_path, drawn):
        assert path.stat().st_size > 1000
