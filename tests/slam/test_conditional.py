"""Belief propagation on the joint of agent and map: exact reductions, enumeration, and what the correlation is for."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import dblquad

from dopslam.models.amplitude import AmplitudeModel
from dopslam.slam.belief import belief as oracle
from dopslam.slam.belief.conditional import amplitude, births, particles, update
from dopslam.slam.belief.conditional.belief import Dynamics
from dopslam.slam.belief.conditional.filter import Conditional
from dopslam.slam.belief.conditional.linear import Measured, measured, observe
from dopslam.slam.belief.experiment import Experiment, draw
from dopslam.slam.belief.geometry import predict, turned
from dopslam.slam.belief.motion import ConstantVelocity, SpeedHeading
from dopslam.slam.belief.records import Form, Scan
from dopslam.slam.belief.start import Box, informed_start
from dopslam.studies.correlation import floating_map

ANCHOR = np.array([1.0, -2.0, 3.0])
POSE = np.array([6.0, -4.0, 1.5, 3.0, 0.5, 0.0, 0.7, 0.16])
FEATURE = np.array([2.0, 18.0, 4.0])


FLAT = np.array([1.0, 1, 0])


def ideal(form, pose, q, count=2, doppler=True, noise=0.02):
    """A scan with the exact measurement of one feature."""
    anchor = ANCHOR * (FLAT if count == 1 else 1)
    q = anchor if form == Form.LOS else q
    length, arrival, departure = predict(form, pose[:3], q, anchor)
    n = 1 + 2 * count + doppler
    return Scan(
        np.array([length + pose[6]]), turned(arrival, np.array(-pose[7]))[None], departure[None], np.array([20.0]),
        noise**2 * np.eye(n)[None], np.array([pose[3:6] @ arrival]) if doppler else None,
    )  # fmt: skip


def look(form, pose, q, rows, m=0, slopes=True):
    residual, by_pose, by_feature = np.zeros(8), np.zeros((8, 8)), np.zeros((8, 3))
    anchor = ANCHOR * (FLAT if rows.count == 1 else 1)
    used = observe(form, pose, *q, anchor, rows, m, residual, slopes, by_pose, by_feature)
    return residual[:used], by_pose[:used], by_feature[:used]


@pytest.mark.parametrize("form", list(Form))
@pytest.mark.parametrize("count", [1, 2])
def test_jacobians_are_derivatives(form, count):
    if count == 1:
        pose, q = POSE * [1, 1, 0, 1, 1, 0, 1, 1], FEATURE * [1, 1, 0]
    else:
        pose, q = POSE, FEATURE
    q = ANCHOR * ([1, 1, 0] if count == 1 else 1) if form == Form.LOS else q
    rows = measured(ideal(form, pose, q, count), True)
    residual, by_pose, by_feature = look(form, pose, q, rows)
    assert np.abs(residual[: 1 + 1 + count]).max() < 1e-11
    plane = [0, 1] if count == 1 else [0, 1, 2]
    for a in [*plane, *(3 + np.array(plane)), 6, 7]:
        step = 1e-5 * np.eye(8)[a]
        numeric = (look(form, pose - step, q, rows)[0] - look(form, pose + step, q, rows)[0]) / 2e-5
        np.testing.assert_allclose(by_pose[:, a], numeric, atol=1e-8)
    if form != Form.LOS:
        for a in plane:
            step = 1e-5 * np.eye(3)[a]
            numeric = (look(form, pose, q - step, rows)[0] - look(form, pose, q + step, rows)[0]) / 2e-5
            np.testing.assert_allclose(by_feature[:, a], numeric, atol=1e-8)


def joint_of(mean, covariance, center, gain, spread):
    """The same belief as one Gaussian: mean and covariance of (s, x)."""
    cross = gain @ covariance
    return np.concatenate([mean, center.ravel()]), np.block([[covariance, cross.T], [cross, spread + cross @ gain.T]])


def random_belief(rng, size=4, rows=3):
    root = rng.standard_normal((size, size)) * 0.1
    gain = rng.standard_normal((3 * rows, size)) * 0.5
    spread = rng.standard_normal((3 * rows, 3 * rows)) * 0.2
    spread, gain[:3] = spread @ spread.T, 0.0
    spread[:3], spread[:, :3] = 0.0, 0.0
    return rng.standard_normal(size), root @ root.T, rng.standard_normal((rows, 3)), gain, spread


def linear_case(rng):
    """A random belief over the line of sight and two features, and a scan of two measurements near the first."""
    mean, covariance, _, gain, spread = random_belief(rng)
    pose = POSE.copy()
    center = np.array([ANCHOR, FEATURE, FEATURE + np.array([3.0, -9, 1])])
    scan = ideal(Form.PS, pose, FEATURE, noise=0.3)
    other = ideal(Form.PS, pose, FEATURE + np.array([0.2, 0.1, -0.1]), noise=0.3)
    both = Scan(*(np.concatenate([getattr(scan, f), getattr(other, f)]) for f in Scan.__slots__))
    rows = measured(both, True)
    form = np.array([Form.LOS, Form.PS, Form.PS], dtype=np.int64)
    by_coordinate = np.zeros((8, 4))
    by_coordinate[[0, 1, 7, 6], [0, 1, 2, 3]] = 1.0
    slopes = update.linearized_rows(form, center, pose, by_coordinate, ANCHOR, rows)
    return form, (mean, covariance, center, gain, spread), pose, slopes, rows


def dense_update(mean, covariance, slope, residual, noise):
    innovation = slope @ covariance @ slope.T + noise
    gain = covariance @ slope.T @ np.linalg.inv(innovation)
    density = np.exp(-0.5 * residual @ np.linalg.solve(innovation, residual))
    density /= np.sqrt(np.linalg.det(2 * np.pi * innovation))
    return mean + gain @ residual, covariance - gain @ innovation @ gain.T, density


@pytest.mark.parametrize("seed", range(3))
def test_certain_association_is_the_joint_kalman_filter(seed):
    form, state, pose, slopes, rows = linear_case(np.random.default_rng(seed))
    mean, _, center, _, _ = state
    log_pair = np.full((3, 2), -np.inf)
    log_pair[1, 0] = 0.0
    result = update.sequential_update(
        form, np.array([0, 1, 2, 3]), np.array([0, 1, 2]), np.array([0.0, 1.0, 1.0]), *state, mean, center, pose, *slopes,
        ANCHOR, rows, np.ones((3, 2)), log_pair, np.array([0.0, -700.0, 0.0]), 0.0,
    )  # fmt: skip
    slope = np.zeros((6, 13))
    slope[:, :4], slope[:, 7:10] = slopes[0][1], slopes[1][1]
    residual = look(Form.PS, pose, center[1], rows)[0]
    m, p, density = dense_update(*joint_of(*state), slope, residual, rows.covariance[0])
    have_m, have_p = joint_of(*result[:5])
    np.testing.assert_allclose(have_m, m, atol=1e-9)
    np.testing.assert_allclose(have_p, p, atol=1e-9)
    assert result[10] == pytest.approx(np.log(density), abs=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_a_mixture_has_the_moments_of_the_enumeration(seed):
    """One feature, seen in either of two measurements or missed: agent, other feature and own row, by enumeration."""
    form, state, pose, slopes, rows = linear_case(np.random.default_rng(seed))
    mean, _, center, _, _ = state
    chance = np.log([0.5, 0.3])
    log_pair = np.full((3, 2), -np.inf)
    exists, missed = 0.8, 0.1
    slope = np.zeros((6, 13))
    slope[:, :4], slope[:, 7:10] = slopes[0][1], slopes[1][1]
    start_m, start_p = joint_of(*state)
    parts = []
    for m in range(2):
        residual = look(Form.PS, pose, center[1], rows, m)[0]
        parts.append(dense_update(start_m, start_p, slope, residual, rows.covariance[m]))
    log_pair[1] = chance - np.log([part[2] for part in parts])  # both associations count whatever the residuals
    w = np.array([exists * missed, exists * 0.5, exists * 0.3])
    result = update.sequential_update(
        form, np.array([0, 1, 2, 3]), np.array([0, 1, 2]), np.array([0.0, exists, 1.0]), *state, mean, center, pose,
        *slopes, ANCHOR, rows, np.ones((3, 2)), log_pair, np.array([0.0, np.log(missed), 0.0]), 0.0,
    )  # fmt: skip
    total = w.sum() + 1 - exists
    np.testing.assert_allclose(result[5][1], w / total, atol=1e-12)
    have_m, have_p = joint_of(*result[:5])
    everything = [(start_m, start_p), *((m, p) for m, p, _ in parts)]
    for weights, part in (
        (
            np.r_[w[0] + 1 - exists, w[1:]] / total,
            [*range(7), 10, 11, 12],
        ),  # agent, line of sight's dummy, other feature
        (w / w.sum(), None),
    ):
        m = sum(a * x for a, (x, _) in zip(weights, everything, strict=True))
        p = sum(a * (c + np.outer(x - m, x - m)) for a, (x, c) in zip(weights, everything, strict=True))
        if part is not None:
            np.testing.assert_allclose(have_m[part], m[part], atol=1e-9)
            np.testing.assert_allclose(have_p[np.ix_(part, part)], p[np.ix_(part, part)], atol=1e-9)
        else:  # the feature's own row given that it exists: its regression on the agent
            own = slice(7, 10)
            np.testing.assert_allclose(result[3][3:6], p[own, :4] @ np.linalg.inv(p[:4, :4]), atol=1e-8)
            left = p[own, own] - p[own, :4] @ np.linalg.solve(p[:4, :4], p[:4, own])
            np.testing.assert_allclose(result[4][3:6, 3:6], left, atol=1e-8)
    assert np.linalg.eigvalsh(result[4]).min() > -1e-12


@pytest.mark.parametrize("form", [Form.VA, Form.PS, Form.VA_AOD])
def test_a_newborn_is_the_least_squares_fit_given_the_agent(form):
    rows = measured(ideal(form, POSE, FEATURE), True)
    by_coordinate = np.zeros((8, 4))
    by_coordinate[[0, 1, 7, 6], [0, 1, 2, 3]] = 1.0
    x, gain, spread = np.zeros(3), np.zeros((3, 4)), np.zeros((3, 3))
    births.birth(form, POSE, by_coordinate, np.zeros((4, 4)), 3, ANCHOR, rows, 0, x, gain, spread)
    np.testing.assert_allclose(x, FEATURE, atol=1e-4)
    _, by_pose, by_feature = look(form, POSE, x, rows)
    weight = np.linalg.inv(rows.covariance[0][: len(by_pose), : len(by_pose)])
    information = by_feature.T @ weight @ by_feature
    np.testing.assert_allclose(spread, np.linalg.inv(information), rtol=1e-6)
    pull = -np.linalg.solve(information, by_feature.T @ weight @ by_pose @ by_coordinate)
    np.testing.assert_allclose(gain, pull, rtol=1e-3, atol=1e-4)


def test_a_birth_integral_in_the_plane():
    """Laplace's method against quadrature of the nonlinear likelihood, the agent known."""
    pose, q = POSE * [1, 1, 0, 1, 1, 0, 1, 1], FEATURE * [1, 1, 0]
    flat = Measured(*measured(ideal(Form.PS, pose, q, count=1, noise=0.02), True))
    x, gain, spread = np.zeros(3), np.zeros((3, 1)), np.zeros((3, 3))
    log_value = births.birth(
        Form.PS, pose, np.zeros((8, 1)), np.zeros((1, 1)), 2, ANCHOR * FLAT, flat, 0, x, gain, spread
    )

    def density(b, a):
        residual = look(Form.PS, pose, np.array([a, b, 0.0]), flat, slopes=False)[0]
        return np.exp(-0.5 * residual @ residual / 0.02**2) / (2 * np.pi * 0.02**2) ** 2

    wide = 6 * np.sqrt(np.diag(spread)[:2])
    value, _ = dblquad(density, x[0] - wide[0], x[0] + wide[0], x[1] - wide[1], x[1] + wide[1], epsrel=1e-4)
    assert log_value == pytest.approx(np.log(value), abs=0.05)


def test_amplitude_messages_are_those_of_the_reference():
    model = AmplitudeModel(4.0, 1e4, 0.1, 60.0)
    mean, variance, z = np.array([5.0, 20.0, 45.0]), np.array([1.0, 9.0, 4.0]), np.array([4.5, 18.0, 44.0, 21.0])
    table = amplitude.amplitude_table(model, None, 0.0, 60.0)
    logs, posterior = amplitude.amplitude_messages(table, mean, variance, z)
    log_a, post_mean, post_variance, missed, missed_mean, missed_variance = oracle.amplitude_messages(
        model, mean, variance, z
    )
    np.testing.assert_allclose(logs[:, 1:], log_a, atol=1e-5, rtol=1e-6)
    np.testing.assert_allclose(logs[:, 0], missed, atol=1e-6)
    np.testing.assert_allclose(posterior[:, 1:, 0], post_mean, rtol=1e-5)
    np.testing.assert_allclose(posterior[:, 1:, 1], post_variance, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(posterior[:, 0], np.column_stack([missed_mean, missed_variance]), rtol=1e-4)


@pytest.mark.parametrize(
    "motion", [ConstantVelocity(0.1, 0.3, 0.1, 0.05), SpeedHeading(0.5, 0.2, 0.05, 0.3, 0.1, 0.02)]
)
def test_linearized_motion(motion):
    """F and Q against the moments of many particles, drawn narrowly about the mean; the heading may pass π."""
    rng = np.random.default_rng(0)
    dynamics = Dynamics(motion)
    mean = np.array(
        [1.0, 2, 0, -2.0, 3.0, 0.0, 4.0] if isinstance(motion, ConstantVelocity) else [1.0, 2, 0, 5.0, 3.1, 4]
    )
    moved, transition, noise = dynamics.linearize(mean)
    small = np.diag(np.full(len(mean), 1e-3)) ** 2
    small[2, 2] = 0.0
    points = mean + rng.standard_normal((200_000, len(mean))) @ np.sqrt(small)
    after = dynamics._relative(motion.coordinates(motion.predict(rng, motion.rebuild(points))), moved)
    np.testing.assert_allclose(after.mean(axis=0), moved, atol=5e-3)
    expected = transition @ small @ transition.T + noise
    np.testing.assert_allclose(np.cov(after.T), expected, atol=0.02 * expected.max())


@pytest.mark.parametrize("motion", [ConstantVelocity(0.1, 0.3), SpeedHeading(0.5, 0.2, 0.05)])
def test_slopes_of_a_pose(motion):
    mean = np.array([1.0, 2, 3, -2, 0.5, 0.7, 4])[: 7 if isinstance(motion, ConstantVelocity) else 6]
    pose, slopes = Dynamics(motion).pose(mean)
    for j, step in enumerate(1e-6 * np.eye(len(mean))):
        ends = motion.rebuild(np.array([mean + step, mean - step]))
        np.testing.assert_allclose(slopes[:, j], (ends[0] - ends[1]) / 2e-6, atol=1e-8)
    np.testing.assert_array_equal(pose, motion.rebuild(mean[None])[0])


def test_the_proposal_is_the_kalman_update_of_every_component():
    rng = np.random.default_rng(2)
    a, b = rng.standard_normal((2, 4, 4))
    wide, noise = a @ a.T, b @ b.T
    slope, r = rng.standard_normal((2, 4)), np.diag([0.3, 0.5])
    before, z = rng.standard_normal(4), rng.standard_normal(2)

    def kalman(mean, covariance):
        gain = covariance @ slope.T @ np.linalg.inv(slope @ covariance @ slope.T + r)
        return mean + gain @ (z - slope @ mean), covariance - gain @ slope @ covariance

    centers = rng.standard_normal((5, 4))
    means, covariance = particles.proposal(centers, noise, (before, wide), kalman(before, wide), 1.0)
    for center, mean in zip(centers, means, strict=True):
        expected = kalman(center, noise)
        np.testing.assert_allclose(mean, expected[0], atol=1e-6)
        np.testing.assert_allclose(covariance, expected[1], atol=1e-6)


def small(experiment, agent="gaussian", **changes):
    parameters = replace(experiment.parameters, agent=agent, **changes)
    return Conditional(parameters, SpeedHeading(experiment.interval, 0.02, 0.01), particles=300)


@pytest.mark.parametrize("agent", ["gaussian", "particles"])
def test_tracks_and_maps_the_pedestrian(agent):
    experiment = Experiment(steps=80)
    truth, scans, _ = draw(experiment, np.random.default_rng(11))
    filter_ = small(experiment, agent, types=(Form.VA_AOD, Form.PS))
    rng = np.random.default_rng(5)
    state = filter_.init(*informed_start(rng, Box(experiment.start), scans[0], filter_.parameters, 0.1, 500), 30.0)
    error = []
    for k, scan in enumerate(scans):
        state, info = filter_.step(rng, state, scan)
        error.append(np.linalg.norm(info.estimate.position - truth.position[k]))
    assert np.sqrt(np.mean(np.square(error))) < 0.03
    places = info.estimate.feature
    for q in experiment.features:
        assert np.linalg.norm(places - q, axis=1).min() < 0.3
    assert np.linalg.eigvalsh(state.map.spread).min() > -1e-12


def test_a_map_cannot_tell_where_the_agent_is():
    """Without a line of sight the map floats: whatever is measured, the agent's position stays as uncertain as it was.
    With the correlation dropped, everything else equal, the filter believes to have learnt it."""
    after = floating_map(30)
    assert after["kept"] == pytest.approx(0.5, rel=0.02)
    assert after["dropped"] < 0.25


def test_same_seed_same_result_and_empty_scans_only_predict():
    experiment = Experiment(steps=6)
    _, scans, _ = draw(experiment, np.random.default_rng(3))
    filter_ = small(experiment, "particles")
    ends = []
    for _ in range(2):
        rng = np.random.default_rng(4)
        state = filter_.init(*informed_start(rng, Box(experiment.start), scans[0], filter_.parameters, 0.1, 300), 30.0)
        for scan in scans:
            state, info = filter_.step(rng, state, scan)
        ends.append(info.estimate.position)
    np.testing.assert_array_equal(*ends)
    nothing = scans[0].select(np.zeros(0, int))
    before = np.trace(state.covariance)
    state, info = filter_.step(np.random.default_rng(0), state, nothing)
    assert np.isfinite(info.estimate.position).all()
    assert np.trace(state.covariance) > before


def test_a_hidden_feature_is_not_given_up_at_once():
    """After 40 steps a wall's path is missing for five: something may hide it, and it is kept; without that it is lost."""
    experiment = Experiment(steps=45)
    _, scans, sources = draw(experiment, np.random.default_rng(11))
    existence = {}
    for hide in (0.0, 0.02):
        filter_ = replace(small(experiment, types=(Form.VA_AOD, Form.PS)), hide=hide)
        rng = np.random.default_rng(5)
        state = filter_.init(*informed_start(rng, Box(experiment.start), scans[0], filter_.parameters, 0.1, 500), 30.0)
        for k, (scan, source) in enumerate(zip(scans, sources, strict=True)):
            state, _ = filter_.step(rng, state, scan.select(source != 1) if k >= 40 else scan)
        near = np.linalg.norm(state.map.center - experiment.features[0], axis=1) < 0.5
        existence[hide] = state.map.weight[near].sum()
    assert existence[0.02] > 0.5
    assert existence[0.0] < 0.1


def half_way():
    """A filter, 60 scans, its state after 30 of them, and the virtual anchor of the wall."""
    experiment = Experiment(steps=60)
    _, scans, _ = draw(experiment, np.random.default_rng(11))
    filter_ = small(experiment, types=(Form.VA_AOD, Form.PS))
    rng = np.random.default_rng(5)
    state = filter_.init(*informed_start(rng, Box(experiment.start), scans[0], filter_.parameters, 0.1, 500), 30.0)
    for scan in scans[:30]:
        state, _ = filter_.step(rng, state, scan)
    return filter_, scans, state, experiment.features[0]


def test_of_two_features_of_one_path_the_one_that_is_seen_is_left():
    """A copy of a wall's virtual anchor beside it, from outliers: the wall's detections speak against it, though something
    may hide a feature; a copy elsewhere is not touched by them."""
    filter_, scans, state, wall = half_way()
    chart = state.map
    row = int(np.argmin(np.linalg.norm(chart.center - wall, axis=1)))
    block = chart.spread[3 * row : 3 * row + 3, 3 * row : 3 * row + 3]
    two = chart.center[row] + np.array([[0.25, 0.1, 0], [25.0, 30.0, 0]])
    copied = chart.joined(
        np.array([900, 901]), np.array([1, 1]), np.full(2, int(Form.VA_AOD)), np.full(2, 0.95),
        chart.reference[[row, row]], two, np.tile(chart.gain[3 * row : 3 * row + 3], (2, 1, 1)), np.tile(block, (2, 1, 1)),
    )  # fmt: skip
    copied = copied._replace(
        seen=copied.seen + 10,
        hidden=np.where(np.isin(copied.owner, [len(chart.label), len(chart.label) + 1]), 0.9, copied.hidden),
    )
    left = {}
    for double in (0.8, 1.0):
        changed, other = replace(filter_, double=double), replace(state, map=copied)
        for scan in scans[30:]:
            other, _ = changed.step(np.random.default_rng(1), other, scan)
        left[double] = {n: float(other.map.existence[other.map.label == n].sum()) for n in (900, 901)}
        assert np.linalg.norm(other.map.center - wall, axis=1).min() < 0.1
    assert left[0.8][900] < 0.2 * left[1.0][900]
    assert left[0.8][901] == pytest.approx(left[1.0][901], rel=0.2)


def test_what_is_too_weak_to_be_seen_is_not_given_up_for_what_is_seen_beside_it():
    """A wall's virtual anchor and a copy beside it, seen last when it was near enough: the wall's detections in its cell do not
    speak against it, while they do against one that should be as strong as they are."""
    filter_, scans, state, wall = half_way()
    chart = state.map
    row = int(np.argmin(np.linalg.norm(chart.center - wall, axis=1)))
    at = slice(3 * row, 3 * row + 3)
    left = {}
    for name, share in (("weak", 0.02), ("strong", 1.0)):
        copied = chart.joined(
            np.array([900]), np.array([1]), np.full(1, int(Form.VA_AOD)), np.full(1, 0.95),
            chart.reference[[row]] * [0.02, 0.02**2, share], chart.center[[row]] + [0.25, 0.1, 0], chart.gain[at][None],
            chart.spread[at, at][None],
        )  # fmt: skip
        other = replace(state, map=copied._replace(seen=copied.seen + 10))
        for scan in scans[30:45]:
            other, _ = filter_.step(np.random.default_rng(1), other, scan)
        left[name] = float(other.map.existence[other.map.label == 900].sum())
    assert left["weak"] > 0.9
    assert left["strong"] < 0.6


def test_weights_are_flattened_only_as_far_as_particles_are_needed():
    rng = np.random.default_rng(1)
    mild, sharp = rng.normal(0, 0.5, 400), rng.normal(0, 300.0, 400)
    assert np.allclose(particles.tempered(mild, 20), oracle.normalized(mild))
    weight = particles.tempered(sharp, 20)
    assert oracle.effective_size(oracle.normalized(sharp)) < 2
    assert oracle.effective_size(weight) == pytest.approx(20, rel=1e-3)
    assert np.array_equal(np.argsort(weight), np.argsort(sharp))
