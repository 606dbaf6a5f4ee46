"""Tracks of one path are merged without loss or double count; pieces of one path are one detection."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.filters import FILTERS
from dopslam.models.kernels import BS, SP, SR, VA
from dopslam.models.measurement import measure
from dopslam.pipeline import problem as build
from dopslam.simulate.world import section_v, simulate
from dopslam.slam.filter import run, run_steps
from dopslam.slam.pmb.density import PMB, FilterParameters, Scan, compile_model
from dopslam.slam.pmb.ek_pmb import single_step
from dopslam.slam.pmb.merging import identify, merge_duplicates
from dopslam.slam.pmb.splinters import pass_over_splinters

N = 4


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def gaussian(rng, size):
    root = rng.standard_normal((size, size))
    return rng.standard_normal(size), root @ root.T + np.eye(size)


def updated(mean, covariance, rows, noise, z):
    """The linear Kalman update."""
    gain = covariance @ rows.T @ np.linalg.inv(rows @ covariance @ rows.T + noise)
    kept = np.eye(len(mean)) - gain @ rows
    return mean + gain @ (z - rows @ mean), kept @ covariance @ kept.T + gain @ noise @ gain.T


def test_two_tracks_with_half_of_the_detections_each_are_one_with_all(rng):
    """Detections of one landmark, given by turns to two tracks; receiver and another landmark hang together with both."""
    own, spread = gaussian(rng, N + 3)  # receiver and another landmark
    wide = 50.0 * np.eye(3)
    two = (
        np.concatenate([own, np.zeros(6)]),
        np.block([[spread, np.zeros((N + 3, 6))], [np.zeros((6, N + 3)), np.kron(np.eye(2), wide)]]),
    )
    one = (
        np.concatenate([own, np.zeros(3)]),
        np.block(
            [[spread, np.zeros((N + 3, 3))], [np.zeros((3, N + 3)), wide / 2]]  # what two such priors say together
        ),
    )
    for k in range(6):
        by_state, by_landmark, z = rng.standard_normal((5, N)), rng.standard_normal((5, 3)), rng.standard_normal(5)
        noise = 0.1 * np.eye(5)
        rows = np.hstack([by_state, np.zeros((5, 3)), np.zeros((5, 6))])
        rows[:, N + 3 + 3 * (k % 2) : N + 6 + 3 * (k % 2)] = by_landmark
        two = updated(*two, rows, noise, z)
        one = updated(*one, np.hstack([by_state, np.zeros((5, 3)), by_landmark]), noise, z)
    mean, covariance = (np.array(part) for part in two)
    assert identify(mean, covariance, N, 2, 3)
    np.testing.assert_allclose(mean[:-3], one[0], rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(covariance[:-3, :-3], one[1], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(mean[-3:], one[0][-3:], rtol=1e-9, atol=1e-10)  # the other block is its copy


def density(world, *landmarks):
    """The receiver and landmarks (kind, position, existence, unseen), each a track of its own with σ = 0.1 m."""
    kind, position, weight, unseen = zip(*landmarks, strict=True)
    size = N + 3 * len(kind)
    covariance = 0.01 * np.eye(size)
    covariance[:N, :N] = world.prior_covariance
    ones, none = np.ones(len(kind) + 1), np.zeros(len(kind) + 1, dtype=np.int64)
    return PMB(
        np.concatenate([world.prior_mean, *position]), covariance, np.array([BS, *kind], dtype=np.int64),
        np.array([1.0, *weight]), np.arange(-1, len(kind)), np.zeros(len(kind) + 1), 5.0 * ones, ones.copy(),
        np.array([0.0, *unseen]), np.zeros(len(kind) + 1), none, np.zeros((0, 2)),
    )  # fmt: skip


def merged(world, *landmarks):
    """Weights of the landmarks after merging."""
    given = density(world, *landmarks)
    merge_duplicates(given, N, compile_model(FilterParameters(), world.motion, world.bs))
    return given.weight[1:]


def test_which_tracks_are_one(world):
    wall = world.landmarks(VA)[0]
    near, far = wall + np.array([0.1, -0.1, 0.05]), wall + np.array([1.5, 0.0, 0.0])
    both = 1.0 - (1.0 - 0.8) * (1.0 - 0.9)
    assert merged(world, (VA, wall, 0.8, 3.0), (VA, near, 0.9, 0.0)) == pytest.approx([0.0, both])
    assert merged(world, (VA, wall, 0.8, 0.0), (SR, near, 0.9, 3.0)) == pytest.approx([both, 0.0])
    assert merged(world, (VA, wall, 0.8, 0.0), (VA, near, 0.9, 0.0)) == pytest.approx([0.8, 0.9])  # seen side by side
    assert merged(world, (VA, wall, 0.8, 3.0), (VA, far, 0.9, 0.0)) == pytest.approx([0.8, 0.9])
    assert merged(world, (VA, wall, 0.8, 3.0), (SP, near, 0.9, 0.0)) == pytest.approx([0.8, 0.9])
    three = merged(world, (VA, wall, 0.8, 3.0), (VA, near, 0.9, 0.0), (SR, wall, 0.5, 1.0))
    assert three == pytest.approx([0.0, 1.0 - 0.2 * 0.1 * 0.5, 0.0])


def test_what_is_merged_is_of_a_kind_that_both_may_be(world):
    """A wall that is known beside a doubtful track that may be a wall or a scatter point."""
    wall = world.landmarks(VA)[0]
    given = density(world, (VA, wall, 0.999, 1.0), (VA, wall, 0.3, 0.0), (SP, wall + 9.0, 0.15, 0.0))
    given.track[3] = given.track[2]
    merge_duplicates(given, N, compile_model(FilterParameters(), world.motion, world.bs))
    assert given.weight[1:] == pytest.approx([0.0, 0.999, 0.0])


def test_two_that_were_seen_once_confirm_nothing(world):
    """Two detections of one scan may be two pieces of one mistake."""
    wall = world.landmarks(VA)[0]
    given = density(world, (VA, wall, 0.45, 1.0), (VA, wall, 0.45, 0.0))
    given.detections[1:] = 1.0
    model = compile_model(FilterParameters(), world.motion, world.bs)
    merge_duplicates(given, N, model)
    assert given.weight[1:] == pytest.approx([0.0, model.unconfirmed])


def test_where_one_may_lie_anywhere_two_are_two(world):
    """Two that are known to fifty metres each would merge by their distance alone."""
    given = density(world, (VA, world.landmarks(VA)[0], 0.8, 3.0), (VA, world.landmarks(VA)[0], 0.9, 0.0))
    given.covariance[N:, N:] += 2500.0 * np.eye(6)
    merge_duplicates(given, N, compile_model(FilterParameters(), world.motion, world.bs))
    assert given.weight[1:] == pytest.approx([0.8, 0.9])


def path(world, x=None):
    """The measurement of the first wall's path from the prior's receiver, at ρ of 40 dB, and its R."""
    z = measure(
        world.prior_mean,
        world.landmarks(VA)[:1] if x is None else x,
        np.array([VA]),
        world.bs,
        speed=world.motion.speed,
    )
    return z[0], np.diag(np.square([0.01, 1e-3, 1e-3, 1e-3, 1e-3, 0.01]))


def splintered(world, rng, pieces, apart=0.0):
    """One path in `pieces` that agree in where they come from and not in how they left; the strongest is the last."""
    z, noise = path(world)
    rows = np.tile(z, (pieces, 1)) + rng.standard_normal((pieces, 6)) @ np.linalg.cholesky(noise)
    rows[:, 3:5] = rng.uniform(-1.0, 1.0, (pieces, 2))
    rows[:, 0] += apart * np.arange(pieces)
    return rows, np.tile(noise, (pieces, 1, 1)), np.log(10.0) + np.arange(pieces) * 0.5


def pass_over(world, rows, noise, strength, *landmarks):
    """Mark splinters in place, with a map."""
    given = density(world, *(landmarks or [(VA, world.landmarks(VA)[3], 0.9, 1.0)]))
    pass_over_splinters(
        given, N, Scan(rows, noise, strength, 0, 1e-9, 1.0), compile_model(FilterParameters(), world.motion, world.bs)
    )


def test_what_the_map_explains_is_no_piece(world, rng):
    """The weakest of a family leaves as the known wall says it does: it is read as it is, the strongest of the others freed."""
    rows, noise, strength = splintered(world, rng, 5)
    rows[0] = path(world)[0]
    kept = noise.copy()
    pass_over(world, rows, noise, strength, (VA, world.landmarks(VA)[0], 0.9, 1.0))
    np.testing.assert_array_equal(np.isfinite(strength), [True, False, False, False, True])
    np.testing.assert_array_equal(noise[0], kept[0])
    assert noise[4, 3, 3] > 3.0


def test_paths_of_known_landmarks_in_one_cell_are_no_family(world, rng):
    """Three that agree, two of them of walls in the map: the third is somebody else's, not a piece."""
    rows, noise, strength = splintered(world, rng, 3)
    rows[1:, 3:5] = rng.uniform(2.0, 2.1, (2, 2)) * [1.0, 0.1]
    wall = world.landmarks(VA)[0]
    other = wall + np.array([3.0, 3.0, 0.0])
    noise[:, 0, 0] = noise[:, 5, 5] = 1.0
    noise[:, 1, 1] = noise[:, 2, 2] = 0.1
    rows[0] = path(world)[0]
    rows[1] = measure(world.prior_mean, other, np.array([VA]), world.bs, speed=world.motion.speed)[0]
    told = strength.copy()
    pass_over(world, rows, noise, strength, (VA, wall, 0.9, 1.0), (VA, other, 0.9, 1.0))
    np.testing.assert_array_equal(strength, told)


def test_pieces_of_one_path_are_one_detection_without_departure(world, rng):
    rows, noise, strength = splintered(world, rng, 5)
    other, own = path(world, world.landmarks(VA)[1:2])
    rows, noise, strength = np.vstack([rows, other]), np.concatenate([noise, own[None]]), np.append(strength, 3.0)
    kept, told = noise.copy(), strength.copy()
    pass_over(world, rows, noise, strength)
    np.testing.assert_array_equal(np.isfinite(strength), [False, False, False, False, True, True])
    assert noise[4, 3, 3] > 3.0 and noise[4, 4, 4] > 0.5 and noise[4, 0, 0] == kept[4, 0, 0]
    np.testing.assert_array_equal(noise[5], kept[5])
    for unchanged, strong in ((rows[3:], told[3:]), (rows, np.zeros(6)), (splintered(world, rng, 5, 0.5)[0], told[:5])):
        before, after = strong.copy(), kept[: len(strong)].copy()  # a pair; ρ unknown; apart in delay
        pass_over(world, unchanged, after, strong)
        np.testing.assert_array_equal(strong, before)
        np.testing.assert_array_equal(after, kept[: len(strong)])


def test_splinters_make_no_landmarks_and_the_strongest_updates_its_own(world, rng):
    """Eight pieces of a known wall's path: nothing is born, the wall has been seen."""
    rows, noise, strength = splintered(world, rng, 8)
    given = density(world, (VA, world.landmarks(VA)[0], 0.9, 1.0))
    given.covariance[:N, :N] *= 1e-4
    motion = replace(world.motion, interval=1e-9, process_noise=1e-9 * np.eye(N))
    model = compile_model(FilterParameters(), motion, world.bs)
    after, info = single_step(given, Scan(rows, noise, strength, 10, 1e-9, 1.0), model)
    np.testing.assert_array_equal(after.track, [-1, 0])
    assert after.weight[1] > 0.99 and after.unseen[1] == 0.0
    np.testing.assert_array_equal(info.track[0], [-2] * 7 + [0])


def test_how_many_pieces_were_passed_over_is_told(world, rng):
    """Scan by scan and over a whole run, the same by every filter that passes them over."""
    _, scans = simulate(section_v(steps=4), 3, 0)
    strength = np.full(len(scans.z), 100.0)
    pieces, noise, strong = splintered(world, rng, 5)
    at = int(scans.offsets[2])
    scans = replace(
        scans,
        z=np.insert(scans.z, at, pieces, axis=0),
        covariance=np.insert(scans.covariance, at, noise, axis=0),
        snr=np.insert(strength, at, np.exp(strong)),
        offsets=scans.offsets + 5 * (np.arange(5) >= 3),
        anchor=np.zeros(len(scans.z) + 5, dtype=np.int64),
        label=None,
    )
    problem = build.told(section_v(steps=4))
    for name in ("joint", "mixture", "smoother"):
        np.testing.assert_array_equal(run(problem, scans, FILTERS[name]())[1].passed_over, [0, 0, 4, 0])
    np.testing.assert_array_equal(
        run_steps(FILTERS["joint"](), problem, scans, np.random.default_rng(0))[1].passed_over, [0, 0, 4, 0]
    )


def test_what_was_seen_once_is_not_reported(world):
    """A detection far from everything is born with an existence below one half; a second one confirms it."""
    z, noise = path(world)
    model = compile_model(FilterParameters(), replace(world.motion, process_noise=1e-6 * np.eye(N)), world.bs)
    given = density(world, (VA, world.landmarks(VA)[3], 0.9, 1.0))
    given.covariance[:N, :N] *= 1e-4
    for k, most in enumerate((0.5, 1.0)):
        scan = Scan(z[None], noise[None], np.full(1, np.log(1e4)), 10 + k, 1e-9, 1e-6)
        given, _ = single_step(given, scan, model)
        born = given.weight[given.track == 10].sum()
        assert most - 0.1 < born < most
