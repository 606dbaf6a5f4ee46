"""Lines of elements: what they cannot tell is said, and false alarms stay what was asked for."""

import numpy as np
import pytest

from estimation import (
    Array,
    CosinePattern,
    EadfArray,
    Flag,
    ModelError,
    Nomp,
    PathTable,
    SignalModel,
    View,
    comb,
    crb,
    digital,
    synthesize,
    ula,
    ura,
)
from estimation.estimators.detect import threshold_for
from estimation.estimators.grids import EVERYWHERE
from estimation.fisher import path_covariances
from estimation.scenarios import at_snr

LINES = {
    "line": ula(8),
    "measured line": EadfArray.from_array(ula(8), 24),
    "along x": Array(np.c_[0.5 * np.arange(8) - 1.75, np.zeros((8, 2))]),
    "mast": ura(8, 1),
}


def estimated(receiver, azimuth, elevation, view=EVERYWHERE, seed=0):
    model = SignalModel(comb(28e9, 6.25e6, 64), digital(4, 125e-6), ura(2, 4, pattern=CosinePattern()), receiver)
    path = PathTable([8e-8], [[azimuth, elevation]], [[0.2, 0.1]], [5.0], [1.0])
    path = at_snr(model, path, [1e3])
    estimator = Nomp(model, arrival_view=view, calibration=4)
    return model, estimator, path, estimator.run(synthesize(model, path, 1.0, np.random.default_rng(seed)))


def nees(model, found, path) -> float:
    """Of the parameters that the link observes, over their number."""
    active = model.active
    error = (found.vector[0] - path.vector[0])[active]
    error[1] = (error[1] + np.pi) % (2 * np.pi) - np.pi if active[1] else error[1]
    return error @ np.linalg.solve(found.covariance[0][np.ix_(active, active)], error) / active.sum()


@pytest.mark.parametrize("name", LINES)
@pytest.mark.parametrize("elevation", [0.0, 0.35])
def test_a_path_off_the_horizon_stays_within_what_is_said(name, elevation):
    model, _, path, found = estimated(LINES[name], 0.6, elevation)
    assert len(found) == 1 and found.flags[0] & Flag.AMBIGUOUS
    blind = 1 if name == "mast" else 2
    assert np.isinf(found.covariance[0, blind, blind])
    assert nees(model, found, path) < 2.5


def test_a_path_behind_a_line_is_reported_in_front_or_where_the_view_is():
    *_, found = estimated(ula(8), np.pi - 0.6, 0.0)
    assert found.aoa[0, 0] == pytest.approx(0.6, abs=0.05) and found.flags[0] & Flag.AMBIGUOUS
    *_, found = estimated(ula(8), np.pi - 0.6, 0.0, View((np.pi / 2, 3 * np.pi / 2)))
    assert found.aoa[0, 0] == pytest.approx(np.pi - 0.6, abs=0.05)
    # A line along x tells front from back, but not left from right.
    *_, found = estimated(LINES["along x"], -(np.pi - 0.6), 0.0)
    assert found.aoa[0, 0] == pytest.approx(np.pi - 0.6, abs=0.05)


def test_a_planar_array_says_when_its_back_is_in_the_view():
    *_, found = estimated(ura(2, 4), 0.4, 0.2)
    assert found.flags[0] & Flag.AMBIGUOUS
    *_, found = estimated(ura(2, 4), 0.4, 0.2, View((-1.2, 1.2)))
    assert not found.flags[0] & Flag.AMBIGUOUS


@pytest.mark.parametrize("name", ["line", "measured line"])
def test_a_line_measured_or_not_has_the_same_threshold_and_no_ghosts(name):
    _, estimator, _, _ = estimated(LINES[name], 0.1, 0.0)
    assert 18 < estimator.threshold < 24
    assert np.sum(estimator.suprema(20, seed=3) > estimator.threshold) <= 2


def test_a_region_too_small_for_the_law_of_maxima_is_refused():
    with pytest.raises(ModelError, match="too few cells"):
        threshold_for(0.01, 1e-6, 4)
    assert threshold_for(0.01, 1.0, 0) == pytest.approx(-np.log(0.01))


def test_what_a_path_tells_nothing_of_has_infinite_variance():
    information = np.diag(np.r_[np.ones(6), np.ones(6)])
    information[7, 7] = 0.0
    first, second = path_covariances(information, np.ones(6, bool))
    assert np.isfinite(first).all() and np.isinf(second[1, 1])
    rest = np.arange(6) != 1
    assert np.isfinite(second[rest][:, rest]).all()
    model = SignalModel(comb(28e9, 6.25e6, 16), digital(4, 125e-6), ura(2, 2, pattern=CosinePattern()), ura(2, 2))
    behind = PathTable([8e-8], [[0.1, 0.0]], [[np.pi, 0.0]], [5.0], [1.0])
    assert np.isinf(np.diag(crb(model, behind, 1.0)[0])).all()
