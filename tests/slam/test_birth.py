"""Births: closed form, Laplace's integral, covariances of newborns, the VA/SP ratio, thinning."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.models.measurement import SP, VA, jacobians, measure, residual
from dopslam.models.paths import incidence
from dopslam.models.pose import positions
from dopslam.simulate.world import nominal_track
from dopslam.slam.pmb.birth import fit_landmark, fitting, starting_point, undetected_intensity, visible_share
from dopslam.slam.pmb.density import FilterParameters, Scan, compile_model, initial_density
from dopslam.slam.pmb.newborn import give_birth

STD = np.array([0.1, 0.05, 0.05, 0.05, 0.05, 0.1])


def fit(z, noise, state, covariance, kind, site, start):
    x, gain, own = start.copy(), np.empty((3, len(z))), np.empty((3, 3))
    valid, chi2, log_volume = fit_landmark(
        z, noise, state, covariance, kind, site, False, -np.inf, x, gain, own, fitting(len(z), 4)
    )
    return valid, chi2, log_volume, x, gain, own


@pytest.mark.parametrize("kind", [VA, SP])
def test_exact_measurements_give_the_landmark_back(world, kind):
    site = (*world.bs, 0.0, world.motion.speed)
    for state in nominal_track(world)[::7]:
        for x in world.landmarks(kind):
            z = measure(state, x, kind, world.bs, speed=world.motion.speed)
            start = np.empty(3)
            assert starting_point(z, state, kind, site, start)
            np.testing.assert_allclose(start, x, atol=1e-6)
            valid, chi2, _, found, _, _ = fit(
                z, np.diag(STD**2), state, 1e-4 * np.eye(4), kind, site, start + np.array([2, -1, 1])
            )
            assert valid and chi2 < 0.02
            np.testing.assert_allclose(found, x, atol=0.5)


def test_a_path_shorter_than_the_direct_one_is_no_landmark(world):
    state = nominal_track(world)[0]
    z = measure(state, world.bs, 0, world.bs, speed=1.0)
    z[0] -= 1.0
    assert not starting_point(z, state, VA, (*world.bs, 0.0, 22.22), np.empty(3))


@pytest.mark.parametrize("kind", [VA, SP])
def test_laplace_integral_against_numbers(world, kind):
    """∫ N(z; h(x), R) dx by importance sampling, where the noise is small enough for Laplace to be exact."""
    rng = np.random.default_rng(6)
    state = nominal_track(world)[3]
    x = world.landmarks(kind)[1]
    noise = np.diag((STD * [1, 0.1, 0.1, 0.1, 0.1, 1]) ** 2)
    z = measure(state, x, kind, world.bs, speed=world.motion.speed) + rng.normal(size=6) * np.sqrt(np.diag(noise))
    site = (*world.bs, 0.0, world.motion.speed)
    valid, chi2, log_volume, mode, _, own = fit(z, noise, state, 1e-14 * np.eye(4), kind, site, x)
    assert valid
    root = np.linalg.cholesky(own) * 1.3
    unit = rng.normal(size=(200_000, 3))
    points = mode + unit @ root.T
    nu = residual(z, measure(state, points, kind, world.bs, speed=world.motion.speed))
    log_like = -0.5 * np.einsum("ni,ij,nj->n", nu, np.linalg.inv(noise), nu)
    log_proposal = -0.5 * (unit**2).sum(1) - np.log(np.diag(root)).sum() - 1.5 * np.log(2 * np.pi)
    numeric = np.exp(log_like - log_proposal).mean() / np.sqrt(np.linalg.det(2 * np.pi * noise))
    laplace = (2 * np.pi) ** ((3 - 6) / 2) * np.exp(log_volume - 0.5 * chi2)
    assert laplace == pytest.approx(numeric, rel=0.02)


def test_ratio_of_the_two_types_at_birth(world):
    """ρ_VA/ρ_SP = D²(1 + cos α)/‖x_SP - x_U‖² for equal intensities, whatever the measurement noise."""
    site = (*world.bs, 0.0, world.motion.speed)
    for state, va in zip(nominal_track(world)[[2, 15]], world.landmarks(VA)[:2], strict=True):
        ue = positions(state)
        sp, _ = incidence(ue, va, world.bs)
        z = measure(state, va, VA, world.bs, speed=world.motion.speed)
        noise = 1e-4 * np.diag(STD**2)
        volumes = [fit(z, noise, state, 1e-14 * np.eye(4), kind, site, x)[2] for kind, x in ((VA, va), (SP, sp))]
        q = (va - ue) / np.linalg.norm(va - ue)
        cos_alpha = q @ (sp - world.bs) / np.linalg.norm(sp - world.bs)
        expected = np.sum((va - ue) ** 2) * (1 + cos_alpha) / np.sum((sp - ue) ** 2)
        assert np.exp(volumes[0] - volumes[1]) == pytest.approx(expected, rel=1e-3)


def births(world, joint, real=(1.0, 1.0), shift=0.0):
    """Two births of one scan beside an older landmark: density before, measurements, and after. Errors are small, so
    that the model is linear; `shift` displaces the Dopplers.
    """
    rng = np.random.default_rng(8)
    state = nominal_track(world)[2]
    root = rng.normal(size=(7, 7)) * 0.005
    old = root @ root.T + 1e-8 * np.eye(7)
    mean, covariance = np.zeros(13), np.zeros((13, 13))
    mean[:4], mean[4:7], covariance[:7, :7] = state, world.landmarks(VA)[0], old
    truth = world.landmarks(VA)[1:3]
    z = measure(state, truth, VA, world.bs, speed=world.motion.speed)
    z[:, 5] += shift
    noise = np.diag((STD / 20) ** 2)
    scan = Scan(z, np.array([noise, noise]), np.zeros(2), 10, 1e-6, 1.0)
    model = compile_model(FilterParameters(joint=joint), world.motion, world.bs)
    before = mean.copy()
    pair = np.array([0, 1]), np.array([VA, VA]), np.array([-1, -1])
    give_birth(mean, covariance, 4, 7, scan, *pair, truth.copy(), np.array(real), model)
    return before, old, z, noise, mean, covariance


def test_newborns_inform_the_receiver_as_the_joint_posterior_has_it(world):
    """UE, older landmark and two newborns against least squares with no prior information on the newborns."""
    before, old, z, noise, mean, covariance = births(world, True, shift=0.004)
    start = before.copy()
    start[7:] = world.landmarks(VA)[1:3].ravel()
    x = start.copy()
    for _ in range(5):
        a, b = jacobians(x[:4], x[7:].reshape(2, 3), VA, world.bs, speed=world.motion.speed)
        nu = residual(z, measure(x[:4], x[7:].reshape(2, 3), VA, world.bs, speed=world.motion.speed))
        information, vector = np.zeros((13, 13)), np.zeros(13)
        information[:7, :7] = np.linalg.inv(old)
        vector[:7] = information[:7, :7] @ (start - x)[:7]
        for i in range(2):
            rows = np.zeros((6, 13))
            rows[:, :4], rows[:, 7 + 3 * i : 10 + 3 * i] = a[i], b[i]
            information += rows.T @ np.linalg.solve(noise, rows)
            vector += rows.T @ np.linalg.solve(noise, nu[i])
        x = x + np.linalg.solve(information, vector)
    moved = np.abs(x - start)[:7].max()
    assert moved > 1e-5
    np.testing.assert_allclose(mean, x, rtol=0, atol=0.02 * moved + 1e-3)
    np.testing.assert_allclose(mean[:7], x[:7], rtol=0, atol=0.02 * moved)
    expected = np.linalg.inv(information)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(covariance / scale, expected / scale, atol=2e-3)
    assert covariance[3, 3] < old[3, 3] and np.linalg.eigvalsh(covariance).min() > 0


@pytest.mark.parametrize(("joint", "real"), [(False, (1.0, 1.0)), (True, (0.4, 0.4))])
def test_the_receiver_stays_at_doubtful_births_and_in_the_papers_filter(world, joint, real):
    """Errors -G(A e_s + ε) of the newborns, with the UE and an older landmark, term by term."""
    before, old, _, noise, mean, covariance = births(world, joint, real)
    np.testing.assert_array_equal(mean[:7], before[:7])
    a, b = jacobians(mean[:4], mean[7:].reshape(2, 3), VA, world.bs, speed=world.motion.speed)
    pulls, gains = [], []
    for i in range(2):
        tilde = noise + a[i] @ old[:4, :4] @ a[i].T
        gain = np.linalg.solve(b[i].T @ np.linalg.solve(tilde, b[i]), b[i].T @ np.linalg.inv(tilde))
        pulls.append(-gain @ a[i])
        gains.append(gain)
    lift = np.vstack([np.eye(7), *[np.hstack([p, np.zeros((3, 3))]) for p in pulls]])
    expected = lift @ old @ lift.T
    for i in range(2):
        rows = slice(7 + 3 * i, 10 + 3 * i)
        expected[rows, rows] += gains[i] @ noise @ gains[i].T
    np.testing.assert_allclose(covariance, expected, rtol=2e-3, atol=1e-6)
    assert np.linalg.eigvalsh(covariance).min() > 0


def test_a_measurement_that_may_be_clutter_informs_less(world):
    """Moments of the mixture: the shift in proportion, the variance between those of the two cases."""
    sure, half = births(world, True, (1.0, 1.0), 0.004), births(world, True, (0.7, 1e-6), 0.004)
    one = births(world, True, (1.0, 1e-6), 0.004)
    np.testing.assert_allclose(half[4][:7] - half[0][:7], 0.7 * (one[4][:7] - one[0][:7]), rtol=1e-6, atol=1e-12)
    assert np.all(np.diag(one[5])[:7] <= np.diag(half[5])[:7] + 1e-15)
    assert np.all(np.diag(sure[5])[:4] < np.diag(sure[1])[:4])


def test_visible_share_is_soft(world):
    model = compile_model(FilterParameters(), world.motion, world.bs)
    state = world.prior_mean
    at_rim = np.array([state[0] + 50.0, state[1], 0.0])
    assert visible_share(at_rim, np.eye(3), state, SP, model) == pytest.approx(0.5)
    assert visible_share(at_rim, np.eye(3), state, VA, model) == 1.0
    assert visible_share(at_rim - [2, 0, 0], np.eye(3), state, SP, model) == pytest.approx(0.97725, abs=1e-4)


def test_thinning_remembers_where_the_receiver_was(world):
    base = FilterParameters(thinning=True, birth_intensity=(1e-10, 1e-10))
    density = initial_density(world.prior_mean, world.prior_covariance)
    density = density._replace(trail=np.array([[70.0, 0.0], [0.0, 0.0], [-70.0, 0.0]]))
    near_first = np.array([90.0, 0.0, 10.0])
    model = compile_model(base, world.motion, world.bs)
    va = undetected_intensity(near_first, 1e-6 * np.eye(3), VA, 0.0, density, model)
    assert va == pytest.approx(1e-7 * 1e-3 + 1e-10 * (1 + 0.1 + 0.01 + 0.001), rel=1e-6)
    sp = undetected_intensity(near_first, 1e-6 * np.eye(3), SP, 0.0, density, model)
    assert sp == pytest.approx(4e-6 * 0.1 + 1e-10 * (1 + 1 + 1 + 0.1), rel=1e-6)
    constant = compile_model(replace(base, thinning=False), world.motion, world.bs)
    assert undetected_intensity(near_first, np.eye(3), SP, 0.0, density, constant) == pytest.approx(4e-6 + 1e-10)
