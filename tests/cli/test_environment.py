"""Locale, home, settings of other libraries, odd characters in names and paths: none of it matters."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from dopslam.cli.doctor import doctor
from dopslam.datasets.drives import _listed

pytestmark = pytest.mark.proc

ODD = "snow ❄ [b]x[/b] %s {0} 'q' é"
CODE = """
import sys
from dopslam.cli import main
scene, data, out = sys.argv[1:]
for tokens in (["simulate", scene, "--out", data, "--seed", "3", "--set", "track.steps=3"], ["slam", data], ["bound", data],
               ["evaluate", data, "--out", out], ["check", data], ["info", data]):
    main(tokens)
"""


def results(folder):
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    table = (folder / "table.txt").read_text(encoding="utf-8")
    return (
        {k: v for k, v in summary.items() if k not in ("versions", "seconds")},
        table,
        (folder / "plan.png").read_bytes(),
    )


@pytest.fixture
def scene(tmp_path):
    """A scenario whose folder and name have odd characters."""
    folder = tmp_path / ODD.replace("/", " ")
    folder.mkdir()
    text = Path("scenes/ring_road/scenario.toml").read_text(encoding="utf-8")
    (folder / "scenario.toml").write_text(text.replace('"ring_road"', f'"{ODD}"'), encoding="utf-8")
    return folder


def test_nothing_around_the_program_changes_what_it_does(scene, tmp_path, call, capsys):
    plain = scene / "plain"
    for tokens in (
        ["simulate", scene, "--out", scene / "d.h5", "--seed", "3", "--set", "track.steps=3"],
        ["slam", scene / "d.h5"], ["bound", scene / "d.h5"], ["evaluate", scene / "d.h5", "--out", plain],
    ):  # fmt: skip
        assert call(*tokens) == 0, capsys.readouterr().err
    settings = tmp_path / "settings"
    settings.mkdir()
    (settings / "matplotlibrc").write_text("text.usetex: True\nsavefig.dpi: 13\naxes.facecolor: red\nnonsense.key: 1\n")
    hostile = {k: v for k, v in os.environ.items() if k not in ("HOME", "XDG_CACHE_HOME", "LANG", "LC_ALL")} | {
        "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": "latin-1:strict", "TERM": "dumb", "TZ": "Asia/Kathmandu",
        "MPLCONFIGDIR": str(settings), "NUMBA_DISABLE_JIT": "1", "NUMBA_DEBUG_CACHE": "1", "COLUMNS": "20",
    }  # fmt: skip
    if "NUMBA_CACHE_DIR" not in os.environ:  # where the kernels of this machine lie, without a home to find them by
        hostile["XDG_CACHE_HOME"] = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    data, out = scene / "e.h5", scene / "hostile"
    done = subprocess.run(
        [sys.executable, "-c", CODE, str(scene), str(data), str(out)], env=hostile, capture_output=True, check=False
    )
    assert done.returncode == 0 and done.stderr.strip() == b"", done.stderr[-2000:]
    assert results(out) == results(plain)


def test_paths_of_doctor_are_no_markup(monkeypatch, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", "/tmp/[/x] [bold]cache")
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    doctor()
    assert "[/x] [bold]cache" in capsys.readouterr().out


def test_sparse_numbers_are_listed_as_they_are():
    assert _listed([3]) == "3"
    assert _listed([9, 1, 5, 4, 6]) == "1, 4 to 6, 9"
    assert _listed(range(100)) == "0 to 99"
    assert _listed(range(0, 100, 2)).endswith("14, …")
