"""docs/extending.md: what it shows works as printed."""

import re
from pathlib import Path

import numpy as np
import pytest

from dopslam.errors import DatasetError
from dopslam.formats import FORMATS
from dopslam.formats.contract import Reader, Writer, reader, writer

PAGE = Path(__file__).resolve().parent.parent / "docs" / "extending.md"


def block(name: str) -> str:
    """The code block that defines a class."""
    return next(code for code in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S) if f"class {name}" in code)


def test_every_file_it_names_is_there():
    linked = re.findall(r"\]\((\.\./[^)]*)\)", PAGE.read_text())
    assert len(linked) > 8 and all((PAGE.parent / where).exists() for where in linked)


def test_a_filter_is_one_file(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(block("DeadReckoning"))
    assert call("simulate", "ring_road", "--out", "a.h5", "--set", "track.steps=4") == 0
    assert call("slam", "a.h5", "--filter", "mine.py:DeadReckoning") in (0, 3)


def test_a_format_is_one_file(call, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "npz.py").write_text(block("Npz"))
    assert call("simulate", "ring_road", "--out", "a.h5", "--set", "track.steps=4") == 0
    assert call("export", "a.h5", "--to", "npz.py:Npz", "--out", "o") == 0
    with np.load(tmp_path / "o" / "part-0.npz") as found:
        assert found["aoa"].shape == (len(found["delay"]), 2)
    assert call("export", "a.h5", "--to", "nzp", "--out", "p") == 2
    assert "no such format as 'nzp'" in capsys.readouterr().err
    assert call("import", "a.h5", "--format", "npz.py:Npz", "--scene", "ring_road", "--out", "b.h5") == 2
    assert "cannot be read; those that can: table" in capsys.readouterr().err


def test_a_foreign_reader_is_one_file(call, tmp_path, monkeypatch):
    """What was written comes back through a reader of one's own."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(
        "from dopslam.formats.contract import Opened\n"
        "from dopslam.records import DetectionSeries\n"
        "from dopslam.store.file import read_record\n\n"
        "class Mine:\n"
        "    writes, reads = False, True\n\n"
        "    def read(self, path, mapping):\n"
        "        found = read_record(path, 'detections', DetectionSeries)\n"
        "        return Opened(lambda world, truth: found, period=0.5)\n"
    )
    assert call("simulate", "ring_road", "--out", "a.h5", "--set", "track.steps=4") == 0
    assert call("import", "a.h5", "--format", "mine.py:Mine", "--scene", "ring_road", "--out", "b.h5") == 0
    assert (tmp_path / "b.h5").exists()


ODD = """
class Fails:
    writes, reads = True, True
    def write(self, parts, out): return {}["x"]
    def read(self, path, mapping): return None

class Empty(Fails):
    def write(self, parts, out): pass

class Unmade(Fails):
    def __init__(self, what): pass
"""


def test_what_fails_in_a_format_of_one_s_own_is_its_fault(call, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "odd.py").write_text(ODD)
    assert call("simulate", "ring_road", "--out", "a.h5", "--set", "track.steps=4") == 0
    said = {"Fails": "write: KeyError: 'x'", "Empty": "wrote no file", "Unmade": "cannot be made: TypeError"}
    for name, what in said.items():
        assert call("export", "a.h5", "--to", f"odd.py:{name}", "--out", "o") == 2
        assert f"format 'odd.py:{name}'" in (error := capsys.readouterr().err) and what in error
        assert not (tmp_path / "o").exists()
    assert call("import", "a.h5", "--format", "odd.py:Fails", "--scene", "ring_road", "--out", "b.h5") == 2
    assert "read must return dopslam.formats.contract.Opened, got NoneType" in capsys.readouterr().err


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_keeps_the_contract(name):
    made = FORMATS[name]()
    assert made.writes or made.reads
    if made.writes:
        assert isinstance(writer(name), Writer)
    if made.reads:
        assert isinstance(reader(name), Reader)
    else:
        with pytest.raises(DatasetError, match="those that can: table"):
            reader(name)
