"""Exports and files read by the programs they are meant for; each is skipped where its program is missing."""

import json
import shutil
import subprocess

import numpy as np
import pytest

from dopslam.formats.export import export
from dopslam.records import Landmarks, Paths, Track
from dopslam.store import file as dataset

pytestmark = pytest.mark.filterwarnings("ignore")  # those of other programs are not ours

SMALL = [
    "radio.subcarriers=32", "radio.beams.beams=4", "radio.beams.sweeps=2", "receiver.array.columns=4",
    "base_station.array.columns=4", "estimator.max_paths=3",
]  # fmt: skip


def test_evo_reads_the_trajectories(made, tmp_path):
    file_interface = pytest.importorskip("evo.tools.file_interface")
    export(made, tmp_path / "o", "tum")
    trajectory = file_interface.read_tum_trajectory_file(str(tmp_path / "o" / "drive-00000.tum"))
    track = dataset.read_record(made / "shard-00000.h5", "track", Track)
    assert trajectory.check()[0]
    assert np.allclose(trajectory.positions_xyz, track.position[:5], atol=1e-8)
    yaw = np.array([np.arctan2(pose[1, 0], pose[0, 0]) for pose in trajectory.poses_se3])
    assert np.allclose(np.exp(1j * yaw), np.exp(1j * track.heading[:5]))


def test_sigmf_validates_the_recording(worker, tmp_path):
    sigmf = pytest.importorskip("sigmf")
    worker.make(tmp_path / "d", 3, settings=SMALL, signal=True)
    export(tmp_path / "d", tmp_path / "o", "sigmf")
    recording = sigmf.fromfile(str(tmp_path / "o" / "part-00000.sigmf-meta"))
    recording.validate()
    y = np.stack([dataset.read_snapshot(tmp_path / "d" / "shard-00000.h5", k) for k in range(3)])
    assert np.array_equal(recording.read_samples(), y.reshape(-1))


def test_deepmimo_loads_the_scenario(made, tmp_path, monkeypatch):
    deepmimo = pytest.importorskip("deepmimo")
    (tmp_path / "deepmimo_scenarios").mkdir()
    export(made, tmp_path / "deepmimo_scenarios" / "ours", "deepmimo")
    monkeypatch.chdir(tmp_path)
    loaded = deepmimo.load("ours")
    paths = dataset.read_record(made / "shard-00000.h5", "paths", Paths)
    assert loaded.rx_pos.shape == (31, 3) and np.array_equal(loaded.num_paths, np.full(31, 6))
    assert np.allclose(np.sort(loaded.delay[0]), np.sort(paths.tau[:6]), rtol=1e-6)
    assert np.array_equal(loaded.los, np.ones(31))


def test_the_netcdf_library_reads_a_shard(made):
    netcdf = pytest.importorskip("netCDF4")
    path = made / "shard-00000.h5"
    with netcdf.Dataset(path) as file:
        assert np.array_equal(file["paths"]["tau"][:], dataset.read_record(path, "paths", Paths).tau)
        assert file["landmarks"]["name"][:2].tolist() == ["BS", "VA wall_east"]


def test_octave_reads_a_shard_and_the_matlab_tables(made, tmp_path):
    octave = shutil.which("octave-cli") or pytest.skip("octave-cli is not installed")
    export(made, tmp_path / "o", "mat")
    shard = made / "shard-00000.h5"
    program = (
        f"s = load('-hdf5', '{shard}'); m = load('{tmp_path}/o/part-00000.mat');"
        "j.tau = s.paths.tau; j.names = cellstr(s.landmarks.name); j.position = s.landmarks.position;"
        "j.same = isequal(m.paths.tau(:), s.paths.tau(:)); j.real = real(m.paths.a); j.first = m.landmarks.name{2};"
        "printf('%s', jsonencode(j)); exit(0);"
    )
    done = subprocess.run(
        [octave, "--norc", "--quiet", "--eval", program], capture_output=True, text=True, timeout=120, check=False
    )
    found = json.loads(done.stdout)
    paths, landmarks = dataset.read_record(shard, "paths", Paths), dataset.read_record(shard, "landmarks", Landmarks)
    assert np.allclose(found["tau"], paths.tau, rtol=1e-4) and found["same"]
    assert found["names"] == landmarks.name.tolist() and found["first"] == "VA wall_east"
    assert np.allclose(np.transpose(found["position"]), landmarks.position)  # column-major, as in MATLAB
    assert np.allclose(found["real"], paths.a.real, rtol=1e-4)
