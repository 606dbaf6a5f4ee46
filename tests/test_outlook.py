"""The look ahead: what is ambiguous, weak, crowded or out of reach is told with a remedy that mends it."""

import math
import re

import numpy as np
import pytest

from dopslam.config.scenario import parse
from dopslam.pipeline.look import look
from dopslam.pipeline.outlook import outlook
from dopslam.raytracing.images import reflected_paths, zenith_azimuth
from dopslam.records import SPEED_OF_LIGHT, Kind, Landmarks, Paths, Track

STATION = np.array([1.0, 4.0, 3.0])
WALLS = {"east": ([1.0, 0, 0], 20.0), "north": ([0, 1.0, 0], 10.0), "west": ([1.0, 0, 0], 0.0)}
TEXT = """
name = "hall"
[scene]
builtin = "box"
[base_station]
position = [1, 4, 3]
array = { kind = "planar", columns = 8, rows = 8 }
[receiver]
height = 1.5
array = { kind = "cylinder", columns = 8, rings = 4 }
[radio]
carrier_frequency = 28e9
bandwidth = 400e6
[track]
speed = 1
period = 0.2
steps = 5
start = [8, 2, 0.3, 5]
"""


def seen(*settings, gain=3e-5):
    """The outlook on a hall of three walls, by the image method; the west wall is behind the panel."""
    scenario = parse(TEXT, settings)
    along = 0.2 * np.arange(1, 6)
    heading = scenario.track.start[2]
    receivers = np.column_stack([8 + along, np.full(5, 2.0), np.full(5, 1.5)])
    velocity = np.tile([1.0, 0, 0], (5, 1))
    track = Track(
        along,
        receivers,
        np.full(5, math.remainder(heading, 2 * math.pi)),
        velocity,
        np.full(5, 5.0),
        np.array(scenario.track.start),
    )
    columns = {name: [] for name in ("tau", "theta_t", "phi_t", "theta_r", "phi_r", "doppler", "landmark", "step")}
    for index, planes in enumerate([[], ["east"], ["north"], ["west"]]):
        normals = np.array([WALLS[p][0] for p in planes]).reshape(-1, 3)
        offsets = np.array([WALLS[p][1] for p in planes])
        path = reflected_paths(STATION, receivers, normals, offsets)
        (theta_t, phi_t), (theta_r, phi_r) = zenith_azimuth(path.departure), zenith_azimuth(path.arrival)
        doppler = path.radial_velocity(velocity) * 28e9 / SPEED_OF_LIGHT
        values = (path.delay, theta_t, phi_t, theta_r, phi_r, doppler, np.full(5, index), np.arange(5))
        for name, value in zip(columns, values, strict=True):
            columns[name].append(value)
    flat = {name: np.stack(value, axis=1).ravel() for name, value in columns.items()}
    flat.pop("step")
    count = len(flat["tau"])
    paths = Paths(
        np.arange(6) * 4, a=np.full(count, gain + 0j), vertex_offsets=np.zeros(count + 1, int), vertices=np.zeros((0, 3)),
        **{name: flat[name] for name in flat if name != "landmark"}, landmark=flat["landmark"].astype(int),
    )  # fmt: skip
    landmarks = Landmarks(
        np.array(["BS", "VA east", "VA north", "VA west"]), np.array([Kind.BS, *[Kind.VA] * 3], np.int8), np.zeros((4, 3)),
        np.array([0, 1, 1, 1]),
    )  # fmt: skip
    found = outlook(scenario, track, landmarks, paths)
    return found, [str(finding) for finding in found.findings]


def test_a_sound_link_has_strong_landmarks_and_only_says_what_is_behind():
    found, said = seen()
    assert [row.steps for row in found.landmarks] == [5, 5, 5, 5] == [row.of for row in found.landmarks]
    assert all(row.detection > 0.99 for row in found.landmarks[:3])
    assert found.landmarks[3].rho_db == -math.inf
    assert len(said) == 1 and "5 of 20 paths lie behind" in said[0] and not any(f.fatal for f in found.findings)


def test_isotropic_panels_are_ambiguous_and_the_remedy_mends_it():
    _, said = seen('base_station.array.pattern="isotropic"')
    assert any('base_station.array.pattern = "cosine"' in text for text in said)
    _, said = seen("base_station.array={ kind='cylinder', columns=16, rings=2 }")
    assert said == []


def test_weak_landmarks_are_named_with_the_power_that_they_lack():
    _, said = seen(gain=1e-8)
    (weak,) = [text for text in said if "too weak" in text]
    lacking = float(re.search(r", (\d+) dB for all", weak)[1])
    assert any("fewer than two paths" in text for text in said)
    found, after = seen(f"source.traced.transmit_power_dbm={lacking}", gain=1e-8)
    assert not any("too weak" in text or "fewer than two" in text for text in after)
    assert all(row.detection > 0.5 for row in found.landmarks[:3])


def test_pilots_that_are_too_far_apart_are_named_with_a_comb_that_fits():
    coarse = ["radio.subcarriers=70", "radio.comb=60", "radio.subcarrier_spacing=240e3", "radio.bandwidth=1008e6"]
    _, said = seen(*coarse)
    (text,) = [text for text in said if "pilots tell apart" in text]
    comb = re.search(r"radio.comb = (\d+)", text)[1]
    fits = f"radio.bandwidth={70 * int(comb) * 240e3}"
    _, after = seen("radio.subcarriers=70", f"radio.comb={comb}", "radio.subcarrier_spacing=240e3", fits)
    assert not any("pilots tell apart" in text for text in after)


@pytest.mark.parametrize(
    "setting, hint",
    [
        ("track.start=[8, 2, 90, 5]", "write 1.571"),
        ("track.turn_rate=20", "write 0.3491"),
        ("base_station.yaw_deg=1.5707963", "write 90.0"),
        ("estimator.max_radial_velocity=0.5", "max_radial_velocity = 1.25"),
    ],
)
def test_what_looks_odd_is_asked_about(setting, hint):
    assert any(hint in text for text in seen(setting)[1])


def test_paths_that_the_signal_cannot_tell_apart_are_named(monkeypatch):
    monkeypatch.setitem(WALLS, "north", ([0, 1.0, 0], 2.1))  # along which both the receiver and the base station stand
    monkeypatch.setitem(globals(), "STATION", np.array([1.0, 2.05, 1.6]))
    _, said = seen()
    (text,) = [text for text in said if "too close to others" in text]
    assert "BS at 5 of 5" in text and "VA north at 5 of 5" in text and "VA east" not in text


@pytest.mark.rt
def test_a_scene_is_looked_at_before_it_is_run(tmp_path, call, capsys):
    (tmp_path / "scenario.toml").write_text('name = "mine"\n[scene]\ngenerator = "room"\nseed = 3\n')
    assert call("check", tmp_path) == 0
    shown = capsys.readouterr().out
    assert "VA wall_north" in shown and "derived:" in shown
    assert call("check", tmp_path, "--set", "base_station.position=[100, 0, 1]") == 2
    assert "outside of the walls" in capsys.readouterr().out
    found = look(parse((tmp_path / "scenario.toml").read_text()))
    assert found.landmarks[0].name == "BS"
