"""Free drives with unknown speed: default walks follow them; walks of a calm drive lose them."""

import pytest

from dopslam.config.scenario import parse
from dopslam.studies.drives import judged, passes, summarize


@pytest.mark.mc
@pytest.mark.parametrize("kind", ["car", "walker"])
def test_drives_that_stop_and_turn_at_once_are_followed_at_their_bound(kind):
    found = summarize([judged(kind, seed) for seed in range(1000, 1012)])
    assert found["rmse_over_bound_interval"][0] <= 1.2 and found["passing"]["high"] > 0.9 and found["nees"] < 5.5


@pytest.mark.mc
def test_the_walks_matter():
    calm = ["filter.turn_rate_walk=0.002", "filter.speed_walk=0.1", "track.process_std=[0.04, 0.04, 0.004, 0.02]"]
    assert sum(passes(judged("car", seed, settings=calm)) for seed in range(1000, 1006)) <= 3


def test_a_step_strays_by_what_its_maneuver_changes():
    text = """
[base_station]
position = [0, 0, 5]
array = { kind = "cylinder", columns = 8, rings = 2 }
[receiver]
array = { kind = "cylinder", columns = 8, rings = 2 }
[track]
waypoints = [[0, 0, 0], [10, 0, 2], [20, 5, 4]]
max_acceleration = 2.0
max_turn_rate = 0.5
[scene]
generator = "plaza"
"""
    scenario = parse(text)
    assert scenario.filter.speed_walk == pytest.approx(0.4) and scenario.filter.turn_rate_walk == pytest.approx(0.15)
    assert scenario.track.process_std[2] > 0.15 * 0.2 / 3**0.5
