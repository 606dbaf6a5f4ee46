"""Large datasets: the same for any interruption, order and process; everything wrong is named."""

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest

from dopslam.config.scenario import load
from dopslam.datasets import check, make_plan, read_manifest
from dopslam.datasets.shard import expected_groups
from dopslam.datasets.tracks import Steps
from dopslam.errors import ConfigError, DatasetError
from dopslam.records import Landmarks, Paths, Track, same
from dopslam.store import file as dataset


def content(folder):
    return {p.name for p in folder.iterdir()}


def copy(folder, tmp_path):
    return shutil.copytree(folder, tmp_path / "copy")


def test_a_dataset_is_whole_and_checks(made):
    manifest = read_manifest(made)
    assert manifest.complete and manifest.sha256 == manifest.digest()
    assert [entry.positions for entry in manifest.shards] == [7, 7, 7, 7, 3]
    assert sum(entry.paths for entry in manifest.shards) == 31 * 6
    assert content(made) == {"manifest.json", *(entry.file for entry in manifest.shards)}
    assert check(made) == []
    assert [mark["name"] for mark in manifest.landmarks][:2] == ["BS", "VA wall_east"]


def test_steps_say_which_drive_each_position_belongs_to(made):
    parts = [dataset.read_record(made / entry.file, "steps", Steps) for entry in read_manifest(made).shards]
    index, drive, step = (np.concatenate([getattr(p, name) for p in parts]) for name in ("index", "drive", "step"))
    assert np.array_equal(index, np.arange(31))
    assert np.array_equal(drive, np.arange(31) // 5)
    assert np.array_equal(step, np.arange(31) % 5)


def test_the_size_of_shards_changes_no_position(made, worker, tmp_path):
    worker.make(tmp_path / "other", 31, settings=["dataset.shard_positions=31"])
    whole = dataset.read_record(tmp_path / "other" / "shard-00000.h5", "paths", Paths)
    tau = [dataset.read_record(made / entry.file, "paths", Paths).tau for entry in read_manifest(made).shards]
    assert np.array_equal(np.concatenate(tau), whole.tau)


def test_another_seed_is_another_dataset(made, worker, tmp_path):
    assert worker.make(tmp_path / "d", 31, seed=4).sha256 != read_manifest(made).sha256


def test_missing_and_damaged_shards_are_made_again(made, worker, tmp_path):
    folder = copy(made, tmp_path)
    (folder / "shard-00001.h5").unlink()
    with h5py.File(folder / "shard-00003.h5", "r+") as file:
        file["paths/tau"][2] = 1.0
    kept = (folder / "shard-00002.h5").stat().st_mtime_ns
    assert worker.make(folder, 31, resume=True).sha256 == read_manifest(made).sha256
    assert (folder / "manifest.json").read_bytes() == (made / "manifest.json").read_bytes()
    assert (folder / "shard-00002.h5").stat().st_mtime_ns == kept
    assert check(folder) == []


def test_a_folder_with_something_else_is_refused_and_left_alone(made, worker, tmp_path):
    with pytest.raises(DatasetError, match="--resume"):
        worker.make(made, 31)
    with pytest.raises(DatasetError, match="another dataset: seed is 3 there and 9 here"):
        worker.make(made, 31, resume=True, seed=9)
    with pytest.raises(DatasetError, match="another dataset: the scenario has 'max_depth = 1' there"):
        worker.make(made, 31, resume=True, settings=["trace.max_depth=2"])
    (tmp_path / "mine.txt").write_text("x")
    with pytest.raises(DatasetError, match="not empty"):
        worker.make(tmp_path, 31)
    assert content(tmp_path) == {"mine.txt"}


@pytest.mark.parametrize(("positions", "seed", "message"), [(0, 0, "--positions 0"), (5, -1, "--seed -1")])
def test_impossible_plans_are_refused(positions, seed, message):
    with pytest.raises(ConfigError, match=message):
        make_plan(load("ring_road"), positions, seed)


def test_a_shard_s_signal_is_bounded():
    scenario = load("ring_road", ["dataset.shard_megabytes=100"])
    assert make_plan(scenario, 5000, 0).shard_positions == 2000
    assert make_plan(scenario, 5000, 0, signal=True).shard_positions == int(100e6 // (400 * 128 * 16 * 8))


SMALL = [
    "radio.subcarriers=32", "radio.beams.beams=4", "radio.beams.sweeps=2", "receiver.array.columns=4",
    "base_station.array.columns=4", "estimator.max_paths=3",
]  # fmt: skip


@pytest.mark.proc
def test_signal_and_detections_are_the_same_for_any_shards_and_workers(worker, tmp_path):
    first = worker.make(tmp_path / "a", 8, settings=SMALL, signal=True, detections=True)
    assert worker.make(tmp_path / "b", 8, settings=SMALL, signal=True, detections=True, jobs=2).sha256 == first.sha256
    worker.make(tmp_path / "c", 8, settings=[*SMALL, "dataset.shard_positions=3"], signal=True)
    path = tmp_path / "a" / "shard-00000.h5"
    assert set(dataset.groups(path)) == expected_groups(first.plan)
    assert np.array_equal(dataset.read_snapshot(path, 4), dataset.read_snapshot(tmp_path / "c" / "shard-00001.h5", 1))
    assert check(tmp_path / "a") == []


def start(program, folder, *options):
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, str(program), str(folder), "31", "--resume", *options]
    return subprocess.Popen(command, env=environment, stderr=subprocess.PIPE)


@pytest.mark.proc
def test_killed_at_random_moments_it_ends_with_the_same_hash(made, program, worker, tmp_path):
    folder, rng, killed = tmp_path / "d", np.random.default_rng(6), 0
    for _ in range(3):
        process = start(program, folder, "--slow", "0.2")
        deadline = time.monotonic() + 60
        while not (folder / "manifest.json").exists() and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.01)
        time.sleep(rng.uniform(0, 0.5))
        process.send_signal(signal.SIGKILL)
        killed += process.wait() == -signal.SIGKILL
        process.stderr.close()
        process.poll()
    assert killed >= 1
    manifest = worker.make(folder, 31, resume=True)
    assert manifest == read_manifest(made)
    assert check(folder) == []


@pytest.mark.proc
def test_two_processes_share_a_folder(made, program, tmp_path):
    folder = tmp_path / "d"
    pair = [start(program, folder, "--slow", "0.1") for _ in range(2)]
    for process in pair:
        _, errors = process.communicate(timeout=120)
        assert process.returncode == 0, errors.decode()
    assert read_manifest(folder) == read_manifest(made)
    assert content(folder) == content(made)
    assert check(folder) == []


def test_a_full_disk_is_one_error_and_resumable(made, worker, tmp_path):
    folder = tmp_path / "d"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
        with pytest.raises(DatasetError, match=r"shard.*(write|writing)"):
            worker.make(folder, 31)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    assert not list(folder.glob("shard-*"))
    assert worker.make(folder, 31, resume=True) == read_manifest(made)


def test_a_folder_that_cannot_be_written_is_one_error(worker, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("x")
    with pytest.raises(DatasetError, match="cannot be made"):
        worker.make(tmp_path / "file" / "d", 3)

    def read_only(*_, **__):
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr("tempfile.mkstemp", read_only)
    with pytest.raises(DatasetError, match="Read-only"):
        worker.make(tmp_path / "d", 3)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda d: (d / "shard-00002.h5").unlink(), "no such dataset file"),
        (lambda d: (d / "manifest.json").write_text("{"), "not a readable manifest"),
        (lambda d: (d / "manifest.json").unlink(), "no such manifest"),
        (lambda d: _edit(d, lambda t: t["shards"][1].update(paths=43)), "does not match its own checksum"),
        (lambda d: _edit(d, lambda t: t.update(version=9)), "version 9"),
        (lambda d: _edit(d, lambda t: t["plan"].update(positions="31")), "no int"),
        (lambda d: shutil.copy(d / "shard-00002.h5", d / "shard-00001.h5"), "another scenario, seed or number"),
        (lambda d: (d / "notes.txt").write_text("x"), "no part of this dataset"),
        (lambda d: _poke(d / "shard-00001.h5", "paths/tau"), "does not match its checksum"),
    ],
)  # fmt: skip
def test_check_says_what_is_wrong_where(made, tmp_path, damage, message):
    folder = copy(made, tmp_path)
    damage(folder)
    findings = check(folder)
    assert len(findings) == 1
    assert message in findings[0].what


def _edit(folder, change):
    tree = json.loads((folder / "manifest.json").read_text())
    change(tree)
    (folder / "manifest.json").write_text(json.dumps(tree))


def _poke(path, name):
    with h5py.File(path, "r+") as file:
        file[name][0] += 1e-12


def test_check_finds_false_physics_behind_right_checksums(made, tmp_path):
    from dataclasses import replace

    path = tmp_path / "d.h5"
    shutil.copy(made / "shard-00000.h5", path)
    paths = dataset.read_record(path, "paths", Paths)
    assert check(path) == []
    later, turned, elsewhere = paths.tau.copy(), paths.phi_r.copy(), paths.landmark.copy()
    later[3] += 1e-13
    turned[4] += 1e-3
    elsewhere[0] = 17
    for wrong, where in (
        (replace(paths, tau=later), "d.h5:paths/tau"),
        (replace(paths, phi_r=turned), "d.h5:paths/theta_r, phi_r"),
        (replace(paths, landmark=elsewhere), "d.h5:paths/landmark"),
    ):
        dataset.write_record(path, "paths", wrong)
        assert [finding.where for finding in check(path)] == [where]


def test_the_command_line_checks_and_informs(made, tmp_path, call, capsys):
    assert call("check", made) == 0
    assert call("info", made) == 0
    assert "31 positions in 5 shards" in capsys.readouterr().out
    assert call("info", made / "shard-00000.h5") == 0
    folder = copy(made, tmp_path)
    (folder / "shard-00002.h5").write_bytes(b"x")
    assert call("check", folder) == 2
    captured = capsys.readouterr()
    assert "shard-00002.h5" in captured.out and "1 fault" in captured.err


@pytest.mark.rt
def test_traced_datasets_equal_the_traced_stage(tmp_path, call):
    settings = ["--set", "trace.samples=20000", "--set", "track.steps=6"]
    options = ["dataset", "ring_road", "--seed", "5", *settings, "--positions", "9"]
    assert call(*options, "--out", tmp_path / "d") == 0
    assert call(*options, "--out", tmp_path / "e", "--set", "dataset.shard_positions=4") == 0
    assert call("trace", "ring_road", "--seed", "5", *settings, "--out", tmp_path / "t.h5") == 0
    assert check(tmp_path / "d") == [] and check(tmp_path / "e") == []
    track = dataset.read_record(tmp_path / "t.h5", "track", Track)
    paths = dataset.read_record(tmp_path / "t.h5", "paths", Paths)
    mine = dataset.read_record(tmp_path / "d" / "shard-00000.h5", "paths", Paths)
    assert np.array_equal(
        dataset.read_record(tmp_path / "d" / "shard-00000.h5", "track", Track).position[:6], track.position
    )
    for name in ("landmark", "a", "tau", "phi_r", "doppler"):
        assert np.array_equal(getattr(mine, name)[: len(paths.tau)], getattr(paths, name))
    shards = [dataset.read_record(tmp_path / "e" / f"shard-0000{i}.h5", "paths", Paths) for i in range(3)]
    assert np.array_equal(np.concatenate([p.a for p in shards]), mine.a)
    assert same(*(dataset.read_record(tmp_path / p, "landmarks", Landmarks) for p in ("t.h5", "d/shard-00000.h5")))
