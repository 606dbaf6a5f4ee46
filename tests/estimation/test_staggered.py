"""Combs that move from symbol to symbol, as PRS and SRS of 5G have: the model, the search beyond the comb's own range, the bound."""

from dataclasses import replace

import numpy as np
import pytest

from estimation import (
    Array,
    Flag,
    ModelError,
    Nomp,
    PathTable,
    Schedule,
    SignalModel,
    crb,
    prs,
    random_phase_beams,
    simultaneous,
    srs,
    sweep,
    synthesize,
    unit_vectors,
    ura,
)
from estimation.estimators.projector import Bases, Projector
from estimation.evaluate import associate
from estimation.scenarios import at_snr
from estimation.signal.algebra import gram, project
from estimation.signal.nr import PRS, SRS

BEAMS = random_phase_beams(6, 12, np.random.default_rng(1))
SQUARE = np.linalg.qr(np.random.default_rng(2).standard_normal((8, 8, 2)) @ [1, 1j])[0]
COMBINERS = np.stack([SQUARE[:, :4], SQUARE[:, 4:]])


def link(kind: str) -> SignalModel:
    rng = np.random.default_rng(3)
    if kind == "prs":
        waveform, stagger = prs(28e9, 120e3, 24, 12)
        return SignalModel(waveform, sweep(BEAMS, 2, 8.92e-6, rng=rng, stagger=stagger), ura(3, 4), ura(2, 4))
    if kind == "srs":
        waveform, stagger = srs(3.5e9, 30e3, 24, 8)
        return SignalModel(waveform, simultaneous(4, 16, 140e-6, stagger), ura(2, 2), ura(2, 4))
    waveform, stagger = prs(28e9, 120e3, 24, 4)
    if kind == "hybrid":
        schedule = sweep(BEAMS, 2, 8.92e-6, rng=rng, stagger=stagger, combiners=COMBINERS)
        return SignalModel(waveform, schedule, ura(3, 4), ura(2, 4))
    once = sweep(np.ones((1, 1)), 4, 8.92e-6, "linear", stagger=stagger, combiners=COMBINERS)
    combined = Schedule(once.times, None, None, once.combiners, once.combiner_index, once.offsets)
    return SignalModel(waveform, combined, ura(2, 2), ura(2, 4))


LINKS = {kind: link(kind) for kind in ("prs", "srs", "hybrid", "combined")}


def drawn(model: SignalModel, rng: np.random.Generator, count: int, decibels=(20.0, 45.0)) -> PathTable:
    """Paths anywhere in the range of all symbols together."""
    ends = [rng.uniform([-1, -0.5], [1, 0.5], (count, 2)) for _ in range(2)]
    delay, speed = rng.uniform(0, 0.98 * model.max_delay, count), rng.uniform(-20, 20, count)
    unit = PathTable(delay, *ends, speed, np.exp(2j * np.pi * rng.random(count)))
    return at_snr(model, unit, 10 ** (rng.uniform(*decibels, count) / 10))


def by_hand(model: SignalModel, paths: PathTable) -> np.ndarray:
    """Signatures (P, K, N, M) of a link without combiners, sample by sample."""
    schedule, waveform = model.schedule, model.waveform
    assert schedule.precoders is not None
    frequency = waveform.frequencies[:, None] + (0 if schedule.offsets is None else schedule.offsets)
    arrival = model.receiver.response(unit_vectors(paths.aoa))[0]
    sent = (model.transmitter.response(unit_vectors(paths.aod))[0].conj() @ schedule.precoders.T)[
        :, schedule.precoder_index
    ]
    turned = np.exp(2j * np.pi * schedule.times / waveform.wavelength * paths.radial_velocity[:, None])
    delayed = np.exp(-2j * np.pi * frequency * paths.delay[:, None, None])
    return (delayed * (sent * turned)[:, None])[..., None] * arrival[:, None, None]


@pytest.mark.parametrize("kind", ["prs", "srs"])
def test_the_pilots_of_a_symbol_are_where_they_are(kind):
    model = LINKS[kind]
    paths = drawn(model, np.random.default_rng(0), 2)
    truth = np.tensordot(paths.gain, by_hand(model, paths), axes=1)
    assert np.allclose(synthesize(model, paths), truth, atol=2e-5 * np.abs(truth).max())


@pytest.mark.parametrize("kind", LINKS)
def test_derivatives_and_projections_allow_for_the_delay_in_both_modes(kind):
    model = LINKS[kind]
    geometry = drawn(model, np.random.default_rng(1), 2).geometry
    blocks, scale = model.evaluate(geometry), model.steps()

    def outer(points):
        first, *rest = (mode[:, 0] for mode in model.evaluate(points)[0])
        for other in rest:
            first = (first[:, :, None] * other[:, None]).reshape(len(first), -1)
        return first

    columns = [outer(geometry)]
    for parameter in range(6):
        step = np.zeros((2, 6))
        step[:, parameter] = 1e-5 * scale[parameter]
        columns.append((outer(geometry.moved(step)) - outer(geometry.moved(-step))) / (2e-5 * scale[parameter]))
    along = np.stack(columns, axis=1)
    expected = np.einsum("pax,qbx->paqb", along.conj(), along)
    size = np.sqrt(np.abs(np.einsum("papa->pa", expected))) + 1e-30
    assert np.allclose(
        gram(model, blocks) / size[:, :, None, None] / size, expected / size[:, :, None, None] / size, atol=1e-6
    )
    rng = np.random.default_rng(2)
    signal = (rng.standard_normal((*model.shape, 2)) @ [1, 1j]).astype(np.complex64)
    expected = np.einsum("pax,x->pa", along.conj(), signal.ravel()) / size
    assert np.allclose(project(model, signal, blocks) / size, expected, atol=1e-4)
    windowed = Projector(model, signal, Bases.build(model)).inner(geometry, blocks)
    assert np.allclose(windowed / size, expected, atol=1e-3)


@pytest.mark.parametrize("kind", LINKS)
def test_paths_beyond_the_range_of_one_comb_are_found_where_they_are(kind):
    model, nees = LINKS[kind], []
    nomp = Nomp(model, false_alarm_rate=1e-4)
    assert model.max_delay > 3.9 * model.waveform.max_delay
    for seed in range(2):
        rng = np.random.default_rng(seed)
        paths = drawn(model, rng, 4)
        assert np.any(paths.delay > model.waveform.max_delay)
        found = nomp.run(synthesize(model, paths, 1.0, rng))
        match = associate(model, found, paths, 1.0)
        assert match.detected.all() and match.false == 0
        nees += list(match.nees / 6)
    assert 0.3 < np.mean(nees) < 2.5


@pytest.mark.mc
@pytest.mark.parametrize("kind", LINKS)
def test_accuracy_is_that_of_the_bound(kind):
    model, nees, ratio = LINKS[kind], [], []
    nomp = Nomp(model, false_alarm_rate=1e-3)
    for seed in range(100, 125):
        rng = np.random.default_rng(seed)
        paths = drawn(model, rng, 4)
        match = associate(model, nomp.run(synthesize(model, paths, 1.0, rng)), paths, 1.0)
        nees += list(match.nees / 6)
        ratio += list(match.error**2 / np.diagonal(match.bound, axis1=1, axis2=2))
    assert len(nees) > 90 and 0.85 < np.mean(nees) < 1.2 and 0.88 < np.sqrt(np.mean(ratio)) < 1.12


def test_without_the_stagger_delays_come_back_in():
    model = LINKS["prs"]
    held = replace(model, schedule=replace(model.schedule, offsets=None))
    late = PathTable([model.waveform.max_delay + 3e-7], [[0.2, 0.1]], [[-0.4, 0.2]], [5.0], [0.3])
    rng = np.random.default_rng(0)
    far, near = (Nomp(m, false_alarm_rate=1e-4).run(synthesize(m, late, 1.0, rng)) for m in (model, held))
    assert far.delay == pytest.approx(late.delay, abs=3e-8) and near.delay == pytest.approx([3e-7], abs=3e-8)


def test_a_shorter_search_keeps_to_it():
    model = LINKS["prs"]
    nomp = Nomp(model, false_alarm_rate=1e-4, max_delay=1.5 * model.waveform.max_delay)
    rng = np.random.default_rng(5)
    paths = replace(drawn(model, rng, 2), delay=np.array([0.3, 1.2]) * model.waveform.max_delay)
    found = nomp.run(synthesize(model, paths, 1.0, rng))
    assert associate(model, found, paths, 1.0).detected.all() and not np.any(found.flags & Flag.EDGE_OF_VIEW)


@pytest.mark.parametrize(("make", "table", "combs"), [(prs, PRS, (2, 4, 6, 12)), (srs, SRS, (2, 4, 8))])
def test_symbols_of_a_resource_cover_every_subcarrier(make, table, combs):
    assert tuple(table) == combs
    for size in combs:
        waveform, stagger = make(3.5e9, 30e3, 24, size)
        pilots = np.sort((waveform.frequencies + stagger[:, None]).ravel()) / 30e3
        assert np.allclose(pilots, np.arange(288) - 143.5)
        assert waveform.reach(stagger) == pytest.approx(1 / 30e3)
        # Another start is the same comb turned.
        other = make(3.5e9, 30e3, 24, size, offset=1)[1]
        assert np.allclose(np.sort(other), np.sort(stagger))
        assert other[0] == pytest.approx(stagger[0] + 30e3)
    few, stagger = srs(3.5e9, 30e3, 24, 8, symbols=4)
    assert few.reach(stagger) == pytest.approx(1 / 60e3)


@pytest.mark.parametrize(
    ("make", "options", "said"),
    [
        (prs, {"comb_size": 8}, "2, 4, 6, 12"),
        (srs, {"comb_size": 8, "symbols": 2}, "4, 8, 12 symbols"),
        (prs, {"comb_size": 6, "offset": 6}, "offset"),
        (srs, {"comb_size": 8, "blocks": 1}, "whole number"),
    ],
)
def test_what_the_standard_does_not_have_is_refused(make, options, said):
    with pytest.raises(ModelError, match=said):
        make(3.5e9, 30e3, **({"blocks": 24} | options))


def test_schedules_that_no_search_can_take_are_refused_with_the_remedy():
    waveform, stagger = srs(3.5e9, 30e3, 8, 4)
    digital = SignalModel(waveform, Schedule(np.arange(4) * 1e-4, offsets=stagger), ura(2, 2), ura(2, 2))
    with pytest.raises(ModelError, match=r"estimation\.simultaneous"):
        Nomp(digital)
    with pytest.raises(ModelError, match="frequency in Hz for each of 4 symbols"):
        Schedule(np.arange(4) * 1e-4, offsets=stagger[:3])
    apart = sweep(np.ones((1, 1)), 4, 1e-4, "linear", combiners=COMBINERS)
    apart = replace(apart, offsets=np.resize(stagger, apart.symbols))
    with pytest.raises(ModelError, match="same place for all combiners"):
        Nomp(SignalModel(waveform, apart, Array(np.zeros((1, 3))), ura(2, 4)))


def test_shifting_all_pilots_alike_changes_the_bound_of_nothing():
    """A constant shift is another place for the phase of the gain."""
    model = LINKS["prs"]
    paths = drawn(model, np.random.default_rng(4), 1)
    shifted = replace(model, schedule=replace(model.schedule, offsets=np.asarray(model.schedule.offsets) + 1e5))
    assert np.allclose(crb(shifted, paths, 1.0), crb(model, paths, 1.0), rtol=1e-6)
