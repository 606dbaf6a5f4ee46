"""The Rao-Blackwellized filter: exact reductions, determinism, and statistics of the synthetic experiment."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.errors import FilterError
from dopslam.evaluate.belief import bound, tangent_jacobian
from dopslam.slam.belief import belief, geometry
from dopslam.slam.belief.experiment import Experiment, blocked, draw, draw_track, spatial, weak
from dopslam.slam.belief.motion import ConstantVelocity, SpeedHeading, particles
from dopslam.slam.belief.rao_blackwell import RaoBlackwell, State
from dopslam.slam.belief.records import AOD_FOR_VA, PAPER, Features, Form, Parameters, Scan
from dopslam.slam.belief.start import Box, informed_start, uniform_start
from dopslam.studies.bp_run import evaluate, run


def small_filter(experiment, types=PAPER, **changes):
    parameters = replace(experiment.parameters, types=types, **changes)
    return RaoBlackwell(parameters, ConstantVelocity(experiment.interval, 0.02))


def test_known_agent_and_certain_association_is_the_kalman_filter():
    """All particles at one place, one feature of one type, no false alarms: the feature's update is the EKF's."""
    experiment = Experiment()
    filter_ = RaoBlackwell(
        replace(
            experiment.parameters, types=(Form.VA,), false_alarm_rate=1e-30, birth_rate=1e-30, position_walk=0.0,
            amplitude_walk=0.0, reacquisition=0.0, rescale_covariance=False,
        ),
        ConstantVelocity(0.1, 0.0),
    )  # fmt: skip
    agent = particles(np.tile([6.0, -4, 0], (50, 1)), np.tile([0.65, 0, 0], (50, 1)))
    mean, cov = np.array([0.1, 18.1, 0.0]), np.diag([0.2, 0.3, 0.0]) ** 2
    features = Features(np.zeros(1, int), np.ones((1, 1)), mean[None, None], cov[None, None], np.array([[15.0, 0.5]]))
    state = State(agent, np.zeros(50), features, np.array([1e-9, 30.0, 1.0]), 1)
    p = np.array([6.065, -4, 0])
    length, e, t = geometry.predict(Form.VA, p, np.array([0.0, 18, 0]), experiment.anchor)
    noise = np.diag([0.01, 0.008, 0.003]) ** 2
    scan = Scan(np.array([length]), e[None], t[None], np.array([15.0]), noise[None])
    after, info = filter_.step(np.random.default_rng(0), state, scan)
    _, h, _ = tangent_jacobian(Form.VA, p, 0.0, mean, experiment.anchor, 1)
    h = h[:2]
    s = h @ cov @ h.T + noise[:2, :2]
    predicted, arrival, _ = geometry.predict(Form.VA, p, mean, experiment.anchor)
    residual = np.concatenate([[length - predicted], geometry.chord(e, arrival, 1)])
    gain = cov @ h.T @ np.linalg.inv(s)
    np.testing.assert_allclose(after.features.mean[0, 0], mean + gain @ residual, atol=1e-9)
    np.testing.assert_allclose(after.features.covariance[0, 0], cov - gain @ h @ cov, atol=1e-12)
    assert info.association[1, 1] == pytest.approx(1, abs=1e-9)


def test_same_seed_same_result():
    experiment = Experiment(steps=15)
    results = []
    for _ in range(2):
        _, scans, _ = draw(experiment, np.random.default_rng(3))
        history = run(small_filter(experiment), np.random.default_rng(4), scans, Box(experiment.start), 200)
        results.append(np.array([i.estimate.position for i in history.infos]))
    np.testing.assert_array_equal(*results)


def test_empty_scans_only_predict():
    experiment = Experiment()
    filter_ = small_filter(experiment)
    agent, log_weight = uniform_start(np.random.default_rng(0), Box(experiment.start), 100)
    state = filter_.init(agent, log_weight)
    empty = Scan(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3, 3)))
    for _ in range(3):
        state, info = filter_.step(np.random.default_rng(1), state, empty)
    assert info.features == 0
    assert info.line_of_sight < 0.9
    assert np.isfinite(info.estimate.position).all()


def test_measurement_order_does_not_matter():
    experiment = Experiment(steps=3)
    _, scans, _ = draw(experiment, np.random.default_rng(5))
    filter_ = small_filter(experiment)
    start = filter_.init(*uniform_start(np.random.default_rng(6), Box(experiment.start), 200))
    order = np.random.default_rng(7).permutation(len(scans[0]))
    estimates = [
        filter_.step(np.random.default_rng(8), start, scan)[1].estimate for scan in (scans[0], scans[0].select(order))
    ]
    np.testing.assert_allclose(estimates[0].position, estimates[1].position, atol=1e-6)


def test_kernel_jitter_keeps_two_moments():
    rng = np.random.default_rng(0)
    x = rng.normal(size=(200_000, 3)) @ np.array([[1, 0, 0], [0.5, 0.1, 0], [0, 0, 0.0]]).T
    y = belief.kernel_jitter(rng, x, 0.35)
    np.testing.assert_allclose(y.mean(axis=0), x.mean(axis=0), atol=5e-3)
    np.testing.assert_allclose(np.cov(y.T), np.cov(x.T), atol=2e-2)
    assert np.ptp(y[:, 2]) == 0  # no spread, no noise


def test_amplitude_messages_are_integrals():
    model = Experiment().detector
    mean, variance, z = np.array([8.0]), np.array([1.5]), np.array([9.0])
    log_a, post_mean, post_var, log_missed, *_ = belief.amplitude_messages(model, mean, variance, z)
    u = np.linspace(0.01, 25, 20001)
    prior = np.exp(-0.5 * (u - 8) ** 2 / 1.5) / np.sqrt(2 * np.pi * 1.5)
    joint = prior * np.exp(model.log_rice(9.0, u))
    du = u[1] - u[0]
    assert log_a[0, 0] == pytest.approx(np.log(joint.sum() * du), abs=1e-4)
    assert post_mean[0, 0] == pytest.approx((joint * u).sum() / joint.sum(), abs=1e-3)
    assert post_var[0, 0] == pytest.approx(
        (joint * u**2).sum() / joint.sum() - ((joint * u).sum() / joint.sum()) ** 2, rel=1e-2
    )
    assert np.exp(log_missed[0]) == pytest.approx((prior * model.missed_probability(u)).sum() * du, rel=0.02)


def test_informed_start_points_at_the_truth():
    experiment = Experiment()
    truth, scans, _ = draw(experiment, np.random.default_rng(9))
    agent, log_weight = informed_start(
        np.random.default_rng(1),
        Box(experiment.start),
        scans[0],
        experiment.parameters,
        experiment.interval,
        5000,
    )
    weight = belief.normalized(log_weight)
    position = agent[:, :3] + experiment.interval * agent[:, 3:6]
    assert np.linalg.norm(weight @ position - truth.position[0]) < 0.03


def test_motion_models():
    rng = np.random.default_rng(0)
    x = particles(np.zeros((5, 3)), np.tile([1.0, 1.0, 0.0], (5, 1)), bias=2.0)
    y = ConstantVelocity(0.5, 0.0).predict(rng, x)
    np.testing.assert_allclose(y[:, :2], 0.5)
    np.testing.assert_allclose(y[:, 7], np.pi / 4)
    turn = SpeedHeading(0.5, 0.0, 0.0, turn_rate=np.pi / 10)
    place = x
    for _ in range(40):
        place = turn.predict(rng, place)
    np.testing.assert_allclose(place[:, :3], 0.0, atol=1e-9)  # a full circle
    coordinates = turn.coordinates(y)
    np.testing.assert_allclose(turn.rebuild(coordinates), y, atol=1e-12)


def test_bad_parameters_are_named():
    with pytest.raises(FilterError, match="types"):
        Parameters(anchor=np.zeros(3), amplitude=Experiment().detector, types=(Form.LOS,))
    with pytest.raises(FilterError, match="covariance"):
        Scan(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3)), np.ones(1), np.zeros((1, 4, 4)))


def test_bound_of_the_pedestrian_experiment():
    """5.6 mm and 0.232° in an independent trial; without map or line of sight it is larger."""
    experiment = Experiment()
    truth = draw_track(experiment, np.random.default_rng(0))
    motion = ConstantVelocity(experiment.interval, 0.02)
    full = bound(experiment, truth, motion)
    assert np.sqrt(np.mean(full.position**2)) == pytest.approx(5.6e-3, rel=0.06)
    assert np.degrees(np.sqrt(np.mean(full.heading**2))) == pytest.approx(0.232, rel=0.02)
    with_aod = bound(experiment, truth, motion, aod_for_va=True)
    without_sight = bound(replace(experiment, blocked=(90, 130)), truth, motion)
    assert (with_aod.position <= full.position + 1e-9).all()
    assert (without_sight.position >= full.position - 1e-9).all()


@pytest.mark.mc
@pytest.mark.parametrize(
    "experiment,types,particle_count,limit_mm",
    [
        (Experiment(), PAPER, 1000, 9.0),
        (Experiment(), AOD_FOR_VA, 1000, 12.0),
        (weak(), PAPER, 1000, 20.0),
        (blocked(), PAPER, 1000, 11.0),
        (spatial(), AOD_FOR_VA, 1000, 15.0),
    ],
    ids=["paper", "aod", "weak", "blocked", "spatial"],
)
def test_accuracy(experiment, types, particle_count, limit_mm):
    """Three runs each: near the bound, every feature found with its type, nothing false (about 6 s each).

    Guards against regressions, not the figures of a study: of the ten seeds from 0 the second and third are the worst
    with AOD for VAs (9.6 and 11.2 mm; 7.1 mm over all ten).
    """
    errors = []
    for seed in range(3):
        truth, scans, _ = draw(experiment, np.random.default_rng([seed, 0]))
        vertical = 0.02 if experiment.spatial else 0.0
        filter_ = RaoBlackwell(
            replace(experiment.parameters, types=types), ConstantVelocity(experiment.interval, 0.02, vertical)
        )
        box = Box(experiment.start, half_height=0.5 * experiment.spatial, half_climb=0.1 * experiment.spatial)
        history = run(filter_, np.random.default_rng([seed, 1]), scans, box, particle_count)
        score = evaluate(experiment, truth, history, types)
        errors.append(score.position_rmse)
        assert score.found == len(experiment.features)
        assert score.false == 0 and not score.ghost
        assert score.true_type.min() > 0.9
    assert 1e3 * np.sqrt(np.mean(np.square(errors))) < limit_mm


@pytest.mark.mc
def test_single_type_filters_are_worse():
    """A filter that knows only one type explains the other one badly (paper B's conclusion)."""
    experiment = Experiment()
    rmse = {}
    for types in (PAPER, (Form.VA,), (Form.PS,)):
        errors = []
        for seed in range(2):
            truth, scans, _ = draw(experiment, np.random.default_rng([seed, 0]))
            history = run(
                small_filter(experiment, types),
                np.random.default_rng([seed, 1]),
                scans,
                Box(experiment.start),
                1000,
            )
            errors.append(evaluate(experiment, truth, history, types).position_rmse)
        rmse[types] = np.sqrt(np.mean(np.square(errors)))
    assert rmse[(Form.VA,)] > 1.5 * rmse[PAPER]
    assert rmse[(Form.PS,)] > 1.2 * rmse[PAPER]
