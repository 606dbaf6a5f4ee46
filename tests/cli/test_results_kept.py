"""Targets are tried before the work; what was computed is not lost when something fails late."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from dopslam.cli import failure
from dopslam.cli.run import run
from dopslam.errors import DatasetError
from dopslam.formats.export import export
from dopslam.pipeline import file as stages
from dopslam.report import folder
from dopslam.store import place

SMALL = ["--set", "track.steps=2"]


@pytest.fixture
def worked(monkeypatch):
    """Fails the test if anything was computed."""
    from dopslam.studies import montecarlo, summary

    def work(*_, **__):
        raise AssertionError("computed before the target was tried")

    for module, name in ((summary, "nominal_bound"), (montecarlo, "run_study"), (stages, "evaluate")):
        monkeypatch.setattr(module, name, work)


@pytest.mark.parametrize(
    "tokens",
    [
        ["bound", "ring_road", "--csv", "/proc/none/b.csv"],
        ["bound", "ring_road", "--contributions", "/proc/none/b.csv"],
        ["bound", "ring_road", "--csv", "."],
        ["montecarlo", "ring_road", "--runs", "1", "--json", "/proc/none/m.json"],
        ["montecarlo", "pedestrian", "--filter", "bp", "--runs", "1", "--json", "/proc/none/m.json"],
        ["evaluate", "d.h5", "--out", "/proc/none"],
        ["evaluate", "d.h5", "--out", "d.h5"],
    ],
)
def test_targets_are_tried_before_anything_is_computed(call, worked, tokens, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("d.h5").write_bytes(b"")
    assert call(*tokens) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "name" in line and tokens[-1] in line
    assert [path.name for path in tmp_path.iterdir()] == ["d.h5"]


def test_a_new_dataset_is_tried_before_it_is_drawn(call, monkeypatch, capsys):
    monkeypatch.setattr(stages.pipeline, "simulate", lambda *_: 1 / 0)
    assert call("simulate", "ring_road", "--out", "/proc/d.h5", *SMALL) == 2
    assert "/proc/d.h5: cannot be written" in capsys.readouterr().err


def test_trying_leaves_nothing_behind(tmp_path):
    place.refuse_unwritable(tmp_path, tmp_path / "a" / "b" / "c.json", None)
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_written_is_kept_elsewhere(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(folder.tempfile, "tempdir", None)
    with pytest.raises(DatasetError, match="kept in") as raised:
        folder.write_json("/proc/none/m.json", {"a": [1.0, float("nan")]})
    kept = Path(str(raised.value).rpartition("kept in ")[2])
    assert json.loads(kept.read_text()) == {"a": [1.0, None]}


@pytest.mark.parametrize("error", [DatasetError("broken"), KeyboardInterrupt()])
def test_a_run_that_ends_late_keeps_its_dataset_and_says_where(tmp_path, monkeypatch, capsys, error, call):
    monkeypatch.chdir(tmp_path)

    def broken(*_, **__):
        raise error

    monkeypatch.setattr(stages, "variants_of", broken)
    code = call("run", "ring_road", "--source", "model", *SMALL)
    assert code == (2 if isinstance(error, DatasetError) else 130)
    (kept,) = (tmp_path / "runs").iterdir()
    assert kept.name.endswith("-unfinished") and (kept / "dataset.h5").stat().st_size
    assert f"what was finished is in runs/{kept.name}" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["a/b", "..", "x" * 400, "snow ❄ é", "tab\tnul\0", ""])
def test_a_scenario_of_any_name_gets_a_folder(tmp_path, name):
    with folder.results_folder(tmp_path / "runs", name) as (working, _):
        (working / "x").write_text("x")
    (made,) = [path for path in (tmp_path / "runs").iterdir() if not path.is_symlink()]
    assert (made / "x").read_text() == "x" and made.parent == tmp_path / "runs"


def test_export_leaves_a_foreign_folder_alone(tmp_path):
    data, out = tmp_path / "d.h5", tmp_path / "o"
    stages.simulate(
        data, stages.parse("@".replace("@", Path("scenes/ring_road/scenario.toml").read_text()), SMALL[1:]), 0
    )
    foreign = tmp_path / f".o.{os.getpid()}.part"
    foreign.mkdir()
    (foreign / "mine").write_text("keep")
    export(data, out, "tum")
    assert (foreign / "mine").read_text() == "keep"
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(["d.h5", "o", foreign.name])


def test_a_killed_worker_is_one_line():
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    assert "--jobs" in failure.sentence(TerminatedWorkerError("x"))


def test_notes_stand_behind_the_sentence():
    error = DatasetError("broken")
    error.add_note("kept in x")
    assert failure.sentence(error) == "broken; kept in x"


@pytest.mark.proc
def test_interrupt_is_one_line():
    code = "from dopslam.cli import main; main(['montecarlo', 'ring_road', '--runs', '100000', '--jobs', '1'])"
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(6)
    process.send_signal(signal.SIGINT)
    _, message = process.communicate(timeout=120)
    assert process.returncode == 130 and message.strip() == "dopslam: interrupted"


def test_run_is_documented():
    assert "unfinished" in (run.__doc__ or "")
