"""Other programs' formats, read back with what those programs use."""

import csv
import hashlib
import json

import numpy as np
import pytest
from scipy.io import loadmat

from dopslam.errors import DatasetError
from dopslam.formats import export
from dopslam.records import Landmarks, Paths, Track
from dopslam.store import file as dataset


@pytest.fixture(scope="module")
def first(made):
    path = made / "shard-00000.h5"
    return tuple(
        dataset.read_record(path, g, t) for g, t in (("track", Track), ("landmarks", Landmarks), ("paths", Paths))
    )


def test_csv_has_a_row_per_path_and_per_position(made, first, tmp_path):
    export.export(made, tmp_path / "o", "csv")
    with open(tmp_path / "o" / "paths.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 31 * 6
    assert float(rows[7]["tau"]) == first[2].tau[7]
    assert (rows[7]["index"], rows[7]["landmark"], rows[7]["kind"]) == ("1", "VA wall_east", "VA")
    with open(tmp_path / "o" / "positions.csv", newline="", encoding="utf-8") as file:
        places = list(csv.DictReader(file))
    assert [int(row["drive"]) for row in places] == [k // 5 for k in range(31)]


def test_matlab_tables(made, first, tmp_path):
    export.export(made, tmp_path / "o", "mat")
    content = loadmat(tmp_path / "o" / "part-00000.mat", simplify_cells=True)
    assert np.array_equal(content["paths"]["tau"], first[2].tau)
    assert np.array_equal(content["paths"]["landmark"], first[2].landmark + 1)
    assert np.array_equal(content["paths"]["position"], np.repeat(np.arange(7), 6) + 1)
    assert list(content["landmarks"]["name"][:2]) == ["BS", "VA wall_east"]


def test_tum_poses_carry_the_heading(made, first, tmp_path):
    export.export(made, tmp_path / "o", "tum")
    poses = np.loadtxt(tmp_path / "o" / "drive-00001.tum")
    assert poses.shape == (5, 8)
    assert np.allclose(poses[:2, 1:4], first[0].position[5:7], atol=1e-8)
    heading = 2 * np.arctan2(poses[:2, 6], poses[:2, 7])
    assert np.allclose(np.exp(1j * heading), np.exp(1j * first[0].heading[5:7]))


def test_deepmimo_matrices(made, first, tmp_path):
    export.export(made, tmp_path / "o", "deepmimo")
    matrix = {
        name: loadmat(tmp_path / "o" / f"{name}_t000_tx000_r001.mat")[name]
        for name in (
            "power",
            "delay",
            "aoa_el",
            "aod_az",
            "inter",
            "inter_pos",
            "rx_pos",
            "tx_pos",
            "phase",
            "aoa_az",
            "aod_el",
        )
    }
    assert matrix["delay"].shape == (31, 6) and matrix["inter_pos"].shape == (31, 6, 1, 3)
    assert np.all(np.diff(matrix["power"], axis=1) <= 0)
    assert np.array_equal(matrix["inter"][0] == 0, matrix["delay"][0] == np.float32(first[2].tau[0]))
    assert sorted(matrix["inter"][0].tolist()) == [0, 1, 3, 3, 3, 3]
    # The path's length along its interaction point, from what was written alone.
    row, column = np.argwhere(matrix["inter"] == 1)[3]
    point = matrix["inter_pos"][row, column, 0]
    length = np.linalg.norm(point - matrix["tx_pos"][0]) + np.linalg.norm(point - matrix["rx_pos"][row])
    assert length == pytest.approx(299792458 * matrix["delay"][row, column], rel=1e-5)
    parameters = json.loads((tmp_path / "o" / "params.json").read_text())
    assert parameters["txrx_sets"]["txrx_set_1"]["num_points"] == 31


def test_sigmf_holds_every_snapshot(made, tmp_path):
    path = tmp_path / "d.h5"
    path.write_bytes((made / "shard-00000.h5").read_bytes())
    with pytest.raises(DatasetError, match="holds no signal"):
        export.export(path, tmp_path / "o", "sigmf")
    assert not (tmp_path / "o").exists()
    rng = np.random.default_rng(0)
    y = (rng.normal(size=(7, 4, 3, 2)) + 1j).astype(np.complex64)
    dataset.write_signal(path, iter(y), 7)
    export.export(path, tmp_path / "o", "sigmf")
    raw = (tmp_path / "o" / "part-00000.sigmf-data").read_bytes()
    assert np.array_equal(np.frombuffer(raw, np.complex64).reshape(y.shape), y)
    meta = json.loads((tmp_path / "o" / "part-00000.sigmf-meta").read_text())
    assert meta["global"]["core:sha512"] == hashlib.sha512(raw).hexdigest()
    assert meta["captures"][2]["core:sample_start"] == 2 * 4 * 3 * 2


def test_an_existing_folder_is_left_alone(made, tmp_path, call):
    assert call("export", made, "--to", "csv", "--out", tmp_path) == 2
    assert call("export", made, "--to", "csv", "--out", tmp_path / "o") == 0
    assert list(tmp_path.iterdir()) == [tmp_path / "o"]
