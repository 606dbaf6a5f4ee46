"""The EK-PMB filter where no elevation is measured: landmarks stand where the plane has them, and are born there."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.filters import FILTERS
from dopslam.models import unmeasured
from dopslam.models.measurement import SP, VA, measure, wrap
from dopslam.simulate.hall import measured_hall
from dopslam.slam.filter import run
from dopslam.slam.pmb.birth import HELD, first_guess, fit_landmark, fitting
from dopslam.studies.hall import problem_of

SITE = (3.0, -2.0, 4.0, 1.5, 0.0)
STATE = np.array([11.0, 4.0, 0.4, 7.0])
UNSEEN = unmeasured.deviation(np.array([100, 2 * np.pi, np.pi, 2 * np.pi, np.pi, 4.0])) ** 2
STD = np.array([0.1, 0.02, 0, 0.02, 0, 0])
PLACE = {VA: np.array([-9.0, 20.0, 4.0]), SP: np.array([6.0, 9.0, 1.5])}


def noise(*rows):
    return np.diag(np.where(np.isin(np.arange(6), rows), STD**2, UNSEEN))


def seen(kind, *rows):
    exact = measure(STATE, PLACE[kind], kind, np.array(SITE[:3]), height=SITE[3])
    return np.where(np.isin(np.arange(6), rows), exact, 0.0)


def fitted(z, covariance, kind, start):
    x, gain, own = start.copy(), np.empty((3, 6)), np.empty((3, 3))
    told = fit_landmark(
        z, covariance, STATE, 1e-6 * np.eye(4), kind, SITE, True, -np.inf, x, gain, own, fitting(len(z), 4)
    )
    return *told, x, own


@pytest.mark.parametrize("kind", [VA, SP])
@pytest.mark.parametrize("rows", [(0, 1, 3), (0, 1), (0, 3)])
def test_a_landmark_is_found_from_azimuths_of_both_ends_or_one(kind, rows):
    z, covariance, start = seen(kind, *rows), noise(*rows), np.empty(3)
    assert first_guess(z, covariance, STATE, kind, SITE, start)
    valid, chi2, _, x, own = fitted(z, covariance, kind, start)
    assert valid and chi2 < 1e-2
    np.testing.assert_allclose(x, PLACE[kind], atol=1e-2)
    assert own[2, 2] == pytest.approx(HELD**2, rel=1e-3)


@pytest.mark.parametrize("kind", [VA, SP])
def test_the_integral_over_the_plane_against_a_grid(kind):
    """∫ N(z; h(x), R) dx dy at the height that is held, of the rows that are measured."""
    rows = [0, 1, 3]
    z, covariance, start = seen(kind, *rows), noise(*rows), np.empty(3)
    z[rows] += 0.4 * STD[rows]
    assert first_guess(z, covariance, STATE, kind, SITE, start)
    valid, chi2, log_volume, x, own = fitted(z, covariance, kind, start)
    assert valid
    width = np.linspace(-6, 6, 241)
    root = np.linalg.cholesky(own[:2, :2])
    plane = x[:2] + np.stack(np.meshgrid(width, width), axis=-1).reshape(-1, 2) @ root.T
    at = np.column_stack([plane, np.full(len(plane), PLACE[kind][2])])
    off = z - measure(STATE, at, kind, np.array(SITE[:3]), height=SITE[3])
    off[:, [1, 3]] = wrap(off[:, [1, 3]])
    density = np.exp(-0.5 * np.sum((off[:, rows] / STD[rows]) ** 2, axis=1)) / np.prod(np.sqrt(2 * np.pi) * STD[rows])
    exact = density.sum() * (width[1] - width[0]) ** 2 * np.linalg.det(root)
    missing = [2, 4, 5]
    laplace = np.exp(log_volume - 0.5 * chi2 - 1.5 * np.log(2 * np.pi)) / (np.sqrt(2 * np.pi) * HELD)
    laplace *= np.prod(
        np.sqrt(2 * np.pi * UNSEEN[missing])
    )  # what the rows that nobody saw cost every hypothesis alike
    assert laplace == pytest.approx(exact, rel=0.03)


def test_a_walk_through_a_hall_without_elevations_is_mapped():
    hall = measured_hall(12, 12)
    told = replace(
        problem_of(hall),
        mean=hall.track.state[0],
        covariance=np.diag([0.3, 0.3, 0.05, 0.3]) ** 2,
        snapshot=False,
        yaw_std=0,
    )
    history, told_of = run(told, hall.detections, FILTERS["joint"]())
    last = history.rows(history.steps - 1)
    sure = history.position[last][history.existence[last] > 0.5]
    assert len(sure) >= 5
    near = np.linalg.norm(sure[:, None, :2] - hall.landmarks.position[None, :, :2], axis=2).min(axis=1)
    assert np.median(near) < 3.0
    assert np.linalg.norm(history.mean[-1, :2] - hall.track.position[-1, :2]) < 3.0
    assert np.all(told_of.nis_rows % 3 == 0) and told_of.nis_rows.max() > 0
