"""Foreign detections: conventions undone to the last digit, subsets that a filter can run on, one error for what is
wrong."""

import csv

import numpy as np
import pytest
from scipy.io import savemat

from dopslam.config.scenario import load
from dopslam.errors import DatasetError
from dopslam.formats import table as foreign
from dopslam.pipeline import file as stages
from dopslam.records import SPEED_OF_LIGHT, DetectionSeries, Track
from dopslam.slam.history import History
from dopslam.store import file as dataset

FULL = """
[columns]
step = "k"
delay = "toa"
aoa_azimuth = "phi"
aoa_elevation = "theta"
aod_azimuth = "pa"
aod_elevation = "pe"
doppler = "fd"
[units]
delay = "ns"
aoa_azimuth = "deg"
aoa_elevation = "deg"
[conventions]
elevation = "zenith"
azimuth = "clockwise"
doppler = "receding"
[offsets]
delay = 12.5
[std]
delay = 0.3
aoa_azimuth = 3
aoa_elevation = 3
aod_azimuth = 0.05
aod_elevation = 0.05
doppler = 9.3
"""


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    path = tmp_path_factory.mktemp("simulated") / "d.h5"
    stages.simulate(path, load("ring_road", ["source.kind=model", "track.steps=12"]), seed=2)
    return path


@pytest.fixture(scope="module")
def ours(simulated):
    return dataset.read_record(simulated, "detections", DetectionSeries)


def foreign_columns(d):
    """The same detections as somebody else would tabulate them."""
    return {
        "k": np.repeat(np.arange(d.steps), np.diff(d.offsets)).astype(float),
        "toa": d.delay * 1e9 + 12.5,
        "phi": -np.degrees(d.aoa[:, 0]),
        "theta": 90 - np.degrees(d.aoa[:, 1]),
        "pa": -d.aod[:, 0],
        "pe": np.pi / 2 - d.aod[:, 1],
        "fd": -d.radial_velocity * 28e9 / SPEED_OF_LIGHT,
    }


def write(folder, columns, mapping):
    table, rule = folder / "t.csv", folder / "m.toml"
    with open(table, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(np.column_stack(list(columns.values())).tolist())
    rule.write_text(mapping)
    return table, rule


def assert_equal(found, expected):
    assert np.array_equal(found.offsets, expected.offsets)
    assert np.allclose(found.delay, expected.delay, rtol=1e-12, atol=0)
    for name in ("aoa", "aod"):
        assert np.allclose(np.exp(1j * getattr(found, name)), np.exp(1j * getattr(expected, name)), atol=1e-12)
    assert np.allclose(found.radial_velocity, expected.radial_velocity, atol=1e-9)


def test_conventions_are_undone_and_the_rows_may_come_in_any_order(tmp_path, ours):
    columns = foreign_columns(ours)
    table, rule = write(tmp_path, columns, FULL)
    found = foreign.detections(table, foreign.read_mapping(rule), load("ring_road"))
    assert_equal(found, ours)
    std = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    expected = [0.3e-9, np.radians(3), np.radians(3), 0.05, 0.05, 9.3 * SPEED_OF_LIGHT / 28e9]
    assert np.allclose(std, expected)
    turned = {name: column[::-1] for name, column in columns.items()}
    table, rule = write(tmp_path, turned, FULL)
    mixed = foreign.detections(table, foreign.read_mapping(rule), load("ring_road"))
    assert np.allclose(np.sort(mixed.delay[mixed.rows(3)]), np.sort(ours.delay[ours.rows(3)]), rtol=1e-12)


def test_matlab_uplink_world_frames_and_times(tmp_path, ours, simulated):
    truth = dataset.read_record(simulated, "track", Track)
    step = np.repeat(np.arange(ours.steps), np.diff(ours.offsets))
    content = {
        "t": truth.time[step], "tau": ours.delay, "az1": ours.aod[:, 0] + np.radians(30), "el1": ours.aod[:, 1],
        "az2": ours.aoa[:, 0] + truth.heading[step], "el2": ours.aoa[:, 1], "v": ours.radial_velocity, "p": np.full(len(step), -70.0),
    }  # fmt: skip
    savemat(tmp_path / "t.mat", content)
    (tmp_path / "m.toml").write_text(
        'noise_floor_db = -90\n[columns]\ntime="t"\ndelay="tau"\naoa_azimuth="az1"\naoa_elevation="el1"\naod_azimuth="az2"\n'
        'aod_elevation="el2"\nradial_velocity="v"\npower="p"\n[units]\npower="dB"\n[conventions]\nuplink=true\naoa_frame="world"\n'
        'aod_frame="world"\n[std]\ndelay=1e-9\naoa_azimuth=0.1\naoa_elevation=0.2\naod_azimuth=0.3\naod_elevation=0.4\n'
        "radial_velocity=0.5\n"
    )
    rule, scenario = foreign.read_mapping(tmp_path / "m.toml"), load("ring_road", ["base_station.yaw_deg=30"])
    found = foreign.detections(tmp_path / "t.mat", rule, scenario, truth=truth)
    assert_equal(found, ours)
    assert np.allclose(np.sqrt(np.diagonal(found.covariance[0]))[1:], [0.3, 0.4, 0.1, 0.2, 0.5])
    assert np.allclose(found.snr, 100)
    with pytest.raises(DatasetError, match="true headings"):
        foreign.detections(tmp_path / "t.mat", rule, scenario)


def slam(call, path, *options):
    assert call("slam", path, *options) == 0
    return dataset.read_record(path, next(g for g in dataset.groups(path) if g.startswith("slam_")), History)


def test_the_filter_runs_on_foreign_detections_as_on_ours(tmp_path, ours, simulated, call):
    std = "[std]\ndelay = 0.33356409519815206\naoa_azimuth = 2.864788975654116\naoa_elevation = 2.864788975654116\n"
    std += "aod_azimuth = 0.05\naod_elevation = 0.05\n"
    mapping = FULL[: FULL.index("[std]")].replace('doppler = "fd"\n', "").replace('doppler = "receding"\n', "") + std
    columns = foreign_columns(ours)
    del columns["fd"]
    table, rule = write(tmp_path, columns, mapping)
    command = ["import", table, "--map", rule, "--scene", "ring_road", "--out", tmp_path / "d.h5"]
    assert call(*command, "--set", "track.steps=12") == 0
    assert call(*command) == 2  # exists already
    mine = tmp_path / "mine.h5"
    mine.write_bytes(simulated.read_bytes())
    theirs, expected = slam(call, tmp_path / "d.h5", "--doppler-std", "none"), slam(call, mine, "--doppler-std", "none")
    # The clutter's delays span what the table holds instead of what the model draws from; nothing else differs.
    assert np.abs(theirs.mean[:, :2] - expected.mean[:, :2]).max() < 0.1


def test_two_dimensional_angles_without_doppler_run(tmp_path, ours, call):
    columns = {name: column for name, column in foreign_columns(ours).items() if name in ("k", "toa", "phi", "pa")}
    mapping = (
        '[columns]\nstep="k"\ndelay="toa"\naoa_azimuth="phi"\naod_azimuth="pa"\n[units]\ndelay="ns"\naoa_azimuth="deg"\n'
        '[conventions]\nazimuth="clockwise"\n[offsets]\ndelay=12.5\n[std]\ndelay=0.34\naoa_azimuth=2.9\naod_azimuth=0.05\n'
    )
    table, rule = write(tmp_path, columns, mapping)
    found = foreign.detections(table, foreign.read_mapping(rule), load("ring_road"))
    assert np.all(np.sqrt(found.covariance[:, 2, 2]) > 50)
    assert call("import", table, "--map", rule, "--scene", "ring_road", "--out", tmp_path / "d.h5") == 0
    history = slam(call, tmp_path / "d.h5", "--doppler-std", "none")
    assert np.all(np.isfinite(history.mean)) and history.steps == ours.steps


PLANE = """
[columns]
time = "t"
delay = "toa"
aoa_azimuth = "phi"
[units]
delay = "ns"
aoa_azimuth = "deg"
[std]
delay = 0.5
aoa_azimuth = 2.0
aoa_elevation = 0.01
[assumed]
aoa_elevation = 0.0
"""


@pytest.mark.parametrize(("step", "seed"), [(0.0, 0), (0.5, 1)])
def test_delay_and_arrival_in_the_plane_place_a_receiver_without_odometry(tmp_path, call, step, seed):
    """Still, or walking at random with a speed of zero in the filter; four walls unknown, a tenth of the paths missed."""
    rng, count = np.random.default_rng(seed), 40
    place = np.array([60.0, 10.0]) + np.cumsum(rng.normal(size=(count, 2)) * step, axis=0)
    heading = np.pi / 2 + np.cumsum(rng.normal(size=count) * 0.01)
    anchors = np.array([[0, 0], [200, 0], [-200, 0], [0, 200], [0, -200.0]])
    k, m = np.nonzero(rng.random((count, len(anchors))) < 0.9)
    apart = anchors[m] - place[k]
    columns = {
        "t": k + 0.0,
        "toa": (np.hypot(*apart.T) + rng.normal(size=len(k)) * 0.15) / 0.299792458,
        "phi": np.degrees(np.arctan2(apart[:, 1], apart[:, 0]) - heading[k] + rng.normal(size=len(k)) * 0.035),
    }
    table, rule = write(tmp_path, columns, PLANE)
    settings = [
        "track.speed=0", "track.turn_rate=0", "track.period=1.0", "track.start=[60, 10, 1.57, 0]",
        "track.start_std=[1, 1, 0.05, 0.1]", f"track.process_std=[{step}, {step}, 0.01, 0.001]", "base_station.position=[0, 0, 0]",
    ]  # fmt: skip
    command = ["import", table, "--map", rule, "--scene", "ring_road", "--out", tmp_path / "d.h5"]
    assert call(*command, *(word for text in settings for word in ("--set", text))) == 0
    history = slam(call, tmp_path / "d.h5", "--doppler-std", "none")
    error = np.linalg.norm(history.mean[:, :2] - place, axis=1)
    assert history.steps == count
    if step:
        lost = np.linalg.norm(place - place[0], axis=1)
        assert np.sqrt(np.mean(error**2)) < 0.5 * np.sqrt(np.mean(lost**2))
    else:
        assert error[-1] < 3 * np.sqrt(np.trace(history.covariance[-1][:2, :2]))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('delay = "toa"', 'dealy = "toa"', "unknown key columns.dealy"),
        ('delay = "toa"', 'delay = "toaa"', "no column 'toaa'; it has k, toa"),
        ('delay = "ns"', 'delay = "miles"', "known are s, ms, us, ns, ps, m"),
        ('"zenith"', '"upside"', "choose one of"),
        ("delay = 0.3", "", "how accurate is delay"),
        ("delay = 0.3", "delay = -1", "positive"),
        ('step = "k"', "", "needs time or step"),
        ("[offsets]", "[offset]", r"unknown section \[offset\]"),
        ("[columns]", "[columns", "not a readable TOML"),
        ("delay = 12.5", "delay = true", "wrong type"),
    ],
)
def test_a_wrong_mapping_is_one_error(tmp_path, ours, old, new, message):
    table, rule = write(tmp_path, foreign_columns(ours), FULL.replace(old, new, 1))
    with pytest.raises(DatasetError, match=message):
        foreign.detections(table, foreign.read_mapping(rule), load("ring_road"))


@pytest.mark.parametrize(
    ("text", "message"),
    [("", "cannot be read"), ("k,toa\n", "no column"), ("k,toa,phi,theta,pa,pe,fd\n0,1,2,3,4,5,inf\n", "holds inf in data row 1"),
     ("k,toa,phi,theta,pa,pe,fd\n0,1,2,3,4,5,x\n", "no number"), ("k,toa,phi,theta,pa,pe,fd\n0,1,2\n", "cannot be read"),
     ("k,toa,phi,theta,pa,pe,fd\n0.5,1,2,3,4,5,6\n", "whole")],
)  # fmt: skip
def test_a_wrong_table_is_one_error(tmp_path, text, message):
    (tmp_path / "t.csv").write_text(text)
    (tmp_path / "m.toml").write_text(FULL)
    with pytest.raises(DatasetError, match=message):
        foreign.detections(tmp_path / "t.csv", foreign.read_mapping(tmp_path / "m.toml"), load("ring_road"))
