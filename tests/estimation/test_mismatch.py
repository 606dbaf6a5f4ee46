"""Hardware that is not quite the model, and paths outside the searched region: no ghosts, and it is said."""

from dataclasses import replace

import numpy as np
import pytest

from estimation import (
    EadfArray,
    Flag,
    Impairments,
    ModelError,
    Nomp,
    PathTable,
    SignalModel,
    comb,
    digital,
    synthesize,
    ura,
    white_noise,
)
from estimation.estimators.beyond import beyond
from estimation.estimators.clock import Clock
from estimation.estimators.floor import Floor
from estimation.estimators.parts import parts_of
from estimation.estimators.projector import Projector
from estimation.estimators.refine import joint_fit
from estimation.evaluate import associate
from estimation.random_links import SEARCHED, random_link, random_paths
from estimation.scenarios import FRONT, Draw, at_snr, draw_paths

OFF = {
    "positions": Impairments(position=0.01),
    "gains": Impairments(gain_db=0.5, phase_deg=5),
    "phase noise": Impairments(phase_noise_deg=3),
    "strong phase noise": Impairments(phase_noise_deg=10),
}


@pytest.fixture(scope="module")
def link() -> SignalModel:
    return SignalModel(comb(28e9, 6.25e6, 64), digital(16, 125e-6), ura(2, 4), ura(2, 4))


@pytest.fixture(scope="module")
def nomp(link) -> Nomp:
    return Nomp(link, threshold=25.0, arrival_view=FRONT, departure_view=FRONT)


def drawn(link, seed, strongest=52.0):
    """Five paths, the first strong."""
    rng = np.random.default_rng(seed)
    decibel = np.r_[strongest, rng.uniform(25, 40, 4)]
    return at_snr(link, draw_paths(link, rng, Draw(paths=5, separation=1.5)), 10 ** (decibel / 10)), rng


@pytest.mark.parametrize("name", OFF)
def test_hardware_that_is_a_little_off_makes_no_ghosts(link, nomp, name):
    false, found, strong = [], [], []
    for seed in range(4):
        paths, rng = drawn(link, seed)
        match = associate(link, nomp.run(OFF[name].signal(link, paths, 1.0, rng, seed)), paths, 1.0)
        false.append(match.false)
        found.append(match.detected.mean())
        strong.append(match.detected[0])
    assert np.mean(false) <= 1 and np.mean(found) >= 0.75


def test_without_the_floor_there_would_be_ghosts(link, nomp, monkeypatch):
    monkeypatch.setattr(Nomp, "_credible", lambda self, data, lin, variance, found, statistic: (found, statistic))
    paths, rng = drawn(link, 0)
    limited = replace(nomp, max_paths=12)
    assert len(limited.run(OFF["positions"].signal(link, paths, 1.0, rng, 0))) >= 8


def ghosts_of_swept_links(seeds) -> int:
    """With elements off by a hundredth of a wavelength, on random links that sweep beams."""
    total = 0
    for seed in seeds:
        rng = np.random.default_rng(np.random.SeedSequence(2, spawn_key=(seed,)))
        model = random_link(rng)
        paths = random_paths(model, rng)
        lead = at_snr(model, paths.take([0]), [1e5])
        paths = replace(paths, gain=np.r_[lead.gain, paths.gain[1:]])
        nomp = Nomp(model, max_speed=SEARCHED, threshold=27.0, max_paths=14)
        found = nomp.run(OFF["positions"].signal(model, paths, 1.0, rng, seed))
        total += max(len(found) - len(paths), 0)
    return total


@pytest.mark.mc
def test_beams_that_are_off_in_every_sweep_alike_make_no_ghosts(monkeypatch):
    """Their error is all at the path's speed, where it stands higher than over all symbols."""
    seeds = (3, 6)
    few = ghosts_of_swept_links(seeds)
    monkeypatch.setattr(Floor, "_parts", [])
    many = ghosts_of_swept_links(seeds)
    assert few == 0 and many >= 3


def test_the_given_model_error_keeps_away_what_it_could_explain(link, nomp):
    paths, rng = drawn(link, 3)
    careful = replace(nomp, model_error_db=-30.0)
    found = careful.run(synthesize(link, paths, 1.0, rng))
    sharp = nomp.run(synthesize(link, paths, 1.0, np.random.default_rng(0)))
    # At 52 dB an error of -30 dB outweighs the noise more than a hundred times.
    ratio = found.covariance[0, 0, 0] / sharp.covariance[0, 0, 0]
    assert ratio == pytest.approx(1 + 1e-3 * sharp.snr[0], rel=0.2)


@pytest.mark.parametrize(("name", "value"), [("radial_velocity", 40.0), ("radial_velocity", -33.0)])
def test_a_path_faster_than_what_is_searched_is_one_flagged_path(link, nomp, name, value):
    paths, rng = drawn(link, 5)
    column = getattr(paths, name).copy()
    column[0] = value
    paths = replace(paths, **{name: column})
    found = nomp.run(synthesize(link, paths, 1.0, rng))
    match = associate(link, found, paths, 1.0)
    assert match.detected.all() and match.false == 0
    fast = np.abs(found.radial_velocity) > 25
    assert fast.sum() == 1 and found.flags[fast][0] & Flag.EDGE_OF_VIEW


@pytest.mark.parametrize("off", [0.5, 1.5])
def test_a_speed_that_one_outside_looks_like_is_inside(off):
    """Symbols 160 us apart cannot tell 24 m/s, which is searched, from -43, which is not; 33 is outside either way."""
    model = SignalModel(comb(28e9, 6.25e6, 32), digital(24, 160e-6), ura(2, 4), ura(2, 4))
    alias = model.waveform.wavelength / 160e-6
    for speed, inside in ((24.0, True), (33.0, False)):
        path = PathTable([5e-8], [[0.2, 0.1]], [[-0.3, 0.2]], [speed], [3.0])
        signal = synthesize(model, path, 1.0, np.random.default_rng(0))
        # A point of the grid beside the peak holds less than any peak outside.
        candidate = replace(path, radial_velocity=np.array([speed - off * alias / 24])).geometry
        energy = np.abs(np.vdot(synthesize(model, candidate.table([1])), signal)) ** 2 / signal.size
        grids = candidate.arrival, candidate.departure
        found = beyond(Floor(Projector(model, signal, None), None, 1.0), candidate, energy, 1.0, 25.0, grids)
        if inside:
            assert found is None
        else:
            assert found is not None and abs((found.speed[0] - speed + alias / 2) % alias - alias / 2) < 1


@pytest.mark.parametrize(("seed", "kind"), [(3, "combined"), (0, "hybrid")])
def test_a_fast_path_is_found_in_its_direction_where_beams_or_combiners_turn_it_into_a_course(seed, kind):
    """Inside the searched speeds its side lobes are as strong in other directions: 20 ghosts."""
    rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(seed,)))
    model = random_link(rng)
    paths = random_paths(model, rng)
    assert model.schedule.combiners is not None and (model.schedule.precoders is not None) == (kind == "hybrid")
    lead = at_snr(model, paths.take([0]), [1e5])
    paths = replace(
        paths, gain=np.r_[lead.gain, paths.gain[1:]], radial_velocity=np.r_[40.0, paths.radial_velocity[1:]]
    )
    found = Nomp(model, max_speed=SEARCHED, threshold=27.0).run(synthesize(model, paths, 1.0, rng))
    assert associate(model, found, paths, 1.0).detected.all() and len(found) == len(paths)


@pytest.mark.parametrize(("seed", "name"), [(0, "gains"), (6, "strong phase noise")])
def test_weak_paths_are_found_behind_the_errors_of_strong_ones(seed, name):
    """Errors fill the list of candidates: two of five paths were missed, or three ghosts believed for being too fast."""
    rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(seed,)))
    model = random_link(rng)
    paths = random_paths(model, rng)
    lead = at_snr(model, paths.take([0]), [1e5])
    paths = replace(paths, gain=np.r_[lead.gain, paths.gain[1:]])
    nomp = Nomp(model, max_speed=SEARCHED, threshold=27.0)
    found = nomp.run(OFF[name].signal(model, paths, 1.0, rng, seed))
    match = associate(model, found, paths, 1.0, gate=400)
    assert match.detected.all() and len(found) <= len(paths) + 1


def test_errors_of_elements_lie_in_the_part_of_their_end():
    """Behind combiners and beams, too: a few dimensions of the mode, the same in every sweep."""
    rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(0,)))
    model = random_link(rng)
    path = at_snr(model, random_paths(model, rng).take([0]), [1e5])
    built = OFF["positions"].hardware(model, rng)
    mode = model.bands[0].modes[1]
    strong = mode.vector(path.geometry)[0]
    one_end = replace(built, transmitter=model.transmitter), replace(built, receiver=model.receiver)
    beams, outputs = (len(np.unique(i)) for i in (mode.precoder_index, mode.combiner_index))
    for end, size in zip(one_end, (outputs * mode.ports, beams), strict=True):
        wrong = end.bands[0].modes[1].vector(path.geometry)[0] - strong
        part = next(p for p in parts_of(mode, 3) if p.size == size)
        inside = np.linalg.norm(part.sums(wrong, strong)) ** 2 / np.linalg.norm(wrong) ** 2
        assert inside == pytest.approx(1, abs=1e-9) and part.size < mode.size / 4


def test_a_path_later_than_what_is_searched_is_one_flagged_path(link):
    nomp = Nomp(link, threshold=25.0, arrival_view=FRONT, departure_view=FRONT, max_delay=100e-9)
    paths, rng = drawn(link, 6)
    paths = replace(paths, delay=np.r_[150e-9, np.linspace(20e-9, 90e-9, 4)])
    found = nomp.run(synthesize(link, paths, 1.0, rng))
    match = associate(link, found, paths, 1.0)
    assert match.detected.all() and match.false == 0
    late = found.delay > 110e-9
    assert late.sum() == 1 and found.flags[late][0] & Flag.EDGE_OF_VIEW


def test_a_search_that_ends_early_says_so_and_keeps_the_strongest(link, nomp):
    paths, rng = drawn(link, 7)
    signal = synthesize(link, paths, 1.0, rng)
    few = replace(nomp, max_paths=2).run(signal)
    assert np.all(few.flags & Flag.LIMITED) and 2 <= len(few) < 5
    assert not np.any(nomp.run(signal).flags & Flag.LIMITED)
    none = replace(nomp, max_seconds=0.0).run(signal)
    assert len(none) == 0


def test_time_that_is_up_ends_fits_and_what_follows_a_search_too(link, nomp, monkeypatch):
    """The same limit holds for the search anew once the noise of the ports is known."""
    paths, rng = drawn(link, 7)
    signal = synthesize(link, paths, 1.0, rng)
    data = Projector(link, signal, None)
    start = paths.geometry.moved(np.tile([2e-10, 0, 0, 0, 0, 0.1], (len(paths), 1)))
    moved, kept = (joint_fit(data, start, 1.0, clock=Clock.of(limit)) for limit in (None, 0.0))
    assert moved.explained > kept.explained and np.array_equal(kept.geometry.delay, start.delay)
    limits = []
    whole = Nomp.run
    monkeypatch.setattr(Nomp, "run", lambda self, *a, **k: (limits.append(self.max_seconds), whole(self, *a, **k))[1])
    response = link.receiver.response(np.array([[0.8, 0.6, 0.0]]))[0][0]
    noise = white_noise((*link.shape[:2], 1, link.shape[3]), 30.0, rng) * response[:, None]
    replace(nomp, max_seconds=1000.0).run((signal + noise).astype(np.complex64))
    assert len(limits) == 2 and limits[0] == 1000.0 and 0 <= limits[1] < 1000.0


def test_impairments_are_switches_with_seeds(link):
    paths, _ = drawn(link, 1)
    clean = synthesize(link, paths, 1.0, np.random.default_rng(0))
    plain = Impairments().signal(link, paths, 1.0, np.random.default_rng(0), 3)
    assert np.allclose(plain, clean, atol=1e-4 * np.abs(clean).max())
    for one in (
        *OFF.values(),
        Impairments(phase_walk_deg=2),
        Impairments(frequency_offset=100.0),
        Impairments(iq_gain_db=0.5, iq_phase_deg=3),
        Impairments(bits=4),
    ):
        first, again, other = (one.signal(link, paths, 1.0, np.random.default_rng(0), seed) for seed in (3, 3, 4))
        assert np.array_equal(first, again) and not np.allclose(first, clean, atol=1e-3)
        drawn_errors = one.frequency_offset == one.iq_gain_db == one.bits == 0
        assert drawn_errors != np.array_equal(first, other)
    with pytest.raises(ModelError, match="known positions"):
        Impairments(position=0.01).hardware(replace(link, receiver=EadfArray.from_array(ura(2, 4), 16)), None)


def test_a_frequency_offset_adds_one_speed_to_all(link, nomp):
    paths, rng = drawn(link, 2)
    found = nomp.run(Impairments(frequency_offset=100.0).signal(link, paths, 1.0, rng))
    shifted = replace(paths, radial_velocity=paths.radial_velocity + 100.0 * link.waveform.wavelength)
    assert associate(link, found, shifted, 1.0).detected.all()
