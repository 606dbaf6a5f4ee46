"""Arrays, patterns, measured arrays and schedules."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimation import (
    Array,
    CosinePattern,
    DipolePattern,
    EadfArray,
    ModelError,
    Nomp,
    PathTable,
    Schedule,
    ScheduleWarning,
    SignalModel,
    View,
    ambiguity,
    antenna_switching,
    check_schedule,
    comb,
    cylinder,
    dft_beams,
    outward,
    random_phase_beams,
    sweep,
    synthesize,
    ula,
    unit_vectors,
    ura,
)
from estimation.estimators.report import turned
from estimation.evaluate import associate
from estimation.scenarios import at_snr
from estimation.signal.directions import displaced, sphere, tangents

TURNED = Rotation.from_euler("zy", [40, 20], degrees=True)


@pytest.mark.parametrize(
    "array",
    [
        cylinder(8, 2),
        cylinder(8, 2, orientation=TURNED),
        Array(cylinder(8, 2).positions, outward(cylinder(8, 2).positions, 1.5), TURNED),
        ura(2, 3, pattern=CosinePattern()),
        ura(2, 2, pattern=DipolePattern()),
        EadfArray.from_array(cylinder(8, 2), 24),
        EadfArray(EadfArray.from_array(ura(2, 3), 16).coefficients, TURNED),
    ],
    ids=["cylinder", "turned", "patch cylinder", "patches", "dipoles", "measured", "measured, turned"],
)
def test_derivatives_match_finite_differences(array):
    directions = sphere(40)
    directions = directions[np.abs(directions[:, 2]) < 0.97]
    # Off the edge of a cosine pattern, where the amplitude has a kink.
    basis = tangents(directions)
    value, derivative = array.response(directions, basis)
    assert value.shape == (len(directions), array.elements)
    for t in range(2):
        step = np.zeros((len(directions), 2))
        step[:, t] = 1e-6
        numeric = (
            array.response(displaced(directions, step))[0] - array.response(displaced(directions, -step))[0]
        ) / 2e-6
        smooth = np.abs(numeric - derivative[:, t]).max(axis=1)
        assert np.median(smooth) < 1e-7 and np.mean(smooth < 1e-5) > 0.9


def test_a_measured_array_reproduces_what_was_measured():
    array = cylinder(16, 2)
    measured = EadfArray.from_array(array, 40)
    directions = sphere(200)
    assert np.abs(measured.response(directions)[0] - array.response(directions)[0]).max() < 1e-6
    with pytest.raises(ModelError, match="responses"):
        EadfArray.from_samples(np.zeros((3, 10, 10)))


def test_cylinder_radii_are_those_of_half_wavelength_chords():
    assert np.hypot(*cylinder(16, 2).positions[0, :2]) == pytest.approx(1.281, abs=1e-3)
    assert np.hypot(*cylinder(8, 2).positions[0, :2]) == pytest.approx(0.653, abs=1e-3)


def test_what_arrays_can_tell():
    assert ula(4).observable == (True, False)
    assert ura(1, 1).observable == (False, False)
    assert ura(4, 1).observable == (False, True)
    assert cylinder(8, 1).observable == (True, True)


def link(book, order, rng):
    return SignalModel(comb(28e9, 6.25e6, 8), sweep(book, 8, 8.92e-6, order=order, rng=rng), ura(8, 8), ura(2, 2))


def test_fixed_beam_order_is_ambiguous_and_a_fresh_permutation_is_not():
    rng = np.random.default_rng(0)
    sweep_time = 64 * 8.92e-6
    for book in (dft_beams(8, 8), antenna_switching(64)):
        model = link(book, "linear", rng)
        with pytest.warns(ScheduleWarning, match="18.8, 37.6 m/s"):
            result = check_schedule(model, 25.0)
        expected = model.waveform.wavelength / sweep_time
        assert np.min(np.abs(result.ambiguous_speeds - expected)) < 1.0
        assert ambiguity(link(book, "permuted", rng), 25.0).level.max() < 0.8
    assert check_schedule(link(random_phase_beams(64, 64, rng), "permuted", rng), 25.0).level.max() < 0.5


def test_slots_visit_every_beam_once_per_sweep():
    rng = np.random.default_rng(1)
    schedule = sweep(random_phase_beams(5, 8, rng), 4, 1e-5, rng=rng)
    slots = schedule.slots()
    assert slots.shape == (4, 5, 1)
    assert sorted(slots.ravel()) == list(range(20))
    assert np.all(schedule.precoder_index[slots[:, :, 0]] == np.arange(5))
    assert np.all(np.diff(schedule.times[slots[:, :, 0]], axis=0) > 0)


@pytest.mark.parametrize("options, message", [({"order": "spiral"}, "order must be"), ({}, "needs rng")])
def test_bad_schedules_are_named(options, message):
    with pytest.raises(ModelError, match=message):
        sweep(np.eye(4), 2, 1e-5, **options)


def test_a_lost_symbol_costs_the_search_one_use_of_each_beam():
    slots = Schedule(np.arange(5.0), np.eye(2), np.array([0, 1, 0, 1, 0])).slots()
    assert slots.tolist() == [[[0], [1]], [[2], [3]]]
    with pytest.raises(ModelError, match="1 of 4 never occur"):
        combiners = np.stack([np.eye(2), np.eye(2)])
        Schedule(np.arange(3.0), np.eye(2), np.array([0, 1, 0]), combiners, np.array([0, 0, 1])).slots()


def test_a_swept_link_with_lost_symbols_finds_its_paths():
    rng = np.random.default_rng(3)
    whole = sweep(random_phase_beams(8, 8, rng), 6, 35e-6, rng=rng)
    kept = np.delete(np.arange(48), [7, 30])
    schedule = Schedule(whole.times[kept], whole.precoders, whole.precoder_index[kept])
    model = SignalModel(comb(28e9, 4e6, 32), schedule, cylinder(8, 1), ura(2, 2))
    path = at_snr(model, PathTable([6e-8], [[0.3, 0.2]], [[-0.9, 0.4]], [8.0], [1.0]), [1e3])
    found = Nomp(model, threshold=22.0).run(synthesize(model, path, 1.0, rng))
    match = associate(model, found, path, 1.0)
    assert match.detected.all() and match.false == 0


def test_a_table_may_hold_the_poles():
    array = cylinder(8, 2)
    count = 24
    az, theta = np.meshgrid(np.pi * np.arange(2 * count) / count, np.pi * np.arange(count + 1) / count)
    directions = unit_vectors(np.stack([az, np.pi / 2 - theta], axis=-1)).reshape(-1, 3)
    table = array.response(directions)[0].T.reshape(16, count + 1, 2 * count)
    probe = sphere(50)
    assert np.abs(EadfArray.from_table(table).response(probe)[0] - array.response(probe)[0]).max() < 1e-3
    with pytest.raises(ModelError, match="with poles"):
        EadfArray.from_table(table[:, 1:])


def test_directions_behind_a_planar_array_look_as_those_in_front():
    array = ura(3, 4, orientation=Rotation.from_euler("zyx", [0.7, -0.3, 0.2]))
    directions = sphere(40)
    front, equal = turned(array, directions, View())
    assert equal.all() and array.faces(front).all() and np.allclose(np.linalg.norm(front, axis=1), 1)
    assert np.allclose(array.response(front)[0], array.response(directions)[0])
    assert np.array_equal(front[array.faces(directions)], directions[array.faces(directions)])
    for other in (cylinder(6, 2), ura(3, 4, pattern=CosinePattern())):
        same, equal = turned(other, directions, View())
        assert np.array_equal(same, directions) and not equal.any()


def test_a_view_decides_between_a_direction_and_its_mirror_image():
    array, behind = ura(3, 4), View((2.0, 4.3))
    directions = sphere(40)
    there, equal = turned(array, directions, behind)
    inside = behind.contains(directions) | behind.contains(directions * [-1, 1, 1])
    assert behind.contains(there[inside]).all() and not equal.any()


@pytest.mark.parametrize(
    ("array", "observable"),
    [
        (ula(8), (True, False)),
        (Array(np.c_[0.5 * np.arange(6), np.zeros((6, 2))]), (True, False)),
        (ura(6, 1), (False, True)),
        (ura(1, 1, pattern=CosinePattern()), (False, False)),
        (ula(6, pattern=DipolePattern()), (True, False)),
        (cylinder(8, 2), (True, True)),
        (ura(2, 64), (True, True)),
    ],
    ids=["line", "line along x", "mast", "point", "dipoles", "cylinder", "long strip"],
)
def test_what_an_array_can_tell_is_a_matter_of_its_response(array, observable):
    assert array.observable == observable
    if array.elements < 32:
        assert EadfArray.from_array(array, 24).observable == observable
