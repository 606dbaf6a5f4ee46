"""Measured detections of a drive that nobody described: no scene, no arrays, no start, no speed, no clock, no true map."""

import json

import numpy as np
import pytest

from dopslam.config.measured import Shown
from dopslam.config.scenario import load, override
from dopslam.errors import SceneError
from dopslam.formats.shown import shown_by
from dopslam.models.motion import CoordinatedTurn
from dopslam.pipeline import preflight
from dopslam.records import DetectionSeries
from dopslam.simulate.drives import CAR, drive, surroundings
from dopslam.simulate.world import Situation, SnrNoise, draw_scans

STATION = "[base_station]\nposition = {}\n[receiver]\nheight = 1.5\n"
UNIT = np.array([0.3, 0.05, 0.05, 0.05, 0.05, 0.5])
MAP = """noise_floor_db = 0.0
[columns]
time = "t"
delay = "delay"
aoa_azimuth = "aoa_az"
aoa_elevation = "aoa_el"
aod_azimuth = "aod_az"
aod_elevation = "aod_el"
radial_velocity = "v"
snr = "snr"
delay_std = "delay_std"
aoa_azimuth_std = "angle_std"
aoa_elevation_std = "angle_std"
aod_azimuth_std = "angle_std"
aod_elevation_std = "angle_std"
radial_velocity_std = "v_std"
[units]
delay = "m"
snr = "dB"
"""


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """Folder with a table, its mapping, a track and three lines of scenario, from a seeded drive."""
    folder, rng, steps, period = tmp_path_factory.mktemp("measured"), np.random.default_rng(1001), 30, 0.2
    rows = drive(CAR, steps, period, rng)
    kind, where, strength = surroundings(CAR, rows[:, 1:], 1.5, rng)
    velocity = np.gradient(rows[:, 1:], period, axis=0)
    heading, speed = np.unwrap(np.arctan2(*velocity.T[::-1])), np.hypot(*velocity.T)
    state = np.column_stack([rows[:, 1:], heading, np.full(len(rows), 120.0), speed, np.gradient(heading, period)])[1:]
    motion = CoordinatedTurn(period, np.eye(6))
    world = Situation(
        where[0], kind, where, motion, state[0], np.eye(6), steps, SnrNoise(UNIT, strength), 0.05, height=1.5
    )
    scans = draw_scans(world, state, rng, rng)
    time = period * (1 + np.repeat(np.arange(steps), np.diff(scans.offsets)))
    std = UNIT / np.sqrt(scans.snr)[:, None]
    table = np.column_stack([time, scans.z, 10 * np.log10(scans.snr), std[:, 0], std[:, 1], std[:, 5]])
    names = "t,delay,aoa_az,aoa_el,aod_az,aod_el,v,snr,delay_std,angle_std,v_std"
    np.savetxt(folder / "table.csv", table, delimiter=",", header=names, comments="")
    track = np.column_stack([period * np.arange(1, steps + 1), state[:, :3]])
    np.savetxt(folder / "track.csv", track, delimiter=",", header="time,x,y,heading", comments="")
    (folder / "map.toml").write_text(MAP)
    (folder / "scenario.toml").write_text(STATION.format(where[0].tolist()))
    return folder


def test_from_three_lines_of_scenario_to_a_judged_track(measured, call, tmp_path):
    table, mapping, track = (measured / name for name in ("table.csv", "map.toml", "track.csv"))
    file = tmp_path / "d.h5"
    command = ("import", table, "--map", mapping, "--scene", measured, "--track", track, "--out", file)
    assert call(*command) == 0
    assert call("slam", file) == 0
    assert call("evaluate", file, "--out", tmp_path / "report") == 0
    summary = json.loads((tmp_path / "report" / "summary.json").read_text())
    assert summary["position_rmse_m"] < 0.1 and not summary["diverged"]
    assert summary["clock_bias_rmse_m"] is None and summary["peb_m"] is None and summary["gospa_va_m"] is None
    assert summary["nees_states"] == 3 and summary["nees"] < 9
    assert call("evaluate", file, "--align", "--out", tmp_path / "aligned") == 0
    moved = json.loads((tmp_path / "aligned" / "summary.json").read_text())
    assert moved["position_rmse_m"] <= summary["position_rmse_m"] and moved["aligned"]["moved_m"] < 0.1
    assert call("bound", file) == 2  # without a true map there is none
    assert "GOSPA" not in (tmp_path / "report" / "table.txt").read_text().split("RMSE: root")[0]


def test_what_is_not_said_follows_and_what_is_said_stays(measured):
    shown = Shown(speed=8.0, reach=50.0, period=0.2)
    free = load(measured, [], shown)
    assert (free.filter.motion, free.filter.start) == ("unknown", "snapshot")
    assert free.estimator.max_radial_velocity == pytest.approx(10.0) and free.filter.speed_std == 8.0
    told = load(measured, ["track.speed=3.0", "track.start=[1, 2, 0.1, 0]"], shown)
    assert (told.filter.motion, told.filter.start, told.track.speed) == ("known", "prior", 3.0)
    assert override(free, []).to_toml() == free.to_toml()
    with pytest.raises(SceneError, match="no scene"):
        preflight.scene_source(free)


def test_false_detections_do_not_make_a_receiver_fast():
    rng, rows = np.random.default_rng(3), 400
    speed = np.where(rng.random(rows) < 0.05, 900.0, rng.uniform(-4, 4, rows))
    found = DetectionSeries(
        offsets=np.arange(0, rows + 1, 4), delay=rng.uniform(0, 1e-7, rows), aoa=np.zeros((rows, 2)),
        aod=np.zeros((rows, 2)), radial_velocity=speed, gain=np.ones(rows, complex),
        covariance=np.broadcast_to(np.eye(6), (rows, 6, 6)).copy(), snr=np.ones(rows), noise_variance=np.ones(rows // 4),
        threshold=1.0, false_alarm_rate=0.1, search_volume=1.0,
    )  # fmt: skip
    shown = shown_by(found, 0.5, doppler=True)
    assert 3.0 < shown.speed < 8.0 and 15 < shown.reach < 30
    walked = shown_by(found, 0.5, doppler=False)
    assert 1.0 <= walked.speed <= 100.0
