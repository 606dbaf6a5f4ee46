"""Clusters of echoes too many to tell apart: no ghosts, no minutes, and the paths beside them are as sure as they say."""

from dataclasses import replace

import numpy as np
import pytest

from estimation import Flag, Nomp, PathTable, SignalModel, comb, digital, synthesize, ura
from estimation.estimators import clearing
from estimation.estimators.haze import CROWD, Haze, gathered, raised
from estimation.evaluate import associate
from estimation.scenarios import FRONT, Draw, at_snr, draw_paths


@pytest.fixture(scope="module")
def link() -> SignalModel:
    return SignalModel(comb(28e9, 6.25e6, 64), digital(12, 125e-6), ura(2, 4), ura(2, 4))


@pytest.fixture(scope="module")
def nomp(link) -> Nomp:
    return Nomp(link, threshold=24.0, arrival_view=FRONT, departure_view=FRONT)


def clusters(model, rng, decibel, count=3, rays=200):
    """Echoes about a few directions, speeds and delays, with an exponential profile; energy per sample over unit noise."""
    own = np.repeat(np.arange(count), rays)
    late = rng.exponential(15e-9, len(own))
    ends = [rng.uniform([-1, -0.5], [1, 0.5], (count, 2))[own] + rng.laplace(0, 0.06, (len(own), 2)) for _ in range(2)]
    gain = np.exp(-late / 30e-9) * (rng.standard_normal((len(own), 2)) @ [1, 1j])
    speed = rng.uniform(-15, 15, count)[own] + rng.normal(0, 0.5, len(own))
    echo = synthesize(model, PathTable(rng.uniform(20e-9, 90e-9, count)[own] + late, *ends, speed, gain))
    return echo * np.sqrt(10 ** (decibel / 10) / np.mean(np.abs(echo) ** 2))


def drawn(model, seed, decibel):
    rng = np.random.default_rng(seed)
    paths = draw_paths(model, rng, Draw(paths=5, separation=1.5))
    paths = at_snr(model, paths, 10 ** (rng.uniform(32, 48, 5) / 10))
    return paths, (synthesize(model, paths, 1.0, rng) + clusters(model, rng, decibel)).astype(np.complex64)


@pytest.mark.parametrize("decibel", [-10.0, 0.0])
def test_clusters_of_echoes_are_no_paths(link, nomp, decibel):
    false, found, nees = [], [], []
    for seed in (0, 3):
        paths, signal = drawn(link, seed, decibel)
        match = associate(link, nomp.run(signal), paths, 1.0, gate=400)
        false.append(match.false)
        found.append(match.detected.mean())
        nees += list(match.nees / 6)
    assert np.mean(false) <= 2 and np.mean(found) >= 0.8 and 0.4 < np.mean(nees) < 2.0


def test_without_the_haze_there_would_be_ghosts(link, nomp, monkeypatch):
    monkeypatch.setattr(clearing, "gathered", lambda model, hazes, known, *_: ((), np.arange(len(known))))
    paths, signal = drawn(link, 0, 0.0)
    found = replace(nomp, max_paths=10).run(signal)
    assert np.all(found.flags & Flag.LIMITED) and associate(link, found, paths, 1.0, gate=400).false >= 5


def row(count, spacing, energy):
    """Paths one behind the other, alike in all but their delays."""
    same = np.tile([[0.1, 0.1]], (count, 1))
    delay = 40e-9 + spacing * 2.5e-9 * np.arange(count)
    return PathTable(delay, same, same, np.zeros(count), np.ones(count, complex)).geometry, np.full(count, energy)


def test_a_crowd_is_a_haze_and_a_path_in_it_stays(link):
    many = CROWD[1]
    crowd, energy = row(many + 1, 0.8, 100.0)
    energy[2] = 100.0 * 30
    old, young = np.arange(many - 1), np.array([many - 1, many])
    new, kept = gathered(link, (), crowd.take(old), energy[old], crowd.take(young), energy[young], 1.0)
    assert len(new) == 1 and kept.tolist() == [2] and len(new[0].members) == many
    # The noise about that path is that of a cell.
    assert raised(link, new, crowd.take([2]), 1.0)[0] == pytest.approx(101, rel=0.01)
    # Few (fewer if weak), or far apart, or explained already, are paths.
    for count, spacing, fresh, weak, hazes in (
        (many - 1, 0.8, 2, 1.0, 0),
        (CROWD[0], 1.5, 1, 200.0, 1),
        (CROWD[0] - 1, 1.5, 1, 200.0, 0),
        (many + 1, 7.0, 3, 1.0, 0),
        (many + 1, 0.8, 0, 1.0, 0),
    ):
        geometry, energy = row(count, spacing, 100.0)
        old, young = np.arange(count - fresh), np.arange(count - fresh, count)
        new, kept = gathered(link, (), geometry.take(old), energy[old], geometry.take(young), energy[young], weak)
        assert len(new) == hazes and len(kept) == (0 if hazes else len(old))


def test_a_haze_takes_up_its_members_and_what_lies_between(link):
    members, _ = row(4, 1.7, 1.0)
    haze = Haze.of(link, members, 1.0)
    between, far = row(9, 0.6, 1.0)[0], row(2, 30.0, 1.0)[0].take([1])
    for geometry, least, most in ((between, 0.0, 0.01), (far, 0.97, 1.0)):
        for k in range(len(geometry)):
            echo = synthesize(link, geometry.take([k]).table(np.ones(1, complex)))
            left = np.linalg.norm(haze.lifted(link, echo)) ** 2 / np.linalg.norm(echo) ** 2
            assert least <= left <= most + 1e-6
