"""Noise that is not what it was said to be: at some ports more, from one direction, or twice as strong as given."""

from dataclasses import replace

import numpy as np
import pytest

from estimation import (
    Flag,
    ModelError,
    Nomp,
    SignalModel,
    comb,
    digital,
    random_phase_beams,
    sweep,
    synthesize,
    unit_vectors,
    ura,
    white_noise,
)
from estimation.estimators.colored import port_covariance
from estimation.evaluate import associate
from estimation.fisher import crb
from estimation.scenarios import FRONT, Draw, at_snr, draw_paths


def combined() -> SignalModel:
    """Four settings of a receiver of eight elements and four outputs, beams of random phases."""
    rng = np.random.default_rng(5)
    square = np.linalg.qr(rng.standard_normal((8, 8)) + 1j * rng.standard_normal((8, 8)))[0]
    schedule = sweep(
        random_phase_beams(8, 8, rng), 8, 30e-6, combiners=np.stack([square[:, :4], square[:, 4:]]), rng=rng
    )
    return SignalModel(comb(28e9, 6.25e6, 64), schedule, ura(2, 4), ura(2, 4))


LINKS = {
    "digital": SignalModel(comb(28e9, 6.25e6, 64), digital(16, 125e-6), ura(2, 4), ura(2, 4)),
    "combined": combined(),
}


def interferer(model, rng, power):
    """White in everything but the direction it comes from."""
    response = model.receiver.response(unit_vectors(rng.uniform([-0.9, -0.4], [0.9, 0.4])[None]))[0][0]
    combiners = model.schedule.combiners
    if combiners is None:
        return white_noise((*model.shape[:2], 1, model.shape[3]), power, rng) * response[:, None]
    ports = np.einsum("nrm,r->nm", combiners[model.schedule.combiner_index].conj(), response)
    return white_noise((*model.shape[:2], 1), power, rng) * ports


def drawn(model, seed):
    rng = np.random.default_rng(seed)
    paths = draw_paths(model, rng, Draw(paths=5, separation=1.5))
    return at_snr(model, paths, 10 ** (rng.uniform(32, 48, 5) / 10)), rng


@pytest.mark.parametrize("name", LINKS)
def test_an_interferer_becomes_noise_and_not_paths(name):
    model = LINKS[name]
    nomp = Nomp(model, arrival_view=FRONT, departure_view=FRONT, max_paths=12)
    false, found, nees = 0, [], []
    for seed in range(2):
        paths, rng = drawn(model, seed)
        signal = synthesize(model, paths, 1.0, rng) + interferer(model, rng, 10.0)
        match = associate(model, nomp.run(signal.astype(np.complex64)), paths, 1.0)
        false += match.false
        found.append(match.detected.mean())
        nees += list(match.nees / 6)
        if not seed:  # for whom noise is white sees paths without end
            assert np.all(replace(nomp, white=True, max_paths=9).run(signal.astype(np.complex64)).flags & Flag.LIMITED)
    assert false <= 1 and np.mean(found) >= 0.8 and 0.5 < np.mean(nees) < 1.6


@pytest.mark.parametrize("name", LINKS)
def test_a_known_covariance_of_the_ports_is_used(name):
    plain = LINKS[name]
    ports = plain.shape[2]
    rng = np.random.default_rng(3)
    factor = rng.standard_normal((ports, 2 * ports)) + 1j * rng.standard_normal((ports, 2 * ports))
    model = replace(plain, port_covariance=factor @ factor.conj().T)
    noise = synthesize(model, drawn(model, 0)[0].take([]), 0.5, rng)
    rows = np.moveaxis(noise, 2, 0).reshape(ports, -1)
    assert np.allclose(rows @ rows.conj().T / rows.shape[1], 0.5 * model.port_covariance, atol=0.1 * ports)
    paths, rng = drawn(model, 1)
    nomp = Nomp(model, threshold=25.0, arrival_view=FRONT, departure_view=FRONT, white=True)
    found = nomp.run(synthesize(model, paths, 1.0, rng))
    match = associate(model, found, paths, 1.0)
    assert match.detected.all() and match.false == 0 and found.noise_variance == pytest.approx(1.0, rel=0.05)
    # The bound that goes with it, and equal noise is no covariance at all.
    assert np.all(match.nees < 60)
    same = np.eye(ports) if plain.port_noise is None else plain.port_noise
    assert np.allclose(crb(replace(plain, port_covariance=same), paths, 1.0), crb(plain, paths, 1.0), rtol=1e-6)


def test_white_noise_has_no_covariance():
    for model in LINKS.values():
        for seed in range(5):
            assert port_covariance(model, white_noise(model.shape, 3.0, np.random.default_rng(seed))) is None


def test_a_noise_variance_that_cannot_be_true_is_not_believed():
    model = LINKS["digital"]
    nomp = Nomp(model, arrival_view=FRONT, departure_view=FRONT, max_paths=14)
    paths, rng = drawn(model, 4)
    signal = synthesize(model, paths, 1.0, rng)
    told, right, half = (nomp.run(signal, noise_variance=v) for v in (None, 1.0, 0.5))
    assert right.noise_variance == 1.0 and len(right) == len(told) == len(half) == 5
    assert half.noise_variance == pytest.approx(told.noise_variance)


@pytest.mark.parametrize("wrong", [np.ones((3, 3)), np.ones((8, 8)), -np.eye(8)])
def test_an_impossible_covariance_is_refused(wrong):
    with pytest.raises(ModelError, match="port_covariance"):
        replace(LINKS["digital"], port_covariance=wrong)
