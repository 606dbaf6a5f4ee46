"""The EK-PMB recursion against simpler filters and its own symmetries (a minute of compilation)."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.errors import FilterError
from dopslam.models.detection import ConstantDetection, SnrDetection
from dopslam.models.measurement import BS, SP, VA, jacobians, measure, residual, wrap
from dopslam.models.motion import propagate, transition_jacobian
from dopslam.models.scans import Scans
from dopslam.simulate.world import FixedNoise, draw_scans, nominal_track, section_v, simulate, unknown_motion
from dopslam.slam.pmb import ek_pmb
from dopslam.slam.pmb import mixture as pmbm
from dopslam.slam.pmb.density import PMB, compile_model, initial_density
from dopslam.slam.pmb.ek_pmb import FilterParameters, filter_scans, scan_of

pytestmark = pytest.mark.mc


def known_map(world, spread=0.5):
    """A density whose four VAs exist for certain, with correlated errors."""
    rng = np.random.default_rng(4)
    start = initial_density(world.prior_mean, world.prior_covariance)
    root = rng.normal(size=(16, 16)) * spread / 4
    covariance = root @ root.T + 1e-3 * np.eye(16)
    covariance[:4, :4] = world.prior_covariance
    covariance[:4, 4:] = covariance[4:, :4] = 0
    return PMB(
        mean=np.concatenate([world.prior_mean, world.landmarks(VA).ravel()]),
        covariance=covariance,
        kind=np.array([BS, VA, VA, VA, VA], dtype=np.int64),
        weight=np.ones(5),
        track=np.array([-1, 0, 1, 2, 3], dtype=np.int64),
        reference=np.zeros(5),
        detections=np.zeros(5),
        visible=np.ones(5),
        unseen=np.zeros(5),
        idle=np.zeros(5),
        origin=np.zeros(5, dtype=np.int64),
        trail=start.trail,
    )


def sure_scan(world, state, rng):
    """One measurement of the BS and of every VA, in this order."""
    position, kind = world.position[:5], world.kind[:5]
    z = measure(state, position, kind, world.bs, speed=world.motion.speed)
    return z + rng.normal(size=(5, 6)) * world.noise.std


def one_step(density, scan, model):
    """The recursion over a single scan: posterior, NIS, and the associations of its measurements."""
    offsets = np.array([0, len(scan.z)])
    result = filter_scans(
        scan.z, scan.covariance, scan.log_snr, offsets, scan.clutter, np.ones(1), density, model, np.zeros(1, np.int64)
    )
    return result[0], result[9][0], result[7]


def test_reduces_to_the_kalman_filter(world):
    """p_D = 1, no clutter, no births: the joint filter is the textbook EKF, for ten steps."""
    rng = np.random.default_rng(1)
    parameters = FilterParameters(
        iterations=1,
        intensity=(1e-30, 1e-30),
        detection=ConstantDetection(1.0, None),
        existence_limit=1.0,
        unconfirmed=1.0,
    )
    model = compile_model(parameters, world.motion, world.bs)
    density = known_map(world)
    mean, covariance = density.mean.copy(), density.covariance.copy()
    noise = np.diag(world.noise.std**2)
    for state in nominal_track(world)[:10]:
        z = sure_scan(world, state, rng)
        scan = ek_pmb.Scan(z, np.broadcast_to(noise, (5, 6, 6)).copy(), np.zeros(5), 0, 1e-30, 1.0)
        density, nis, track = one_step(density, scan, model)
        f = np.eye(16)
        f[:4, :4] = transition_jacobian(mean[:4], world.motion)
        mean[:4] = propagate(mean[:4], world.motion)
        covariance = f @ covariance @ f.T
        covariance[:4, :4] += world.motion.process_noise
        landmarks = np.vstack([world.bs, mean[4:].reshape(4, 3)])
        a, b = jacobians(mean[:4], landmarks, world.kind[:5], world.bs, speed=world.motion.speed)
        h = np.zeros((30, 16))
        for i in range(5):
            h[6 * i : 6 * i + 6, :4] = a[i]
            if i:
                h[6 * i : 6 * i + 6, 1 + 3 * i : 4 + 3 * i] = b[i]
        predicted = measure(mean[:4], landmarks, world.kind[:5], world.bs, speed=world.motion.speed)
        nu = residual(z, predicted).ravel()
        s = h @ covariance @ h.T + np.kron(np.eye(5), noise)
        gain = np.linalg.solve(s, h @ covariance).T
        assert nis == pytest.approx(nu @ np.linalg.solve(s, nu), rel=1e-8)
        mean = mean + gain @ nu
        covariance = covariance - gain @ h @ covariance
        np.testing.assert_allclose(density.mean, mean, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(density.covariance, covariance, rtol=1e-6, atol=1e-9)
        assert track[0].tolist() == [-1, 0, 1, 2, 3] and density.weight[1:].min() > 1 - 1e-12


def test_cubature_is_the_kalman_filter_where_the_model_is_linear(world):
    """With a vanishing spread both linearizations agree."""
    state = nominal_track(world)[0]
    z = sure_scan(world, state, np.random.default_rng(2))
    scan = ek_pmb.Scan(z, np.broadcast_to(np.diag(world.noise.std**2), (5, 6, 6)).copy(), np.zeros(5), 0, 1e-30, 1.0)
    small = replace(world, prior_covariance=1e-6 * world.prior_covariance)
    still = replace(world.motion, process_noise=1e-6 * world.motion.process_noise)
    posteriors = []
    for cubature in (False, True):
        parameters = FilterParameters(cubature=cubature, intensity=(1e-30, 1e-30))
        model = compile_model(parameters, still, world.bs)
        posteriors.append(one_step(known_map(small, spread=1e-3), scan, model)[0])
    np.testing.assert_allclose(posteriors[0].mean, posteriors[1].mean, rtol=1e-9, atol=1e-6)


def run(world, scans, prior=None, **options):
    return ek_pmb.run(
        scans,
        prior or (world.prior_mean, world.prior_covariance),
        world.motion,
        world.bs,
        FilterParameters(**options),
    )


def test_order_of_the_detections_does_not_matter(world):
    _, scans = simulate(world, 0, 0)
    order = np.concatenate(
        [
            np.random.default_rng(k).permutation(np.arange(r.start, r.stop))
            for k, r in enumerate(map(scans.rows, range(40)))
        ]
    )
    shuffled = replace(scans, z=scans.z[order], covariance=scans.covariance[order], label=scans.label[order])
    one, _ = run(world, scans)
    other, _ = run(world, shuffled)
    np.testing.assert_allclose(one.mean, other.mean, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(np.sort(one.existence), np.sort(other.existence), rtol=1e-6, atol=1e-9)


def test_doppler_off_is_infinite_doppler_noise(world):
    """The clutter density is scaled so that the two likelihood ratios are the same numbers (Gaussian: a Student-t counts
    the rows)."""
    _, scans = simulate(world, 0, 1)
    std = 1e5
    covariance = scans.covariance.copy()
    covariance[:, 5, 5] = std**2
    span = np.sqrt(2 * np.pi) * std
    vague = replace(
        scans,
        covariance=covariance,
        search_volume=scans.search_volume / scans.doppler_span * span,
        doppler_span=span,
    )
    with_vague, _ = run(world, vague, robust=np.inf)
    without, _ = run(world, scans, doppler=False, robust=np.inf)
    np.testing.assert_allclose(with_vague.mean, without.mean, rtol=1e-6, atol=1e-6)
    kept = [
        h.existence[h.existence > 0.01] for h in (with_vague, without)
    ]  # what is about to be dropped may be so earlier
    np.testing.assert_allclose(*kept, atol=1e-6)


def test_rigid_motion_of_the_world_moves_the_answer(world):
    _, scans = simulate(world, 0, 2)
    angle, shift = 0.9, np.array([30.0, -12.0, 0.0])
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    z = scans.z.copy()
    z[:, 3] = wrap(z[:, 3] + angle)
    mean = world.prior_mean.copy()
    mean[:2] = (turn @ [*mean[:2], 0] + shift)[:2]
    mean[2] += angle
    block = np.eye(4)
    block[:2, :2] = turn[:2, :2]
    moved_motion = replace(world.motion, process_noise=block @ world.motion.process_noise @ block.T)
    moved = replace(world, bs=turn @ world.bs + shift, motion=moved_motion)
    here, _ = run(world, scans)
    there, _ = run(moved, replace(scans, z=z), (mean, block @ world.prior_covariance @ block.T))
    expected = here.mean[:, :2] @ turn[:2, :2].T + shift[:2]
    np.testing.assert_allclose(there.mean[:, :2], expected, atol=1e-6)
    np.testing.assert_allclose(there.mean[:, 2] - angle, here.mean[:, 2], atol=1e-8)
    np.testing.assert_allclose(there.position, here.position @ turn.T + shift, atol=1e-4)


@pytest.mark.parametrize("options", [{}, {"joint": False}, {"doppler": False}, {"cubature": True}, {"reweight": True}])
def test_probabilities_and_covariances_stay_what_they_are(world, options):
    _, scans = simulate(replace(world, clutter_count=10.0), 0, 3)
    history, diagnostics = run(world, scans, **options)
    assert (history.existence >= 0).all() and (history.existence <= 1).all()
    assert (history.type_probability >= -1e-12).all() and (history.type_probability <= 1 + 1e-12).all()
    np.testing.assert_allclose(history.type_probability.sum(axis=1), 1.0, atol=1e-9)
    for covariance in (history.covariance, history.position_covariance):
        values = np.linalg.eigvalsh(covariance)
        assert (values > 0).all()
        np.testing.assert_array_equal(covariance, np.swapaxes(covariance, -1, -2))
    for weights in diagnostics.weights:
        assert weights.sum() == pytest.approx(1, abs=1e-9)


def test_finds_the_map_and_drops_the_clutter(world):
    _, scans = simulate(world, 0, 4)
    history, _ = run(world, scans)
    for kind in (VA, SP):
        found = history.reported(39, kind)
        assert len(found) == 4
        for true in world.landmarks(kind):
            assert np.linalg.norm(found - true, axis=1).min() < 5.0


def test_six_states_follow_an_unknown_speed(world):
    six = unknown_motion(world)
    states, scans = simulate(six, 1, 0)
    history, _ = run(six, scans)
    assert abs(history.mean[-1, 4] - states[-1, 4]) < 5 * np.sqrt(history.covariance[-1, 4, 4])
    assert np.sqrt(history.covariance[-1, 4, 4]) < 0.15
    assert np.linalg.norm(history.mean[-1, :2] - states[-1, :2]) < 2.0


def test_pmbm_with_one_clear_association_is_the_pmb(world):
    """Without clutter, misses or confusion every hypothesis but one has vanishing weight; a landmark seen once is believed."""
    clear = replace(world, noise=FixedNoise(world.noise.std, 1.0, 50.0), clutter_count=0.0)
    states, scans = simulate(clear, 0, 5)
    scans = _only(scans, scans.label < 5)
    mixture, _ = pmbm.run(
        scans, (world.prior_mean, world.prior_covariance), world.motion, world.bs,
        FilterParameters(intensity=(1e-7, 1e-20), unconfirmed=0.999), hypotheses=5,
    )  # fmt: skip
    single, _ = run(world, scans, intensity=(1e-7, 1e-20), unconfirmed=0.999)
    np.testing.assert_allclose(mixture.mean, single.mean, atol=2e-3)
    assert np.linalg.norm(mixture.mean[-1, :2] - states[-1, :2]) < 1.5


def _only(scans: Scans, keep):
    counts = np.array([keep[scans.rows(k)].sum() for k in range(scans.steps)])
    return replace(
        scans,
        z=scans.z[keep],
        covariance=scans.covariance[keep],
        label=scans.label[keep],
        offsets=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
    )


def test_empty_scans_are_prediction_only(world):
    _, scans = simulate(world, 0, 6)
    nothing = _only(scans, np.zeros(len(scans.z), dtype=bool))
    history, _ = run(world, nothing)
    np.testing.assert_allclose(history.mean[0], propagate(world.prior_mean, world.motion), rtol=1e-12)
    assert len(history.existence) == 0
    np.testing.assert_allclose(np.diff(history.covariance[:, 3, 3]), 0.04, rtol=1e-9)


def test_snr_detection_learns_and_needs_snr(world):
    _, scans = simulate(world, 0, 7)
    with pytest.raises(FilterError, match="snr"):
        run(world, scans, detection=SnrDetection(14.0))
    history, _ = run(world, replace(scans, snr=np.full(len(scans.z), 100.0)), detection=SnrDetection(14.0))
    assert len(history.reported(39, VA)) == 4


def test_wrong_sizes_and_bad_covariances_are_refused(world):
    _, scans = simulate(world, 0, 8)
    with pytest.raises(FilterError, match="motion model"):
        run(unknown_motion(world), scans, (world.prior_mean, world.prior_covariance))
    bad = scans.covariance.copy()
    bad[3] = -np.eye(6)
    with pytest.raises(FilterError, match="variance"):
        replace(scans, covariance=bad)


def test_scan_without_doppler_has_five_rows(world):
    _, scans = simulate(world, 0, 9)
    assert scan_of(scans, 0, False, world.motion.interval).z.shape[1] == 5
    ratio = scans.clutter_intensity(True) / scans.clutter_intensity(False)
    assert ratio == pytest.approx(1 / scans.doppler_span)


def test_sharp_measurements_stay_well_conditioned():
    """Variances over nine orders of magnitude: covariances stay definite and the map exact."""
    world = section_v(0.1)
    std = np.array([0.003, 0.001, 0.0015, 0.0006, 0.001, 0.004])
    sharp = replace(world, noise=FixedNoise(std, 0.95, 50.0), clutter_count=0.05)
    rng = np.random.default_rng(1)
    states = nominal_track(sharp)
    history, _ = run(sharp, draw_scans(sharp, states, rng, rng), iterations=3)
    assert np.abs(history.mean[-1, :2] - states[-1, :2]).max() < 0.05
    assert (np.linalg.eigvalsh(history.covariance) > 0).all()
    assert len(history.reported(39, VA)) == 4 and len(history.reported(39, SP)) == 4
