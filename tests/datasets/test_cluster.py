"""Dask workers as separate processes on the loopback interface: the same numbers as without them."""

import json
import os
import socket
import subprocess
import sys
import time

import pytest

from dopslam.compute import cluster
from dopslam.config.scenario import load
from dopslam.datasets import maker
from dopslam.errors import DopslamError
from dopslam.studies.montecarlo import run_study
from dopslam.studies.summary import study


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory):
    pytest.importorskip("distributed", reason="the extra [cluster] is not installed")
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    address = f"tcp://127.0.0.1:{free_port()}"
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    # Away from the sources: a module in the current folder would hide the installed one and its compiled kernels.
    folder = tmp_path_factory.mktemp("dask")
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment, "cwd": folder}
    started = [
        subprocess.Popen(
            [*command, "--host", "127.0.0.1", "--port", address.rpartition(":")[2], "--no-dashboard"], **quiet
        )
    ]
    try:
        for _ in range(2):
            worker = [
                sys.executable,
                "-m",
                "distributed.cli.dask_worker",
                address,
                "--nthreads",
                "1",
                "--no-nanny",
                "--no-dashboard",
            ]
            started.append(subprocess.Popen(worker, **quiet))
        from distributed import Client

        deadline = time.monotonic() + 90
        with Client(address, timeout=60) as client:
            while len(client.nthreads()) < 2 and time.monotonic() < deadline:
                time.sleep(0.2)
            assert len(client.nthreads()) == 2
        yield address
    finally:
        for process in started:
            process.kill()
            process.wait()


pytestmark = [pytest.mark.proc, pytest.mark.filterwarnings("ignore")]  # those of dask and tornado are not ours


def test_a_study_gives_the_same_numbers_on_two_dask_workers(scheduler):
    plan = study(load("ring_road", ["track.steps=5"]))
    alone = run_study(plan, 4, seed=3)
    with cluster.workers(scheduler) as threads:
        assert threads == 2
        spread = run_study(plan, 4, seed=3, jobs=threads)
    for mine, its in zip(alone, spread, strict=True):
        assert mine.nees.tolist() == its.nees.tolist()
        assert mine.gospa_va.tolist() == its.gospa_va.tolist()


SMALL = [
    "radio.subcarriers=32", "radio.beams.beams=4", "radio.beams.sweeps=2", "receiver.array.columns=4",
    "base_station.array.columns=4", "estimator.max_paths=3",
]  # fmt: skip


def test_detections_are_the_same_on_two_dask_workers(scheduler, worker, tmp_path):
    alone = worker.make(tmp_path / "a", 6, settings=SMALL, detections=True)
    with cluster.workers(scheduler) as threads:
        spread = worker.make(tmp_path / "b", 6, settings=SMALL, detections=True, jobs=threads)
    assert spread == alone


def test_the_command_line_sends_its_work_there(scheduler, worker, tmp_path, call, monkeypatch):
    monkeypatch.setattr(maker, "ShardTracer", worker.PlainTracer)
    settings = [word for text in [*worker.SETTINGS, *SMALL] for word in ("--set", text)]
    make = ["dataset", "ring_road", "--positions", "6", "--detections", *settings]
    assert call(*make, "--out", tmp_path / "a", "--jobs", "1") == 0
    assert call(*make, "--out", tmp_path / "b", "--cluster", scheduler) == 0
    assert (tmp_path / "a" / "manifest.json").read_bytes() == (tmp_path / "b" / "manifest.json").read_bytes()
    (tmp_path / "s.toml").write_text(
        'scenario = "ring_road"\nruns = 3\nset = ["track.steps=4"]\n[vary]\n"source.model.clutter_rate" = [0.5, 2.0]\n'
    )
    assert call("sweep", tmp_path / "s.toml", "--out", tmp_path / "c", "--jobs", "1") == 0
    assert call("sweep", tmp_path / "s.toml", "--out", tmp_path / "d", "--cluster", scheduler) == 0
    assert (tmp_path / "c" / "table.csv").read_bytes() == (tmp_path / "d" / "table.csv").read_bytes()
    study = ["montecarlo", "ring_road", "--runs", "3", "--set", "track.steps=4"]
    assert call(*study, "--jobs", "1", "--json", tmp_path / "e") == 0
    assert call(*study, "--cluster", scheduler, "--json", tmp_path / "f") == 0
    e, f = (json.loads((tmp_path / name).read_text()) for name in "ef")
    assert e["nees_mean"] == f["nees_mean"] and e["per_step"]["rmse_position"] == f["per_step"]["rmse_position"]


def test_an_address_without_a_scheduler_is_one_error(monkeypatch):
    pytest.importorskip("distributed", reason="the extra [cluster] is not installed")
    monkeypatch.setattr(cluster, "TIMEOUT", 1)
    with (
        pytest.raises(DopslamError, match="no Dask scheduler answers"),
        cluster.workers(f"tcp://127.0.0.1:{free_port()}"),
    ):
        pass


def test_without_an_address_nothing_changes():
    with cluster.workers(None) as threads:
        assert threads is None
