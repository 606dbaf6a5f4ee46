"""Defaults that follow from carrier, bandwidth, base station and drive; what is written is left alone."""

import pytest

from dopslam.config.fitted import SPEED_OF_LIGHT, reach
from dopslam.config.scenario import load, override, parse
from dopslam.errors import ConfigError
from dopslam.scenes.generators import GENERATORS

MINIMAL = """
name = "mine"
[scene]
builtin = "simple_street_canyon"
[base_station]
position = [0, 0, 10]
array = { kind = "planar", columns = 8, rows = 8 }
[receiver]
height = 1.5
array = { kind = "cylinder", columns = 8, rings = 2 }
[radio]
carrier_frequency = 28e9
bandwidth = 400e6
[track]
speed = 10
period = 0.2
steps = 50
start = [-50, -3, 0, 20]
"""


def test_a_person_says_only_carrier_bandwidth_arrays_station_and_drive():
    scenario = parse(MINIMAL)
    radio, far = scenario.radio, reach(scenario)
    assert far == pytest.approx((50**2 + 3**2 + 8.5**2) ** 0.5)
    assert radio.subcarriers * radio.comb * radio.subcarrier_spacing == pytest.approx(400e6, rel=0.02)
    unambiguous = SPEED_OF_LIGHT / (radio.comb * radio.subcarrier_spacing)
    assert 4 * far + 20 < unambiguous < 1.4 * (4 * far + 70)
    assert scenario.estimator.max_radial_velocity == 12.5
    assert scenario.base_station.array.pattern == "cosine"
    assert scenario.track.process_std[0] == pytest.approx(0.04)
    assert set(scenario.derived) == {"radio", "track", "estimator", "filter"}


def test_more_room_means_fewer_landmarks_in_a_cubic_meter():
    near, far = parse(MINIMAL), parse(MINIMAL, ["track.start=[-500, -3, 0, 20]"])
    ratio = (reach(far) / reach(near)) ** 3
    assert near.filter.intensity_sp / far.filter.intensity_sp == pytest.approx(ratio, rel=0.02)


def test_what_is_given_is_kept_and_what_was_derived_is_stored():
    given = ["track.process_std=[0.3,0.3,0.01,0.3]", "radio.comb=2", "filter.intensity_va=1e-9"]
    scenario = parse(MINIMAL, given)
    assert scenario.track.process_std == (0.3, 0.3, 0.01, 0.3)
    assert (scenario.radio.comb, scenario.filter.intensity_va) == (2, 1e-9)
    assert scenario.radio.subcarriers == round(400e6 / (2 * scenario.radio.subcarrier_spacing))
    stored = override(scenario, [])
    assert stored.to_toml() == scenario.to_toml() and not stored.derived


def test_a_bandwidth_that_the_pilots_contradict_is_refused():
    with pytest.raises(ConfigError, match="give the one or the others"):
        parse(MINIMAL, ["radio.subcarriers=100", "radio.comb=1", "radio.subcarrier_spacing=120e3"])


@pytest.mark.parametrize("name", ["courtyard", "pedestrian", "ring_road", "street_canyon"])
def test_scenes_of_papers_say_what_matters_themselves(name):
    assert {"track", "filter"} & set(load(name).derived) <= ({"filter"} if name == "pedestrian" else set())


@pytest.mark.parametrize("kind", GENERATORS)
def test_every_generated_scenario_is_complete(kind):
    for seed in range(20):
        scenario = parse(f'[scene]\ngenerator = "{kind}"\nseed = {seed}')
        assert 64 <= scenario.radio.subcarriers <= 3400
        assert scenario.radio.symbol_period * scenario.radio.subcarrier_spacing >= 1.07
