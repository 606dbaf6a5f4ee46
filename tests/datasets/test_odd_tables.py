"""Tables as strangers have them: separators, decimal commas, encodings, units of time, cells that are empty, other countings."""

import numpy as np
import pytest

from dopslam.config.scenario import load
from dopslam.errors import DatasetError
from dopslam.formats import table as foreign
from dopslam.models import unmeasured

MAPPING = """
[columns]
time = "t"
delay = "toa"
aoa_azimuth = "phi °"
aoa_elevation = "theta"
[units]
time = "ms"
delay = "ns"
aoa_azimuth = "deg"
aoa_elevation = "deg"
[conventions]
aoa_elevation = "zenith"
[std]
delay = 0.3
aoa_azimuth = 1
aoa_elevation = 1
"""
ROWS = [(1000, 100.5, -10.25, 80), (1000, 120.25, 30.5, 95), (1500, 101.5, -11.5, 81), (2000, 102.5, -12.75, 82)]
NAMES = ["t", "toa", "phi °", "theta"]


def read(folder, content: bytes, mapping=MAPPING, name="t.csv"):
    (folder / name).write_bytes(content)
    (folder / "m.toml").write_text(mapping, encoding="utf-8")
    rule = foreign.read_mapping(folder / "m.toml")
    return foreign.detections(folder / name, rule, load("ring_road"))


def lines(rows, separator=",", decimal=".", names=NAMES) -> str:
    cells = [[str(cell).replace(".", decimal) for cell in row] for row in rows]
    return "\n".join(separator.join(row) for row in [names, *cells]) + "\n"


@pytest.mark.parametrize(
    "content",
    [lines(ROWS).encode(), lines(ROWS, ";", ",").encode("cp1252"), lines(ROWS, "\t", ",").encode("utf-16"),
     lines(ROWS, "\t").encode("utf-8-sig"), b"# " + lines(ROWS).encode(), lines(ROWS, ";").replace("\n", "\r\n").encode()],
)  # fmt: skip
def test_separators_decimal_commas_and_encodings_do_not_matter(tmp_path, content):
    found = read(tmp_path, content)
    assert np.array_equal(found.offsets, [0, 2, 3, 4])
    assert np.allclose(found.time, [1, 1.5, 2])
    assert np.allclose(found.delay, [100.5e-9, 120.25e-9, 101.5e-9, 102.5e-9])
    assert np.allclose(np.degrees(found.aoa), [[-10.25, 10], [30.5, -5], [-11.5, 9], [-12.75, 8]])


@pytest.mark.parametrize("gap", ["", "NaN", "n/a", "-"])
def test_a_cell_without_a_number_was_not_measured_and_a_row_without_any_is_an_empty_snapshot(tmp_path, gap):
    rows = [list(row) for row in ROWS]
    rows[1][3] = gap
    rows.insert(3, [1750, gap, gap, gap])
    found = read(tmp_path, lines(rows).encode())
    assert np.array_equal(np.diff(found.offsets), [2, 0, 1, 0, 1])
    std = np.sqrt(found.covariance[:, 2, 2])
    assert np.allclose(std[[0, 2, 3]], np.radians(1))
    assert std[1] == pytest.approx(unmeasured.deviation(unmeasured.SPANS)[2])
    whole = read(tmp_path, lines(ROWS).encode())
    gain = unmeasured.WIDE ** (1 / 4)  # one of four detections lacks it
    assert found.search_volume == pytest.approx(whole.search_volume * gain)


def test_import_says_what_it_took_for_missing(tmp_path, call, capsys):
    rows = [list(row) for row in ROWS]
    rows[1][3] = ""
    (tmp_path / "t.csv").write_text(lines(rows), encoding="utf-8")
    (tmp_path / "m.toml").write_text(MAPPING, encoding="utf-8")
    done = call(
        "import", tmp_path / "t.csv", "--map", tmp_path / "m.toml", "--scene", "ring_road", "--out", tmp_path / "o.h5"
    )
    assert done == 0
    assert "aoa_elevation is missing in 1 of 4 rows" in " ".join(capsys.readouterr().err.split())


def test_steps_counted_from_one_are_told(tmp_path, call, capsys):
    mapping = MAPPING.replace('time = "t"', 'step = "t"').replace('time = "ms"', "")
    rows = [(1, *ROWS[0][1:]), (2, *ROWS[2][1:])]
    assert len(read(tmp_path, lines(rows).encode(), mapping).offsets) == 4
    found = read(tmp_path, lines(rows).encode(), mapping + "[offsets]\nstep = 1\n")
    assert np.array_equal(found.offsets, [0, 1, 2])
    (tmp_path / "m.toml").write_text(mapping, encoding="utf-8")
    call("import", tmp_path / "t.csv", "--map", tmp_path / "m.toml", "--scene", "ring_road", "--out", tmp_path / "o.h5")
    assert "steps begin at 1" in capsys.readouterr().err


def test_powers_in_dbm_stand_over_a_floor_in_dbm(tmp_path):
    mapping = "noise_floor_db = -100\n" + MAPPING.replace('theta"\n', 'theta"\npower = "rssi"\n').replace(
        'time = "ms"', 'time = "ms"\npower = "dBm"'
    )
    rows = [(*row, -80) for row in ROWS]
    found = read(tmp_path, lines(rows, names=[*NAMES, "rssi"]).encode(), mapping)
    assert np.allclose(found.snr, 100)


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"1000,100,2,80\n1500,101,2,80\n", "a header with the names of the columns is needed"),
     (lines(ROWS).replace("101.5", "101.5,7").encode(), "data row 3 has 5 cells where the header has 4"),
     (lines(ROWS).replace("-11.5", "west").encode(), "data row 3 holds 'west', which is no number"),
     (lines(ROWS).replace("1500", "").encode(), "holds nan in data row 3")],
)  # fmt: skip
def test_what_cannot_be_read_is_named_by_its_row(tmp_path, content, message):
    with pytest.raises(DatasetError, match=message):
        read(tmp_path, content)
