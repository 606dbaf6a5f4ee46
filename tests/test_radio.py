"""Traced paths as signal parameters: frames, clock bias and link budget against independent formulas."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.config.scenario import load
from dopslam.errors import ConfigError
from dopslam.models.measurement import SP, VA, measure
from dopslam.pipeline import link as radio
from dopslam.pipeline.stages import synthesize_snapshot
from dopslam.raytracing.images import reflected_paths, scattered_paths, zenith_azimuth
from dopslam.records import SPEED_OF_LIGHT, Paths, Track
from estimation import PathTable, snr


def one_step(geometry, velocity, carrier):
    theta_t, phi_t = zenith_azimuth(geometry.departure)
    theta_r, phi_r = zenith_azimuth(geometry.arrival)
    count = len(geometry.length)
    return Paths(
        offsets=np.array([0, count]), landmark=np.zeros(count, int), a=np.full(count, 1e-6 + 0j),
        tau=geometry.length / SPEED_OF_LIGHT, theta_t=theta_t, phi_t=phi_t, theta_r=theta_r, phi_r=phi_r,
        doppler=geometry.radial_velocity(velocity) * carrier / SPEED_OF_LIGHT,
        vertex_offsets=np.arange(count + 1), vertices=geometry.vertices[:, 0],
    )  # fmt: skip


@pytest.mark.parametrize("kind", [VA, SP])
def test_path_parameters_are_the_measurement_model(kind):
    """Image method → frames → estimator's parameters must equal h(x, s) of eqs. (3)–(12)."""
    scenario = load("ring_road")
    bs = np.array(scenario.base_station.position)
    state = np.array([31.0, -52.0, 2.3, 300.0])
    position = np.array([[31.0, -52.0, 0.0]])
    velocity = 22.22 * np.array([[np.cos(2.3), np.sin(2.3), 0.0]])
    if kind == VA:
        landmark = np.array([200.0, 0.0, 40.0])
        geometry = reflected_paths(bs, position, np.array([[[1.0, 0.0, 0.0]]]), np.array([[100.0]]))
    else:
        landmark = np.array([99.0, 0.0, 10.0])
        geometry = scattered_paths(bs, position, landmark[None])
    track = Track(np.zeros(1), position, state[2:3], velocity, state[3:4], state)
    paths = one_step(geometry, velocity, scenario.radio.carrier_frequency)
    table = radio.path_table(scenario, track, paths, 0)
    found = table.vector[0] * [SPEED_OF_LIGHT, 1, 1, 1, 1, 1]
    assert found == pytest.approx(measure(state, landmark, kind, bs, speed=22.22), rel=1e-9, abs=1e-9)


def test_the_base_stations_yaw_turns_departures_only():
    scenario = load("ring_road", ["base_station.yaw_deg=30"])
    plain = load("ring_road")
    position = np.array([[31.0, -52.0, 0.0]])
    geometry = scattered_paths(np.array([0, 0, 40.0]), position, np.array([[99.0, 0.0, 10.0]]))
    track = Track(np.zeros(1), position, np.zeros(1), np.zeros((1, 3)), np.zeros(1), np.zeros(4))
    paths = one_step(geometry, np.zeros((1, 3)), 28e9)
    turned, straight = (radio.path_table(s, track, paths, 0).vector[0] for s in (scenario, plain))
    assert (straight - turned)[3] == pytest.approx(np.pi / 6)
    assert np.delete(straight - turned, 3) == pytest.approx(0)


def test_the_link_budget_is_the_one_stated_in_the_scenario():
    """ρ = P + 20 log₁₀|a| + 149.3 dB on average over directions (random beams, isotropic elements)."""
    scenario = load("ring_road")
    rng = np.random.default_rng(5)
    direction = rng.normal(size=(300, 3))
    theta, phi = zenith_azimuth(direction / np.linalg.norm(direction, axis=1, keepdims=True))
    model, amplitude = radio.signal_model(scenario), 1e-6 * radio.pilot_amplitude(scenario)
    rho = [
        snr(
            model,
            PathTable([1e-6], [[0.1, 0.2]], [[az, np.pi / 2 - el]], [3.0], [amplitude]),
            radio.noise_variance(scenario),
        )
        for el, az in zip(theta, phi, strict=True)
    ]
    assert 10 * np.log10(np.mean(rho)) == pytest.approx(-2 - 120 + 149.3, abs=0.3)


def test_delay_and_doppler_are_unambiguous_where_the_scene_needs_them():
    model = radio.signal_model(load("ring_road"))
    assert model.waveform.max_delay * SPEED_OF_LIGHT > 600
    assert np.prod(model.shape) <= 2_000_000


def test_beams_that_the_array_cannot_form_are_refused():
    with pytest.raises(ConfigError, match="planar"):
        radio.signal_model(load("ring_road", ["radio.beams.kind=dft", "radio.beams.beams=32"]))
    with pytest.raises(ConfigError, match="32"):
        radio.signal_model(load("ring_road", ["radio.beams.kind=antenna"]))
    assert radio.signal_model(load("ring_road", ["radio.beams.kind=antenna", "radio.beams.beams=32"])).shape[1] == 256


def test_element_patterns_and_subbands_come_from_the_scenario():
    patch = radio.signal_model(load("ring_road", ["base_station.array.pattern=cosine", "radio.subbands=8"]))
    assert patch.subbands == 8
    ahead = patch.transmitter.steering(np.array([[1.0, 0.0, 0.0]]))[0]
    assert abs(ahead[0]) == pytest.approx(1.0)  # the first column looks along +x,
    assert abs(ahead[8]) == pytest.approx(0.0, abs=1e-12)  # the ninth away from it
    dipole = radio.signal_model(load("ring_road", ["receiver.array.pattern=dipole"]))
    assert np.abs(dipole.receiver.steering(np.array([[0.0, 0.6, 0.8]]))) == pytest.approx(0.6)


def test_a_staggered_comb_moves_while_a_beam_is_held():
    model = radio.signal_model(load("ring_road", ["radio.stagger=prs", "radio.beams.sweeps=2"]))
    offsets = np.asarray(model.schedule.offsets)
    assert model.shape[1] == 16 * 2 * 4 and np.all(np.diff(model.schedule.precoder_index.reshape(-1, 4)) == 0)
    # Comb 4 at 120 kHz: shifts 0, 2, 1, 3 about the middle.
    assert offsets[:8] / 120e3 == pytest.approx([-1.5, 0.5, -0.5, 1.5] * 2)
    assert model.max_delay == pytest.approx(1 / 120e3)
    given = radio.signal_model(load("ring_road", ["radio.stagger=[0,2]"]))
    assert given.max_delay == pytest.approx(1 / 240e3) and given.shape[1] == 16 * 8 * 2


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["radio.stagger=prs", "radio.comb=5"], "needs comb = 2, 4, 6, 12"),
        (["radio.stagger=[0,4]"], "subcarrier 4 of a comb of 4"),
        (["radio.stagger=prs", "radio.beams.kind=digital"], "does not go with beams.kind"),
        (["radio.stagger=foo"], "radio.stagger"),
    ],
)
def test_a_stagger_that_cannot_be_is_refused(settings, said):
    with pytest.raises(ConfigError, match=said):
        load("ring_road", settings)


def test_impairments_are_keys_that_only_the_signal_knows():
    """The same elements in every snapshot, phases new in each; without them the signal is the same to the bit."""
    quiet = ["source.traced.noise_figure_db=-50"]
    geometry = reflected_paths(
        np.array([0.0, 0.0, 40.0]),
        np.array([[31.0, -52.0, 0.0]] * 2),
        np.array([[[1.0, 0.0, 0.0]]]),
        np.array([[100.0]]),
    )
    velocity = np.tile([20.0, 0.0, 0.0], (2, 1))

    def snapshots(*settings):
        scenario = load("ring_road", [*quiet, *(f"source.traced.impairments.{s}" for s in settings)])
        one = one_step(geometry, velocity, scenario.radio.carrier_frequency)
        both = replace(one, offsets=np.array([0, 1, 2])) if len(one.tau) == 2 else one
        track = Track(np.arange(2.0), np.zeros((2, 3)), np.zeros(2), velocity, np.zeros(2), np.zeros(4))
        return [synthesize_snapshot(scenario, track, both, step, seed=3) for step in range(2)]

    clean, off = snapshots(), snapshots("bits=0")
    assert all(np.array_equal(a, b) for a, b in zip(clean, off, strict=True))
    ratios = [b / a for a, b in zip(clean, snapshots("gain_db=0.5", "phase_deg=5"), strict=True)]
    strong = [np.abs(a) > 0.5 * np.abs(a).max() for a in clean]
    both = strong[0] & strong[1]
    assert np.median(np.abs(ratios[0][both] - 1)) > 0.04 and np.median(np.abs(ratios[0] - ratios[1])[both]) < 0.01
    turned = [np.angle(b / a) for a, b in zip(clean, snapshots("phase_noise_deg=10"), strict=True)]
    steps = [
        np.array([t[:, n][s[:, n]].mean() for n in range(128) if s[:, n].any()])
        for t, s in zip(turned, strong, strict=True)
    ]
    assert 0.1 < np.std(steps[0]) < 0.25 and not np.allclose(steps[0][:5], steps[1][:5], atol=0.02)
    other = [snapshots("gain_db=0.5", f"seed={seed}")[0] for seed in (1, 2)]
    assert not np.allclose(*other, rtol=1e-3, atol=0)
