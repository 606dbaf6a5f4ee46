"""PCRB against the open reference, a Kalman covariance, and the paper's claims."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dopslam.evaluate import bounds
from dopslam.evaluate.bounds import detection_mask, doppler_contribution, pcrb, situation_bound
from dopslam.models.measurement import SR, VA, jacobians, seen_noise
from dopslam.models.motion import transition_jacobian
from dopslam.simulate.world import noise_of, nominal_track, section_v, simulate, unknown_motion

REFERENCE = Path(__file__).parent / "data" / "pcrb_open.csv"
COLUMNS = ["LEB_VA0", "LEB_VA1", "LEB_VA2", "LEB_VA3", "LEB_SP0", "LEB_SP1", "LEB_SP2", "LEB_SP3"]


def reference(visibility, doppler):
    with REFERENCE.open() as file:
        rows = [r for r in csv.DictReader(file) if r["vis"] == visibility and (r["sigma_d"] != "none") == doppler]
    return {name: np.array([float(r[name]) for r in rows]) for name in ["PEB", "HEB_rad", "CEB", *COLUMNS]}


@pytest.mark.parametrize("doppler", [True, False])
@pytest.mark.parametrize(("name", "visibility"), [("all", None), ("fov50", 50.0)])
def test_matches_the_open_reference(name, visibility, doppler):
    expected = reference(name, doppler)
    bound = situation_bound(section_v(0.1), doppler=doppler, visibility=visibility)
    for column, value in (("PEB", bound.peb), ("HEB_rad", bound.heb), ("CEB", bound.ceb)):
        np.testing.assert_allclose(value, expected[column], rtol=1e-4)
    for j, column in enumerate(COLUMNS):
        np.testing.assert_allclose(bound.leb[:, 1 + j], expected[column], rtol=1e-4)


def test_equals_the_kalman_covariance():
    """On a linearized model with every landmark given a prior, J⁻¹ is the Kalman filter's covariance."""
    world = section_v(0.1)
    states = nominal_track(world)
    covariance, _, _ = noise_of(world, states)
    rng = np.random.default_rng(1)
    detected = rng.random((world.steps, 9)) < 0.6
    detected[0] = True
    bound = situation_bound(world, detected=detected)
    by_state, by_landmark = jacobians(states[:, None], world.position, world.kind, world.bs, speed=world.motion.speed)
    p = np.zeros((28, 28))
    p[:4, :4] = world.prior_covariance
    p[4:, 4:] = 1e7 * np.eye(24)
    previous = np.vstack([world.prior_mean, states[:-1]])
    for k in range(world.steps):
        f = np.eye(28)
        f[:4, :4] = transition_jacobian(previous[k], world.motion)
        p = f @ p @ f.T
        p[:4, :4] += world.motion.process_noise
        for i in np.flatnonzero(detected[k]):
            h = np.zeros((6, 28))
            h[:, :4] = by_state[k, i]
            if i:
                h[:, 1 + 3 * i : 4 + 3 * i] = by_landmark[k, i]
            gain = np.linalg.solve(h @ p @ h.T + covariance[k, i], h @ p).T
            rest = np.eye(28) - gain @ h
            p = rest @ p @ rest.T + gain @ covariance[k, i] @ gain.T
    np.testing.assert_allclose(np.diag(bound.covariance[-1]), np.diag(p[:4, :4]), rtol=1e-5)
    np.testing.assert_allclose(bound.leb[-1, 1:] ** 2, np.diag(p)[4:].reshape(8, 3).sum(1), rtol=1e-4)


def test_more_information_never_hurts():
    world = section_v(0.1)
    with_doppler, without = situation_bound(world), situation_bound(world, doppler=False)
    sharper = situation_bound(section_v(0.01))
    for better, worse in ((with_doppler, without), (sharper, with_doppler)):
        assert (better.peb < worse.peb).all() and (better.heb < worse.heb).all() and (better.ceb < worse.ceb).all()


def test_infinite_doppler_noise_is_no_doppler():
    np.testing.assert_allclose(
        situation_bound(section_v(1e6)).peb, situation_bound(section_v(0.1), doppler=False).peb, rtol=1e-8
    )


def test_dropping_the_cross_terms_is_optimistic(monkeypatch):
    """The paper's block-diagonal claim would give a PEB of 0.068 m instead of 0.173 m at the last step."""
    assert situation_bound(section_v(0.1)).peb[-1] == pytest.approx(0.173, abs=1e-3)
    full = bounds.measurement_information

    def block_diagonal(*args, **options):
        aa, ab, bb = full(*args, **options)
        return aa, 0 * ab, bb

    monkeypatch.setattr(bounds, "measurement_information", block_diagonal)
    assert situation_bound(section_v(0.1)).peb[-1] == pytest.approx(0.068, abs=1e-3)


def test_order_of_landmarks_and_undetected_ones_do_not_matter():
    world = section_v(0.1)
    states, scans = simulate(world, 3, 0)
    mask = detection_mask(scans.label, scans.offsets, 9)
    bound = situation_bound(world, states, detected=mask)
    order = np.array([0, 8, 3, 5, 1, 2, 7, 6, 4])
    turned = replace(world, kind=world.kind[order], position=world.position[order])
    again = situation_bound(turned, states, detected=mask[:, order])
    np.testing.assert_allclose(again.peb, bound.peb, rtol=1e-9)
    np.testing.assert_allclose(again.leb, bound.leb[:, order], rtol=1e-7)
    assert np.isnan(bound.leb[0, ~mask[0]]).all()


def test_unknown_motion_costs_little_with_doppler():
    known, unknown = section_v(0.1), unknown_motion(section_v(0.1))
    ratio = situation_bound(unknown).peb.mean() / situation_bound(known).peb.mean()
    assert 1.0 < ratio < 1.2
    bound = situation_bound(unknown)
    assert np.sqrt(bound.squared()["speed"][-1]) < 0.1


def test_no_process_noise_needs_no_inverse():
    world = section_v(0.1)
    still = replace(world, motion=replace(world.motion, process_noise=np.zeros((4, 4))))
    bound = situation_bound(still)
    assert (np.diff(bound.heb) <= 1e-12).all()


def test_decomposition_adds_up():
    world = section_v(0.1)
    parts = doppler_contribution(world)
    assert (parts.position >= -1e-9).all() and (parts.heading >= -1e-9).all() and (parts.landmark[:, 1:] >= 0).all()
    states = nominal_track(world)
    velocity = 22.22 * np.column_stack([-np.sin(states[:, 2]), np.cos(states[:, 2]), np.zeros(40)])
    arrival = world.position[1] - np.column_stack([states[:, :2], np.zeros(40)])
    q = arrival / np.linalg.norm(arrival, axis=1)[:, None]
    np.testing.assert_allclose(parts.heading[:, 1], np.einsum("ki,ki->k", velocity, q) ** 2 / 0.01, rtol=1e-6)


def test_mismatched_sizes_are_refused():
    world = section_v()
    with pytest.raises(Exception, match="must agree"):
        pcrb(
            np.zeros((3, 6)),
            np.zeros(6),
            np.eye(6),
            world.motion,
            world.position,
            world.kind,
            np.eye(6),
            1.0,
            world.bs,
        )


def test_a_second_reflection_tells_what_an_anchor_tells_whose_departure_was_not_measured():
    """Unmeasured rows have infinite variance; the type's wide variances give the same bound to the last digit."""
    world = section_v(0.1)
    states = nominal_track(world)[:6]
    kind, position = world.kind[:4], world.position[:4]
    noise = np.diag(world.noise.std**2)
    noise[0, 3] = noise[3, 0] = 0.3 * np.sqrt(noise[0, 0] * noise[3, 3])
    second = kind.copy()
    second[2:] = SR
    unmeasured = np.where(np.isin(np.arange(6), (3, 4)), np.inf, np.diag(noise))
    bounds_of = []
    for kinds, covariance in (
        (second, seen_noise(np.broadcast_to(noise, (4, 6, 6)), second)),
        (kind, np.array([noise, noise, np.diag(unmeasured), np.diag(unmeasured)])),
    ):
        assert set(kind[2:]) == {VA}
        bounds_of.append(
            pcrb(states, world.prior_mean, world.prior_covariance, world.motion, position, kinds, covariance,
                 np.ones(4), world.bs)
        )  # fmt: skip
    np.testing.assert_allclose(bounds_of[0].covariance, bounds_of[1].covariance, rtol=1e-9)
    np.testing.assert_allclose(bounds_of[0].landmark[-1, 1:], bounds_of[1].landmark[-1, 1:], rtol=1e-9)
