"""The cache of compiled kernels: never stale, shared safely, dispensable."""

import contextlib
import os
import subprocess
import sys
import time
from pathlib import Path

import numba
import numpy as np
import pytest

from dopslam.compute.compiled import compiled
from dopslam.config.scenario import load
from dopslam.errors import ConfigError
from dopslam.filters import FILTERS
from dopslam.pipeline import ahead, stages
from estimation import jit

pytestmark = pytest.mark.proc

CALLEE = """
from pathlib import Path
from typing import NamedTuple
from estimation.jit import cached

def compiled(function):
    return cached(function, Path(__file__).resolve().parent.parent)

class Record(NamedTuple):
    first: float
    second: float

FACTOR = 10.0

@compiled
def inner(x):
    return x + 1.0
"""
CALLER = """
from house.low.callee import FACTOR, Record, compiled, inner

@compiled
def outer(record):
    return FACTOR * inner(record.first)

@compiled
def many(x):
    return x * 2
"""
RUN = "from house.high.caller import Record, outer; print(outer(Record(first=1.0, second=5.0)), len(outer.stats.cache_hits))"


@pytest.fixture
def house(tmp_path):
    """A package of two rooms whose kernels call each other, and a way to run a line in a new process."""
    for room, name, text in (("low", "callee", CALLEE), ("high", "caller", CALLER)):
        folder = tmp_path / "house" / room
        folder.mkdir(parents=True)
        (folder / f"{name}.py").write_text(text)
    environment = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    environment |= {"HOME": str(tmp_path / "home"), "PYTHONPATH": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}

    def run(line: str = RUN, **settings) -> str:
        done = subprocess.run(
            [sys.executable, "-c", line], capture_output=True, text=True, env=environment | settings, timeout=300
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    run.environment = environment
    return tmp_path, run


@pytest.mark.parametrize(
    ("old", "new", "result"),
    [
        ("return x + 1.0", "return x + 2.0", 30.0),  # a callee
        ("first: float\n    second: float", "second: float\n    first: float", 20.0),  # a record's fields swapped
        ("FACTOR = 10.0", "FACTOR = 7.0", 14.0),  # a constant, frozen into the code
    ],
)
def test_a_change_in_another_room_is_seen(house, old, new, result):
    folder, run = house
    assert run() == "20.0 0"
    assert run() == "20.0 1"  # from the cache
    file = folder / "house" / "low" / "callee.py"
    times = file.stat()
    file.write_text(file.read_text().replace(old, new))
    os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert run() == f"{result} 0"


def test_where_the_cache_lies(house):
    folder, run = house
    run(XDG_CACHE_HOME=str(folder / "xdg"))
    assert list((folder / "xdg" / "dopslam" / "numba").glob("house.high-*/caller.outer*.nbc"))
    run(NUMBA_CACHE_DIR=str(folder / "own"))
    assert list((folder / "own" / "dopslam").glob("house.high-*/caller.outer*.nbc"))
    assert not (folder / "home").exists()
    assert not list(folder.rglob("__pycache__/*.nb?"))


def test_no_home_no_disk_and_torn_entries_cost_time_only(house):
    folder, run = house
    (folder / "file").write_text("not a folder")
    assert run(NUMBA_CACHE_DIR=str(folder / "file")) == "20.0 0"
    assert run(HOME="/proc/none") == "20.0 0"
    run()
    for entry in (folder / "home").rglob("*.nb?"):
        entry.write_bytes(entry.read_bytes()[:40])
    assert run() == "20.0 0"


def test_a_cache_that_cannot_be_written_is_read(house):
    """Filled by the administrator, or on a disk that is mounted read-only."""
    folder, run = house
    run()
    assert run("from estimation import jit; jit.writable = lambda _: None; " + RUN) == "20.0 1"
    assert (
        run("from estimation import jit; jit.writable = lambda _: None; " + RUN, HOME=str(folder / "other")) == "20.0 0"
    )


def test_processes_share_it(house):
    """Signatures compiled at the same time in several processes do not overwrite each other's entries."""
    folder, run = house
    lines = [
        f"import numpy as np; from house.high.caller import many; print(many(np.ones(2, np.{kind})).dtype)"
        for kind in ("float64", "float32", "int16", "complex64")
    ]
    started = [
        subprocess.Popen([sys.executable, "-c", line], stdout=subprocess.PIPE, env=run.environment, text=True)
        for line in lines
    ]
    first = [process.communicate(timeout=300)[0] for process in started]
    assert first == [run(line) + "\n" for line in lines]
    assert len(list((folder / "home").rglob("caller.many*.nbc"))) == 4


def test_old_folders_go(tmp_path):
    now = time.time()
    for name, days in (("new", 0), ("used", 20), ("old", 40)):
        (tmp_path / name).mkdir()
        os.utime(tmp_path / name, (now - 86400 * days,) * 2)
    jit.prune(tmp_path, now)
    assert {path.name for path in tmp_path.iterdir()} == {"new", "used"}


def test_every_kernel_of_the_house_goes_through_it():
    """Kernels that numba caches by itself would be the stale ones."""
    for package in ("dopslam", "estimation"):
        for file in (Path(jit.__file__).parent.parent / package).rglob("*.py"):
            assert "cache=True" not in file.read_text(encoding="utf-8"), file


def test_no_cache_folder_is_slower_never_broken(monkeypatch):
    real = numba.njit

    def refuses_to_cache(*args, **options):
        if options.get("cache"):
            raise RuntimeError("cannot cache function: no locator available")
        return real(*args, **options)

    monkeypatch.setattr(numba, "njit", refuses_to_cache)
    assert compiled(lambda x: x + 1)(2) == 3


def test_filters_that_were_never_compiled_here_are_compiled_beside_and_the_process_ends_with_its_parent(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(ahead.jit, "cache_folder", lambda: tmp_path)
    assert ahead.missing(["joint", "mine.py:Own", "bp"]) == ["joint", "bp"]
    with ahead.compiling(["joint"]) as child:
        assert child is not None and child.poll() is None
    assert child.returncode  # killed with the body, however far it came
    mark = ahead._mark("joint")
    assert mark is not None
    mark.touch()
    assert ahead.missing(["joint", "bp"]) == ["bp"]
    with ahead.compiling(["joint"]) as child:
        assert child is None


def test_without_a_folder_nothing_is_compiled_ahead(monkeypatch):
    monkeypatch.setattr(ahead.jit, "cache_folder", lambda: None)
    assert ahead.missing(["joint"]) == []


def test_one_process_compiles_and_others_leave_it_to_the_first(tmp_path, monkeypatch):
    monkeypatch.setattr(ahead.jit, "cache_folder", lambda: tmp_path)
    with jit.locked(tmp_path / "compiling") as first, jit.locked(tmp_path / "compiling", wait=False) as second:
        assert first and not second
        ahead.compile_filters(["joint"])
    assert ahead.missing(["joint"]) == ["joint"]


@pytest.fixture
def cold(tmp_path, monkeypatch):
    """A machine that compiled nothing, to all appearances, where nobody compiles either."""
    monkeypatch.setattr(ahead, "_mark", lambda name: tmp_path / name)
    monkeypatch.setattr(ahead, "compiling", lambda _: contextlib.nullcontext())


@pytest.mark.parametrize("name", FILTERS)
def test_a_filter_that_is_interpreted_gives_the_same_numbers(name, cold):
    scenario = load("ring_road", ["source.kind=model", "track.steps=6"])
    _, _, detections = stages.simulate(scenario, 1)
    compiled_ones = stages.slam(scenario, detections, name)
    interpreted = ahead.sooner([name], stages.slam, scenario, detections, name)
    assert interpreted is not compiled_ones
    for field in ("mean", "covariance", "existence", "position"):
        np.testing.assert_allclose(getattr(interpreted, field), getattr(compiled_ones, field), rtol=1e-7, atol=1e-9)


def test_what_cannot_be_handed_over_or_fails_there_is_done_here(cold):
    assert ahead.sooner(["joint"], lambda: 5) == 5  # a function without a module cannot be handed over
    with pytest.raises(ZeroDivisionError):
        ahead.sooner(["joint"], divmod, 1, 0)
    assert ahead.sooner(["joint"], divmod, 7, 2) == (3, 1)


def test_what_is_refused_there_is_refused_here_at_once(cold):
    result, error = ahead._interpreted(["joint"], load, ["no such scene"])
    assert result is None and isinstance(error, ConfigError)
    with pytest.raises(ConfigError, match="no such scene"):
        ahead.sooner(["joint"], load, "no such scene")


def test_the_other_process_imports_what_this_one_does(cold, tmp_path, monkeypatch):
    """Not what lies in the folder that it runs in: a module of the same name, or another version of the house."""
    (tmp_path / "numpy.py").write_text("raise ImportError('not this one')")
    (tmp_path / "dopslam").mkdir()
    (tmp_path / "dopslam" / "__init__.py").write_text("raise ImportError('not this one')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [place for place in sys.path if place])
    assert ahead._interpreted(["joint"], divmod, (7, 2)) == ((3, 1), None)


@pytest.mark.parametrize("program", ["", "/no/such/python", None])
def test_where_no_process_can_be_started_it_is_done_here(cold, monkeypatch, program):
    monkeypatch.setattr(sys, "executable", program)
    assert ahead.sooner(["joint"], divmod, 7, 2) == (3, 1)


def test_where_no_file_can_be_written_it_is_done_here(cold, monkeypatch):
    monkeypatch.setattr(ahead.tempfile, "TemporaryDirectory", lambda **_: Path("/no/such/folder").stat())
    assert ahead.sooner(["joint"], divmod, 7, 2) == (3, 1)
