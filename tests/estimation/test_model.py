"""The signal model against eq. (2) written out, finite differences and dense matrices."""

from __future__ import annotations

import numpy as np
import pytest

from estimation import (
    ModelError,
    PathTable,
    SignalError,
    SignalModel,
    comb,
    cylinder,
    digital,
    synthesize,
    ura,
)
from estimation.signal.algebra import gram, gram_diagonal, project
from estimation.signal.directions import angles_of, displaced, tangents, unit_vectors


def explicit_signal(model: SignalModel, paths: PathTable) -> np.ndarray:
    """Eq. (2) of paper A, symbol by symbol, with the sub-bands' scale where there are any."""
    schedule, waveform = model.schedule, model.waveform
    out = np.zeros(model.shape, complex)
    for band in model.bands:
        for delay, arrival, departure, speed, gain in zip(
            paths.delay,
            paths.geometry.arrival,
            paths.geometry.departure,
            paths.radial_velocity,
            paths.gain,
            strict=True,
        ):
            a_r = np.exp(2j * np.pi * band.scale * model.receiver.positions @ arrival)
            a_t = np.exp(2j * np.pi * band.scale * model.transmitter.positions @ departure)
            frequency = np.exp(-2j * np.pi * waveform.frequencies[band.pilots] * delay)
            for n, time in enumerate(schedule.times):
                received = a_r
                if schedule.combiners is not None:
                    received = schedule.combiners[schedule.combiner_index[n]].conj().T @ a_r
                phase = gain * np.exp(2j * np.pi * time * speed * band.scale / waveform.wavelength)
                if schedule.precoders is None:
                    block = received[:, None] * a_t.conj()
                else:
                    block = received * (a_t.conj() @ schedule.precoders[schedule.precoder_index[n]])
                out[band.pilots, n] += phase * np.multiply.outer(frequency, block)
    return out


def test_synthesis_is_equation_two(model, paths):
    expected = explicit_signal(model, paths)
    got = synthesize(model, paths)
    assert got.dtype == np.complex64
    assert np.abs(got - expected).max() < 3e-6 * np.abs(expected).max() * len(paths)


def dense_signatures(model, paths, step=None):
    geometry = paths.geometry if step is None else paths.geometry.moved(step)
    columns = []
    for p in range(len(paths)):
        single = geometry.take([p])
        unit = single.table(np.ones(1))
        columns.append(model.whiten(explicit_signal(model, unit)).ravel())
    return np.array(columns)


def test_derivatives_grams_and_projections_match_finite_differences(model, paths):
    scale = np.array([1e-12, 1e-5, 1e-5, 1e-5, 1e-5, 1e-3])
    columns = [dense_signatures(model, paths)]
    for a in range(6):
        step = np.zeros((len(paths), 6))
        step[:, a] = scale[a]
        columns.append((dense_signatures(model, paths, step) - dense_signatures(model, paths, -step)) / (2 * scale[a]))
    dense = np.stack(columns, axis=1)
    expected = np.einsum("pax,qbx->paqb", dense.conj(), dense)
    blocks = model.evaluate(paths.geometry)
    got = gram(model, blocks)
    size = np.sqrt(np.einsum("papa->pa", expected).real)
    norm = size[:, :, None, None] * size
    assert np.max(np.abs(got - expected)[norm > 0] / norm[norm > 0]) < 3e-5
    own = got[np.arange(3), :, np.arange(3)]
    assert np.all(np.abs(gram_diagonal(model, blocks) - own) <= 1e-9 * size[:, :, None] * size[:, None])
    plain = gram(model, blocks, plain=True)[..., 0]
    assert np.all(np.abs(plain - got[..., 0]) <= 1e-9 * size[:, :, None] * size[:, 0])
    rng = np.random.default_rng(0)
    data = (rng.standard_normal(model.shape) + 1j * rng.standard_normal(model.shape)).astype(np.complex64)
    inner = np.einsum("pax,x->pa", dense.conj(), data.ravel())
    assert np.max(np.abs(project(model, data, blocks) - inner) / np.maximum(size, 1e-30)) < 2e-4


def test_colored_noise_has_the_combiners_covariance_and_whitens(hybrid):
    model = hybrid
    silence = PathTable(*[np.empty(s) for s in ((0,), (0, 2), (0, 2), (0,), (0,))])
    rng = np.random.default_rng(2)
    noise = np.concatenate([synthesize(model, silence, 2.0, rng) for _ in range(60)])
    for setting in range(2):
        w = model.schedule.combiners[setting]
        samples = noise[:, model.schedule.combiner_index == setting].reshape(-1, 3)
        measured = samples.T @ samples.conj() / len(samples)
        assert np.abs(measured - 2.0 * w.conj().T @ w).max() < 0.05 * np.abs(w.conj().T @ w).max()
    white = np.concatenate([model.whiten(b) for b in np.split(noise, 60)]).reshape(-1, 3)
    assert np.abs(white.T @ white.conj() / len(white) - 2.0 * np.eye(3)).max() < 0.05


def test_directions_round_trip_and_tangents():
    angles = np.array([[0.3, 0.4], [-3.0, -1.2], [2.0, 1.5]])
    vectors = unit_vectors(angles)
    assert np.allclose(angles_of(vectors), angles)
    assert np.allclose(np.einsum("pai,pbi->pab", tangents(vectors), tangents(vectors)), np.eye(2))
    assert np.allclose(np.einsum("pai,pi->pa", tangents(vectors), vectors), 0)
    pole = np.array([[0.0, 0.0, 1.0]])
    assert np.isfinite(displaced(pole, np.array([[1e-3, 2e-3]]))).all()


def test_orientation_turns_the_array():
    from scipy.spatial.transform import Rotation

    turned = ura(2, 3, orientation=Rotation.from_euler("z", 90, degrees=True))
    straight = ura(2, 3)
    direction = unit_vectors([[0.3, 0.2]])
    rotated = unit_vectors([[0.3 + np.pi / 2, 0.2]])
    assert np.allclose(turned.steering(rotated), straight.steering(direction))
    assert turned.faces(unit_vectors([[np.pi / 2, 0]]))[0] and not turned.faces(unit_vectors([[-np.pi / 2, 0]]))[0]


@pytest.mark.parametrize(
    "bad, message",
    [
        (lambda m: np.zeros((3, 3)), "does not match"),
        (lambda m: np.full(m.shape, np.nan), "NaN"),
        (lambda m: "noise", "convertible"),
    ],
)
def test_bad_signals_are_named(model, bad, message):
    with pytest.raises(SignalError, match=message):
        model.checked(bad(model))


def test_bad_models_are_named():
    with pytest.raises(ModelError, match="positions"):
        from estimation import Array

        Array(np.zeros((3, 2)))
    with pytest.raises(ModelError, match="address 4 elements"):
        from estimation import random_phase_beams, sweep

        rng = np.random.default_rng(0)
        SignalModel(
            comb(28e9, 1e6, 8),
            sweep(random_phase_beams(2, 4, rng), 2, 1e-5, rng=rng),
            cylinder(4, 2),
            ura(2, 2),
        )
    with pytest.raises(ModelError, match="linearly dependent"):
        from estimation import Schedule

        SignalModel(
            comb(28e9, 1e6, 8),
            Schedule(np.arange(4.0), None, None, np.ones((1, 4, 2)), None),
            ura(1, 2),
            ura(2, 2),
        )
    with pytest.raises(ModelError, match="noise_variance"):
        synthesize(
            SignalModel(comb(28e9, 1e6, 8), digital(2, 1e-5), ura(1, 2), ura(2, 2)),
            PathTable([0.0], [[0, 0]], [[0, 0]], [0.0], [1.0]),
            -1.0,
        )
