"""Stacked particles: the three likelihood backends agree, with the exact densities, and the filter works."""

import os
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from dopslam.slam.belief import geometry, motion
from dopslam.slam.belief.births import birth, order_for
from dopslam.slam.belief.experiment import Experiment, draw
from dopslam.slam.belief.records import PAPER, Form
from dopslam.slam.belief.rows import kernel_agent
from dopslam.slam.belief.stacked import clouds
from dopslam.slam.belief.stacked.backends import backend
from dopslam.slam.belief.stacked.likelihood import Constants
from dopslam.slam.belief.stacked.stacked import Stacked
from dopslam.studies.bp_run import evaluate, run
from dopslam.studies.bp_study import motion_of, start_box
from dopslam.studies.bp_timing import crowded_step

FORMS = [Form.LOS, Form.VA, Form.PS, Form.VA_AOD]


def particles(form, size, rng, experiment, position):
    q = {Form.LOS: experiment.anchor, Form.VA: experiment.features[0], Form.PS: experiment.features[2]}.get(
        form, experiment.features[1]
    )
    spread = 0.0 if form == Form.LOS else 0.05
    x, y = (np.float32(q[a] + spread * rng.standard_normal((3, size))) for a in range(2))
    u = np.float32((41.0 if form == Form.LOS else 12.0) + rng.standard_normal((3, size)))
    kappa = 0.01 * rng.standard_normal(size)
    agent = np.stack(
        [
            position[0] + 0.01 * rng.standard_normal(size), position[1] + 0.01 * rng.standard_normal(size),
            np.cos(kappa), np.sin(kappa),
        ]
    ).astype(np.float32)  # fmt: skip
    return x, y, u, agent, kappa


@pytest.fixture(scope="module")
def scene():
    experiment = Experiment(steps=1)
    truth, scans, _ = draw(experiment, np.random.default_rng(0))
    return experiment, truth, scans[0], Constants.of(experiment.radio, experiment.detector, experiment.anchor)


@pytest.mark.parametrize("form", FORMS)
def test_numpy_densities_are_the_papers(scene, form):
    """One particle at a time: Gaussian distance, von Mises angles at the Fisher variances, Rician amplitude."""
    experiment, truth, scan, constants = scene
    x, y, u, agent, kappa = particles(form, 5, np.random.default_rng(1), experiment, truth.position[0])
    for i in range(5):
        got = backend("numpy").evidence(
            form, x[:1, i : i + 1], y[:1, i : i + 1], u[:1, i : i + 1], agent[:, i : i + 1], scan, constants
        )[0]
        p = np.array([agent[0, i], agent[1, i], 0.0], float)
        q = np.array([x[0, i], y[0, i], 0.0], float)
        length, e, t = geometry.predict(form, p, q, experiment.anchor)
        sigma = experiment.radio.unit_deviations / u[0, i]
        expected = norm.pdf(scan.distance, length, sigma[0])
        world = geometry.turned(scan.aoa, np.full(len(scan), kappa[i]))
        expected = expected * norm.pdf(np.linalg.norm(world - e, axis=1), 0, sigma[1])
        expected *= 1 / (2 * np.pi) if form == Form.VA else norm.pdf(np.linalg.norm(scan.aod - t, axis=1), 0, sigma[2])
        expected *= np.exp(experiment.detector.log_rice(scan.amplitude, float(u[0, i])))
        np.testing.assert_allclose(got, expected, rtol=0.02, atol=1e-25)


@pytest.mark.parametrize("form", FORMS)
def test_numba_is_numpy(scene, form):
    experiment, truth, scan, constants = scene
    rng = np.random.default_rng(2)
    x, y, u, agent, _ = particles(form, 1000, rng, experiment, truth.position[0])
    nu = rng.random((3, len(scan)))
    a, b = backend("numpy"), backend("numba")
    expected = a.evidence(form, x, y, u, agent, scan, constants)
    got = b.evidence(form, x, y, u, agent, scan, constants)
    np.testing.assert_allclose(got, expected, rtol=1e-4, atol=1e-6 * expected.max())
    expected = a.messages(form, x, y, u, agent, scan, nu, constants)
    np.testing.assert_allclose(b.messages(form, x, y, u, agent, scan, nu, constants), expected, rtol=1e-3)


@pytest.mark.rt
@pytest.mark.parametrize("size", [1000, 1024])
def test_drjit_is_numpy_and_repeats_exactly(scene, size):
    experiment, truth, scan, constants = scene
    for form in FORMS:
        rng = np.random.default_rng(3)
        x, y, u, agent, _ = particles(form, size, rng, experiment, truth.position[0])
        nu = rng.random((3, len(scan)))
        a, b = backend("numpy"), backend("drjit")
        expected = a.evidence(form, x, y, u, agent, scan, constants)
        got = b.evidence(form, x, y, u, agent, scan, constants)
        np.testing.assert_allclose(got, expected, rtol=2e-3, atol=1e-4 * expected.max())
        np.testing.assert_array_equal(b.evidence(form, x, y, u, agent, scan, constants), got)
        expected = a.messages(form, x, y, u, agent, scan, nu, constants)
        np.testing.assert_allclose(b.messages(form, x, y, u, agent, scan, nu, constants), expected, rtol=5e-3)


def test_resampling_keeps_the_weighted_mean():
    rng = np.random.default_rng(4)
    rows = rng.standard_normal((2, 3, 4, 20_000)).astype(np.float32)
    lam = rng.random((2, 4, 20_000)).astype(np.float32)
    keep = np.array([0, 3])
    out = np.full((2, 3, 3, 20_000), np.nan, np.float32)
    clouds.resample_rows(rng, rows, lam, keep, out)
    assert np.isnan(out[:, :, 2]).all() and np.isfinite(out[:, :, :2]).all()
    out = out[:, :, :2]
    expected = (rows * lam[:, None]).sum(axis=3) / lam.sum(axis=2)[:, None]
    np.testing.assert_allclose(out.mean(axis=3), expected[:, :, keep], atol=2e-2)
    neighbors = (out[0, 0, 0, 1:] == out[0, 0, 0, :-1]).mean()
    assert neighbors < 0.01  # copies of one ancestor are not left side by side


@pytest.mark.parametrize("form", [Form.VA, Form.PS, Form.VA_AOD])
def test_birth_particles_have_the_moments_of_the_gaussian_birth(scene, form):
    experiment, truth, scan, _ = scene
    rng, size = np.random.default_rng(5), 100_000
    place = truth.position[0] + 0.02 * rng.standard_normal((size, 3)) * [1, 1, 0]
    agent = motion.particles(place, np.tile([0.65, 0.0, 0.0], (size, 1)), 0.0, 0.01 * rng.standard_normal(size))
    parameters = replace(experiment.parameters, types=(form,))
    m = int(np.flatnonzero(draw(experiment, np.random.default_rng(0))[2][0] == (3 if form == Form.PS else 1))[0])
    out = np.empty((1, 3, 1, size), np.float32)
    clouds.sample_births(rng, parameters, agent, scan, np.array([m]), out)
    order = order_for(1, form)
    covariance = np.ascontiguousarray(scan.covariance[m][order][:, order])
    few = kernel_agent(agent[:2000])
    _, mean, spread = birth(
        int(form), 1, few, np.full(2000, 1 / 2000), experiment.anchor, scan.distance[m], scan.aoa[m], scan.aod[m],
        covariance, np.linalg.inv(np.linalg.cholesky(covariance)), order,
    )  # fmt: skip
    deviation = np.sqrt(np.diag(spread)[:2])
    assert (np.abs(out[0, :2, 0].mean(axis=1) - mean[:2]) < 0.25 * deviation).all()
    np.testing.assert_allclose(out[0, :2, 0].std(axis=1), deviation, rtol=0.15)
    assert out[0, 2, 0].mean() == pytest.approx(scan.amplitude[m], rel=0.01)


def test_threads_do_not_change_the_result(monkeypatch):
    filter_, state, scan = crowded_step(clouds._SMALL, 3, 6, "numba")
    results = []
    for cores in ({0}, {0, 1, 2}):
        monkeypatch.setattr(os, "sched_getaffinity", lambda _, cores=cores: cores)
        results.append(filter_.step(np.random.default_rng(0), state, scan)[0])
    np.testing.assert_array_equal(results[0].particles, results[1].particles)
    np.testing.assert_array_equal(results[0].agent, results[1].agent)


@pytest.mark.mc
def test_stacked_filter_finds_the_map():
    """One run with 10,000 particles (about 6 s)."""
    experiment = Experiment()
    truth, scans, _ = draw(experiment, np.random.default_rng([2, 0]))
    parameters = replace(experiment.parameters, types=PAPER)
    filter_ = Stacked(parameters, motion_of(experiment), experiment.radio, backend("numba"))
    history = run(filter_, np.random.default_rng([2, 1]), scans, start_box(experiment), 10_000)
    score = evaluate(experiment, truth, history, PAPER)
    assert score.found == 3 and score.false == 0 and not score.ghost
    assert score.true_type.min() > 0.9
    assert score.position_rmse < 0.03
