"""Data of one's own, one test for each kind of fault that used to mislead in silence: it is read right, or refused in
one line that says what, where and the remedy."""

import csv

import numpy as np
import pytest

from dopslam.config.scenario import load
from dopslam.datasets import drives, tracks
from dopslam.errors import ConfigError
from dopslam.pipeline import file as stages
from dopslam.pipeline import problem as build
from dopslam.pipeline import stages as pipeline
from dopslam.records import DetectionSeries, Track
from dopslam.simulate.world import draw_scans
from dopslam.slam.history import History
from dopslam.store import file as dataset
from dopslam.store.schema import plain

MAP = """noise_floor_db = 0.0
[columns]
time = "t"
delay = "toa"
aoa_azimuth = "phi"
aoa_elevation = "th"
aod_azimuth = "aodaz"
aod_elevation = "aodel"
radial_velocity = "vr"
snr = "snr"
[units]
delay = "ns"
aoa_azimuth = "deg"
aoa_elevation = "deg"
aod_azimuth = "deg"
aod_elevation = "deg"
snr = "dB"
[std]
delay = 0.34
aoa_azimuth = 2.87
aoa_elevation = 2.87
aod_azimuth = 2.87
aod_elevation = 2.87
radial_velocity = 0.1
"""


@pytest.fixture(scope="module")
def drawn():
    """Track and detections of twenty steps around the ring, as a table in ns, degrees and dB, and its track."""
    scenario = load("ring_road", ["source.kind=model", "track.steps=20"])
    track, _, d = pipeline.simulate(scenario, seed=5)
    snr = np.random.default_rng(5).uniform(15, 40, len(d.delay))
    step = d.step_of_row
    table = {
        "t": track.time[step], "toa": d.delay * 1e9, "phi": np.degrees(d.aoa[:, 0]), "th": np.degrees(d.aoa[:, 1]),
        "aodaz": np.degrees(d.aod[:, 0]), "aodel": np.degrees(d.aod[:, 1]), "vr": d.radial_velocity, "snr": snr,
    }  # fmt: skip
    truth = {
        "time": track.time,
        "x": track.position[:, 0],
        "y": track.position[:, 1],
        "heading": track.heading,
        "bias": track.bias,
    }
    return track, table, truth


def write(path, columns, mark=""):
    with open(path, "w", newline="", encoding="utf-8") as file:
        file.write(mark)
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(np.column_stack(list(columns.values())).tolist())
    return path


def bring(call, folder, columns, *more, mapping=MAP):
    """Exit status of an import of a table into d.h5."""
    table, rule = write(folder / "t.csv", columns), folder / "m.toml"
    rule.write_text(mapping)
    return call("import", table, "--map", rule, "--scene", "ring_road", "--out", folder / "d.h5", *more)


def errors(path):
    """Position errors [m] of the only filter's history in a file."""
    group = next(name for name in dataset.groups(path) if name.startswith("slam_"))
    history, truth = dataset.read_record(path, group, History), dataset.read_record(path, "track", Track)
    return np.linalg.norm(history.mean[:, :2] - truth.position[:, :2], axis=1)


def refused(call, capsys, *command):
    """The one line with which a command is refused."""
    assert call(*command) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    return lines[0]


# Tables of detections


def test_detections_that_begin_late_are_matched_to_the_track_by_time(tmp_path, drawn, call):
    """The first three snapshots and one in the middle found nothing: they stay, empty."""
    track, table, truth = drawn
    out = np.isin(table["t"], track.time[[0, 1, 2, 9]])
    late = {name: column[~out] for name, column in table.items()}
    assert bring(call, tmp_path, late, "--track", write(tmp_path / "track.csv", truth)) == 0
    d = dataset.read_record(tmp_path / "d.h5", "detections", DetectionSeries)
    assert d.steps == 20 and np.flatnonzero(np.diff(d.offsets) == 0).tolist() == [0, 1, 2, 9]
    assert call("slam", tmp_path / "d.h5") == 0
    assert errors(tmp_path / "d.h5")[3:].max() < 2.0


@pytest.mark.parametrize("late", [0, 3])
def test_without_a_track_the_first_detection_is_the_first_step(tmp_path, drawn, call, late):
    track, table, _ = drawn
    some = {name: column[table["t"] >= track.time[late]] for name, column in table.items()}
    assert bring(call, tmp_path, some) == 0
    assert dataset.read_record(tmp_path / "d.h5", "detections", DetectionSeries).steps == 20 - late


def test_irregular_time_stamps_decide(tmp_path, drawn, call):
    """A third of the snapshots is missing and the clock of the log is uneven: the filter steps by what the stamps say."""
    track, table, truth = drawn
    shift = np.cumsum(np.random.default_rng(8).uniform(0, 0.4, 20)) - 0.2  # s, against the even drive
    time = track.time + shift
    place = np.stack([np.interp(time, track.time + shift, track.position[:, i]) for i in range(2)], axis=1)
    uneven = table | {"t": time[np.searchsorted(track.time, table["t"])]}
    truth = truth | {"time": time, "x": place[:, 0], "y": place[:, 1]}
    for more in ([], ["--track", write(tmp_path / "track.csv", truth)]):
        (tmp_path / "d.h5").unlink(missing_ok=True)
        assert bring(call, tmp_path, uneven, *more) == 0
        d = dataset.read_record(tmp_path / "d.h5", "detections", DetectionSeries)
        assert np.allclose(d.time, time)
        intervals = build.scans(stages.scenario_of(tmp_path / "d.h5")[0], d).interval
        assert np.allclose(intervals[1:], np.diff(time))


def test_a_period_of_the_stamps_takes_its_share_of_the_process_noise(tmp_path, drawn, call):
    _, table, _ = drawn
    assert bring(call, tmp_path, table | {"t": table["t"] / 5}) == 0
    told = stages.scenario_of(tmp_path / "d.h5")[0].track
    own = load("ring_road").track
    assert told.period == pytest.approx(own.period / 5)
    assert np.allclose(told.process_std, np.array(own.process_std) / np.sqrt(5))
    assert (
        build.scans(stages.scenario_of(tmp_path / "d.h5")[0], stages.read_detections(tmp_path / "d.h5")).interval
        is None
    )


def test_a_detection_between_two_steps_of_the_track_is_refused(tmp_path, drawn, call, capsys):
    _, table, truth = drawn
    astray = table | {"t": np.where(np.arange(len(table["t"])) == 40, table["t"] + 0.25, table["t"])}
    write(tmp_path / "track.csv", truth)
    assert bring(call, tmp_path, astray, "--track", tmp_path / "track.csv") == 2
    assert "data row 41 at " in capsys.readouterr().err


def test_delays_modulo_a_range_of_another_link(tmp_path, drawn, call):
    """The mapping says it in the table's unit; the prior says the turn."""
    _, table, truth = drawn
    wrapped = table | {"toa": table["toa"] % 700.0}
    mapping = "delay_modulo = 700.0\n" + MAP
    assert np.any(table["toa"] > 700.0)
    assert bring(call, tmp_path, wrapped, "--track", write(tmp_path / "track.csv", truth), mapping=mapping) == 0
    d = dataset.read_record(tmp_path / "d.h5", "detections", DetectionSeries)
    assert d.delay_range == pytest.approx(700e-9)
    lengths = build.scans(stages.scenario_of(tmp_path / "d.h5")[0], d).z[:, 0] / 0.299792458
    assert np.median(np.abs(lengths - table["toa"])) < 1e-6  # but for false alarms
    assert bring(call, tmp_path, wrapped, mapping="delay_modulo = -1\n" + MAP) == 2


def test_detections_of_another_drive_are_refused(tmp_path, drawn, call, capsys):
    _, table, truth = drawn
    short = {name: column[:12] for name, column in truth.items()}
    write(tmp_path / "track.csv", short)
    assert bring(call, tmp_path, table, "--track", tmp_path / "track.csv") == 2
    assert "outside the track's 12 steps, the first in data row" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("column", "change", "mapping", "said"),
    [
        ("th", lambda v: 90 - v + 60, MAP, "elevation beyond 90°: degrees taken for radians, or counted from the zenith?"),
        ("th", lambda v: v, MAP.replace('aoa_elevation = "deg"\n', "", 1), "elevation beyond 90°"),
        ("phi", lambda v: v, MAP.replace('aoa_azimuth = "deg"\n', "", 1), "azimuth beyond two turns: degrees taken for radians?"),
        ("toa", lambda v: v, MAP.replace('delay = "ns"', 'delay = "us"', 1), None),
        ("toa", lambda v: v * 1e12, MAP, "delay of more than 1000 km"),
        ("vr", lambda v: v * 1e9, MAP, "radial velocity of more than 100 km/s"),
    ],
)  # fmt: skip
def test_numbers_that_cannot_be_are_refused_with_row_and_column(
    tmp_path, drawn, call, capsys, column, change, mapping, said
):
    _, table, _ = drawn
    status = bring(call, tmp_path, table | {column: change(table[column])}, mapping=mapping)
    if said is None:  # hundreds of kilometres: far, but a delay can be as long
        assert status == 0
        return
    message = capsys.readouterr().err
    assert status == 2 and said in message and "in data row " in message and message.count("\n") == 1
    assert not (tmp_path / "d.h5").exists()


def test_a_column_that_stands_twice_is_refused(tmp_path, drawn, call, capsys):
    _, table, _ = drawn
    path, rule = write(tmp_path / "t.csv", table), tmp_path / "m.toml"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0] + ",phi", *(line + ",0.0" for line in lines[1:])]))
    rule.write_text(MAP)
    command = ("import", path, "--map", rule, "--scene", "ring_road", "--out", tmp_path / "d.h5")
    assert "column 'phi' stands in the header twice" in refused(call, capsys, *command)


def test_power_without_a_noise_floor_and_a_table_without_rows_are_refused(tmp_path, drawn, call, capsys):
    _, table, _ = drawn
    bare = (
        MAP.replace("noise_floor_db = 0.0\n", "")
        .replace('snr = "snr"', 'power = "snr"')
        .replace('snr = "dB"', 'power = "dB"')
    )
    assert bring(call, tmp_path, table, mapping=bare) == 2
    assert "without noise_floor_db = … (dB)" in capsys.readouterr().err
    assert bring(call, tmp_path, {name: column[:0] for name, column in table.items()}) == 2
    assert "holds a header but no row" in capsys.readouterr().err


def test_belief_propagation_takes_imported_strengths(tmp_path, drawn, call):
    """The weakest row of a table is the threshold that all of them passed; it is no detection below it."""
    _, table, truth = drawn
    assert bring(call, tmp_path, table, "--track", write(tmp_path / "track.csv", truth)) == 0
    d = dataset.read_record(tmp_path / "d.h5", "detections", DetectionSeries)
    assert d.threshold == d.snr.min()
    assert call("slam", tmp_path / "d.h5", "--filter", "bp", "--set", "filter.particles=300") == 0
    assert np.sqrt(np.mean(errors(tmp_path / "d.h5") ** 2)) < 3.0


# Tracks


def file_tracks(path, *more):
    return load("ring_road", ["dataset.tracks.kind=file", f"dataset.tracks.file={path}", *more])


def test_a_byte_order_mark_and_odd_names_do_not_matter(tmp_path, drawn, call):
    _, table, truth = drawn
    place = tmp_path / "Fährte [v2] №7.csv"
    write(place, truth, mark="\ufeff")
    assert bring(call, tmp_path, table, "--track", place) == 0
    assert np.allclose(dataset.read_record(tmp_path / "d.h5", "track", Track).position[:, 0], truth["x"])


def test_a_straight_drive_at_ten_hertz_is_filtered_as_one(tmp_path):
    """Not with the scenario's period of 0.5 s and its turn rate: those would be lost within a second."""
    time = 0.1 * np.arange(20)
    path = write(tmp_path / "t.csv", {"time": time, "x": np.full(20, 70.0), "y": 10 * time})
    world = file_tracks(path, "source.kind=model")
    track = tracks.sampled(world, 0).drive(0)
    told = drives.told(world, track)
    assert told.track.period == pytest.approx(0.1) and told.track.turn_rate == pytest.approx(0.0, abs=1e-12)
    assert told.track.speed == pytest.approx(10.0) and told.track.steps == 20
    situation = build.situation(told)
    scans = draw_scans(situation, track.state, *(np.random.default_rng(i) for i in (3, 4)))
    _, _, drawn = pipeline.simulate(told, 0)
    rows = {"delay": scans.z[:, 0] / 299_792_458.0, "aoa": scans.z[:, 1:3], "aod": scans.z[:, 3:5]}
    series = DetectionSeries(
        **rows, offsets=scans.offsets, radial_velocity=scans.z[:, 5], gain=np.zeros(len(scans.z), complex),
        covariance=np.broadcast_to(drawn.covariance[0], (len(scans.z), 6, 6)), snr=np.ones(len(scans.z)),
        noise_variance=np.ones(20), threshold=1.0, false_alarm_rate=1.0, search_volume=scans.search_volume, time=track.time,
    )  # fmt: skip
    history = pipeline.slam(told, series)
    off = np.linalg.norm(history.mean[:, :2] - track.position[:, :2], axis=1)
    bound = pipeline.bound(told, track, build.model_landmarks(told), None, series)
    assert np.sqrt(np.mean(off**2)) < 2 * np.sqrt(np.mean(bound.peb**2))


def test_a_drive_at_irregular_times_is_told_as_it_is(tmp_path):
    time = np.cumsum([0, 0.1, 0.1, 0.3, 0.1, 0.2, 0.1, 0.1, 0.5, 0.1])
    path = write(tmp_path / "t.csv", {"time": time, "x": np.full(10, 70.0), "y": 10 * time})
    world = file_tracks(path)
    told = drives.told(world, tracks.sampled(world, 0).drive(0)).track
    assert told.period == pytest.approx(0.1) and told.speed == pytest.approx(10.0)
    assert max(told.process_std[:2]) < 0.1  # a straight drive at constant speed does not stray


@pytest.mark.parametrize("times", [[0, 0.5, 0.4, 1.0], [0, 0.5, 0.5, 1.0]])
@pytest.mark.parametrize("velocities", [False, True])
def test_time_that_runs_back_or_stands_is_refused(tmp_path, times, velocities):
    columns = {"time": np.array(times), "x": np.full(4, 20.0), "y": np.arange(4.0)}
    if velocities:
        columns |= {"vx": np.zeros(4), "vy": np.full(4, 10.0), "vz": np.zeros(4)}
    with pytest.raises(ConfigError, match="time must rise within a drive, but"):
        tracks.sampled(file_tracks(write(tmp_path / "t.csv", columns)), 0)


def test_drives_keep_their_numbers(tmp_path):
    time = np.tile([0, 0.5, 1.0], 2)
    columns = {"time": time, "x": np.full(6, 20.0), "y": 10 * time, "drive": np.repeat([7.0, 3.0], 3)}
    _, steps = tracks.sampled(file_tracks(write(tmp_path / "t.csv", columns)), 0).part(0, 6)
    assert steps.drive.tolist() == [7, 7, 7, 3, 3, 3]


def test_a_waiting_car_holds_its_heading(tmp_path):
    time = 0.5 * np.arange(8)
    y = np.array([0, 5, 10, 15, 15, 15, 15, 20.0])
    path = write(tmp_path / "t.csv", {"time": time, "x": np.full(8, 20.0), "y": y})
    assert np.allclose(tracks.sampled(file_tracks(path), 0).drive(0).heading, np.pi / 2)


def test_a_step_without_paths_adds_no_information(tmp_path, drawn, call):
    """The receiver leaves the scene: the bound grows there, and every stage goes on."""
    track, table, truth = drawn
    seen = table["t"] < track.time[12]
    some = {name: column[seen] for name, column in table.items()}
    assert bring(call, tmp_path, some, "--track", write(tmp_path / "track.csv", truth)) == 0
    for command in ("slam", "bound", "evaluate"):
        assert call(command, tmp_path / "d.h5", *(["--out", tmp_path] if command == "evaluate" else [])) == 0
    from dopslam.evaluate.bounds import Bound

    peb = dataset.read_record(tmp_path / "d.h5", "bound_doppler", Bound).peb
    assert np.all(np.diff(peb[12:]) > 0)


# What a file says about itself


def test_histories_and_bounds_name_their_units_and_dimensions(tmp_path):
    import h5py

    path = tmp_path / "d.h5"
    stages.simulate(path, load("ring_road", ["source.kind=model", "track.steps=3"]), seed=1)
    stages.slam(path)
    stages.bound(path)
    with h5py.File(path) as file:
        units = {}
        for group in ("slam_joint", "bound_doppler"):
            for name, data in file[group].items():
                if data.attrs.get("CLASS") == b"DIMENSION_SCALE":
                    continue
                units[group, name] = plain(data.attrs["units"])
                for axis, size in zip(data.dims, data.shape, strict=True):
                    assert len(axis) == 1 and axis[0].shape == (size,), f"{group}/{name} has a dimension without name"
    assert units["slam_joint", "mean"] == "m, m, rad, m" and units["slam_joint", "position"] == "m"
    assert units["slam_joint", "covariance"] == units["bound_doppler", "covariance"] == "products of m, m, rad, m"
    assert units["slam_joint", "position_covariance"] == units["bound_doppler", "landmark"] == "m^2"
    assert {name for (_, name), unit in units.items() if unit == "1"} == {
        "existence", "kind", "map_offsets", "track", "type_probability",
    }  # fmt: skip
