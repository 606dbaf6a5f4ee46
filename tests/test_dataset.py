"""The dataset file: exact round trips, one clear error for anything damaged, never half written."""

import os
import stat
from pathlib import Path

import h5py
import numpy as np
import pytest

from dopslam.errors import DatasetError
from dopslam.evaluate.bounds import Bound
from dopslam.records import DetectionSeries, FloorPlan, Kind, Landmarks, Paths, Track, same
from dopslam.slam.history import History
from dopslam.store import columns
from dopslam.store import file as dataset


def make_track(steps=3):
    rng = np.random.default_rng(1)
    return Track(
        time=np.arange(steps) * 0.5,
        position=rng.normal(size=(steps, 3)),
        heading=rng.normal(size=steps),
        velocity=rng.normal(size=(steps, 3)),
        bias=np.full(steps, 300.0),
        start=np.array([70.0, 0.0, 1.5, 300.0]),
    )


def make_landmarks():
    return Landmarks(
        name=np.array(["BS", "VA wall_east", "SP ö"]),
        kind=np.array([0, 1, 2], np.int8),
        position=np.eye(3),
        order=np.array([0, 1, 1]),
    )


def make_paths(rows=(2, 0, 1)):
    n = sum(rows)
    rng = np.random.default_rng(2)
    return Paths(
        offsets=np.concatenate([[0], np.cumsum(rows)]),
        landmark=np.arange(n),
        a=rng.normal(size=n) + 1j * rng.normal(size=n),
        vertex_offsets=np.arange(n + 1),
        vertices=rng.normal(size=(n, 3)),
        **{name: rng.normal(size=n) for name in ("tau", "theta_t", "phi_t", "theta_r", "phi_r", "doppler")},
    )


def make_detections(rows=(2, 0, 1)):
    n = sum(rows)
    return DetectionSeries(
        offsets=np.concatenate([[0], np.cumsum(rows)]),
        delay=np.full(n, 1e-6),
        aoa=np.zeros((n, 2)),
        aod=np.zeros((n, 2)),
        radial_velocity=np.zeros(n),
        gain=np.ones(n, complex),
        covariance=np.broadcast_to(np.eye(6), (n, 6, 6)).copy(),
        snr=np.full(n, 100.0),
        noise_variance=np.ones(len(rows)),
        threshold=28.0,
        false_alarm_rate=0.01,
        search_volume=1.0,
    )


RECORDS = [make_track(), make_landmarks(), make_paths(), make_paths(rows=(0, 0)), make_detections()]


@pytest.mark.parametrize("record", RECORDS, ids=lambda r: type(r).__name__)
def test_a_record_comes_back_exactly(tmp_path, record):
    path = tmp_path / "d.h5"
    dataset.write_record(path, "it", record, scenario_toml='name = "x"', seed=7)
    back = dataset.read_record(path, "it", type(record))
    assert same(record, back)
    assert dataset.content_hash(record) == dataset.content_hash(back)
    assert dataset.read_root(path) == ('name = "x"', 7)


def test_records_are_added_beside_each_other_and_replaced(tmp_path):
    path = tmp_path / "d.h5"
    dataset.write_record(path, "track", make_track())
    dataset.write_record(path, "paths", make_paths())
    dataset.write_record(path, "track", make_track(5))
    assert dataset.groups(path) == ["paths", "track"]
    assert dataset.read_record(path, "track", Track).steps == 5


def test_what_is_missing_is_named(tmp_path):
    path = tmp_path / "d.h5"
    with pytest.raises(DatasetError, match="no such dataset"):
        dataset.read_record(path, "paths", Paths)
    dataset.write_record(path, "track", make_track())
    with pytest.raises(DatasetError, match="'paths'.*it holds track"):
        dataset.read_record(path, "paths", Paths)
    with pytest.raises(DatasetError, match="is missing"):
        dataset.read_record(path, "track", Paths)


def test_a_foreign_or_future_file_is_refused_and_left_alone(tmp_path):
    path = tmp_path / "d.h5"
    with h5py.File(path, "w") as file:
        file["x"] = 1
    before = path.read_bytes()
    with pytest.raises(DatasetError, match="not a dopslam dataset"):
        dataset.write_record(path, "track", make_track())
    assert path.read_bytes() == before
    with h5py.File(path, "a") as file:
        file.attrs.update(schema="dopslam", schema_version=99)
    with pytest.raises(DatasetError, match="version 99"):
        dataset.read_record(path, "track", Track)


def test_truncated_files_give_one_error(tmp_path):
    path = tmp_path / "d.h5"
    dataset.write_record(path, "paths", make_paths())
    whole = path.read_bytes()
    for size in (0, 10, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:size])
        with pytest.raises(DatasetError):
            dataset.read_record(path, "paths", Paths)


def test_a_changed_byte_is_noticed_or_harmless(tmp_path):
    path = tmp_path / "d.h5"
    record = make_paths(rows=(40, 60))
    dataset.write_record(path, "paths", record)
    whole = path.read_bytes()
    rng = np.random.default_rng(3)
    noticed = 0
    for position in rng.integers(0, len(whole), 150):
        changed = bytearray(whole)
        changed[position] ^= 0xFF
        path.write_bytes(changed)
        try:
            assert same(dataset.read_record(path, "paths", Paths), record)
        except DatasetError:
            noticed += 1
    assert noticed > 20


def test_a_large_record_is_hashed_beside_reading_and_its_damage_noticed(tmp_path):
    path, record = tmp_path / "d.h5", make_paths(rows=(60_000, 40_001))
    assert sum(column.nbytes for column in vars(record).values()) > columns.OVERLAP
    dataset.write_record(path, "paths", record)
    assert same(dataset.read_record(path, "paths", Paths), record)
    assert dataset.verify_group(path, "paths") == dataset.content_hash(record)
    whole = path.read_bytes()
    for name in ("a", "vertices"):  # the first and the last that are read, in the last chunk
        at = whole.rindex(getattr(record, name)[-1:].tobytes())
        path.write_bytes(whole[: at + 2] + bytes([whole[at + 2] ^ 1]) + whole[at + 3 :])
        with pytest.raises(DatasetError, match="does not match its checksum"):
            dataset.read_record(path, "paths", Paths)


def test_a_damaged_signal_is_noticed_whole_and_by_the_snapshot(tmp_path):
    path, rng = tmp_path / "d.h5", np.random.default_rng(4)
    snapshots = [rng.normal(size=(40, 30, 2)).astype(np.complex64) for _ in range(3)]
    dataset.write_record(path, "track", make_track())
    dataset.write_signal(path, iter(snapshots), 3)
    dataset.verify_group(path, "signal")
    whole = path.read_bytes()
    at = whole.rindex(snapshots[1][-1, -1].tobytes())
    path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
    assert np.array_equal(dataset.read_snapshot(path, 0), snapshots[0])
    with pytest.raises(DatasetError, match="damaged"):
        dataset.read_snapshot(path, 1)
    with pytest.raises(DatasetError, match="does not match its checksum"):
        dataset.verify_group(path, "signal")


def test_a_failed_write_leaves_the_old_file_and_no_litter(tmp_path, monkeypatch):
    path = tmp_path / "d.h5"
    dataset.write_record(path, "track", make_track())
    before = path.read_bytes()

    def full_disk(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(dataset, "_write_group", full_disk)
    with pytest.raises(DatasetError, match="No space left"):
        dataset.write_record(path, "paths", make_paths())
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["d.h5"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_folder_is_one_error(tmp_path):
    tmp_path.chmod(stat.S_IRUSR | stat.S_IXUSR)
    with pytest.raises(DatasetError, match="cannot write"):
        dataset.write_record(tmp_path / "d.h5", "track", make_track())


def test_the_signal_is_streamed_a_snapshot_at_a_time(tmp_path):
    path = tmp_path / "d.h5"
    dataset.write_record(path, "track", make_track())
    rng = np.random.default_rng(4)
    snapshots = [(rng.normal(size=(4, 3)) + 1j).astype(np.complex64) for _ in range(3)]
    dataset.write_signal(path, iter(snapshots), 3)
    assert dataset.signal_steps(path) == 3
    for step in range(3):
        assert np.array_equal(dataset.read_snapshot(path, step), snapshots[step])
    assert dataset.groups(path) == ["signal", "track"]


def test_non_finite_columns_are_refused():
    from dataclasses import replace

    from dopslam.errors import DopslamError

    with pytest.raises(DopslamError, match="non-finite"):
        replace(make_paths(), tau=np.array([1.0, np.nan, 2.0]))
    with pytest.raises(DopslamError, match="offsets"):
        replace(make_paths(), offsets=np.array([0, 5, 2, 3]))


@pytest.mark.parametrize("external", ["link", "storage"])
def test_a_file_that_reads_from_other_files_is_refused(tmp_path, external):
    path = tmp_path / "d.h5"
    with h5py.File(path, "w") as file:
        file.attrs["schema"], file.attrs["schema_version"] = dataset.SCHEMA, dataset.READ[-1]
        group = file.create_group("track")
        if external == "link":
            group["time"] = h5py.ExternalLink("other.h5", "/time")
        else:
            group.create_dataset("time", shape=(4,), dtype="f8", external=[(str(tmp_path / "raw"), 0, 32)])
    with pytest.raises(DatasetError, match="copy its content"):
        dataset.read_record(path, "track", Track)


VERSION_1 = Path(__file__).parent / "data"
"""Files that this program wrote before schema 2 (commit dc2970d): three steps simulated, with history and bound; traced."""


def test_files_of_version_1_are_read(tmp_path, call):
    """Every record of a real one, with what was not in it filled in; it can be worked on, and is no faulty file."""
    simulated = tmp_path / "simulated.h5"
    simulated.write_bytes((VERSION_1 / "version_1.h5").read_bytes())
    with h5py.File(simulated) as file:
        assert file.attrs["schema_version"] == 1
        before, detected = file["slam_joint/va_probability"][:], file["detections/delay"][:]
    found = dataset.read_record(simulated, "detections", DetectionSeries)
    np.testing.assert_array_equal(found.delay, detected)
    assert found.steps == 3 and not found.anchor.any() and not found.flags.any()
    history = dataset.read_record(simulated, "slam_joint", History)
    np.testing.assert_array_equal(history.type_probability[:, Kind.VA], before)
    np.testing.assert_allclose(history.type_probability.sum(axis=1), 1.0)
    assert dataset.read_record(simulated, "bound_doppler", Bound).covariance.shape == (3, 4, 4)
    assert call("check", simulated) == 0
    assert call("bound", simulated) == 0  # writes into it: a file of both versions is read too
    assert call("evaluate", simulated) == 0 and call("check", simulated) == 0
    np.testing.assert_array_equal(dataset.read_record(simulated, "slam_joint", History).mean, history.mean)

    traced = VERSION_1 / "version_1_traced.h5"
    paths = dataset.read_record(traced, "paths", Paths)
    assert len(paths.tau) == 27 and not paths.anchor.any()
    assert len(dataset.read_record(traced, "plan", FloorPlan).name) == 4 and call("check", traced) == 0
