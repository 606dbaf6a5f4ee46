"""Links that nobody tuned: the generator covers what is supported, and the estimator keeps its word on them."""

import numpy as np
import pytest

from estimation import Nomp, snr, synthesize
from estimation.random_links import LARGEST, SEARCHED, random_link, random_paths, right_model, wrong_model


def drawn(count):
    for seed in range(count):
        rng = np.random.default_rng(seed)
        yield random_link(rng), rng


def test_every_architecture_is_drawn_and_every_link_can_be_searched():
    kinds, uneven = set(), 0
    for model, rng in drawn(30):
        kinds.add((model.schedule.precoders is None, model.schedule.combiners is None))
        uneven += model.waveform.spacing is None
        assert np.prod(model.shape) <= LARGEST and model.active.all()
        paths = random_paths(model, rng)
        assert 2 <= len(paths) <= 8 and np.abs(paths.radial_velocity).max() <= SEARCHED
        rho = 10 * np.log10(snr(model, paths, 1.0))
        assert rho.min() > 17.9 and rho.max() < 45.1
    assert len(kinds) == 4 and uneven


def test_the_same_seed_draws_the_same_link():
    first, second = (random_link(np.random.default_rng(5)) for _ in range(2))
    assert first.shape == second.shape and np.array_equal(first.schedule.times, second.schedule.times)


@pytest.mark.mc
def test_the_threshold_needs_no_noise_of_the_link():
    """Rice's volume times a fixed share: false paths in noise at the nominal rate, on links it was not measured on."""
    above, links = 0, 4
    for number in range(links):
        model = random_link(np.random.default_rng(np.random.SeedSequence(1000, spawn_key=(number,))))
        nomp = Nomp(model, max_speed=SEARCHED, false_alarm_rate=0.1)
        above += np.sum(nomp.suprema(50, seed=4) > nomp.level)
    # Nominal 20; a threshold off by one would give 8 or 54.
    assert 9 <= above <= 36


@pytest.mark.mc
def test_random_links_are_estimated_at_their_bounds():
    for row in right_model(4, 12, seed=2000):
        assert row["found"] > 0.97 and row["false_per_snapshot"] <= 0.2
        assert row["nees_interval"][0] < 1.1 and row["nees_interval"][1] > 0.9


@pytest.mark.mc
def test_wrong_models_of_random_links_make_no_ghosts():
    for name, row in wrong_model(6, seed=2000).items():
        assert row["ghosts_per_snapshot"] <= 1, name
        assert row["nees_over_6"] <= 2.5, name


@pytest.mark.parametrize("seed", [56, 80])
def test_nothing_is_reported_below_the_threshold(seed):
    """Of strong paths the last, finer fit left components of 5 to 12 dB that the search had taken for paths of their own."""
    rng = np.random.default_rng(seed)
    model = random_link(rng)
    paths = random_paths(model, rng, (40.0, 95.0))
    nomp = Nomp(model, max_speed=SEARCHED, false_alarm_rate=0.01)
    found = nomp.run(synthesize(model, paths, 1.0, rng), 1.0)
    assert len(found.snr) >= 3 and found.snr.min() >= nomp.level
