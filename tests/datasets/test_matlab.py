"""Damaged MATLAB files: read right or refused in one sentence, though the library that reads them may die of it."""

import numpy as np
import pytest
from scipy.io import savemat

from dopslam.errors import DatasetError
from dopslam.formats import columns, matlab


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "t [b] é.mat"
    savemat(
        path, {"t": np.arange(4.0), "k": np.arange(4, dtype=np.int16)[:, None], "word": "abc", "z": 1j * np.ones(4)}
    )
    return path


def test_numbers_come_back_as_they_are_and_the_rest_is_refused_by_name(file):
    found = columns.read_table(file, ["t", "k"])
    np.testing.assert_array_equal(found["t"], np.arange(4.0))
    np.testing.assert_array_equal(found["k"], np.arange(4.0))
    with pytest.raises(DatasetError, match=r"column 'z' holds something that is no number"):
        columns.read_table(file, ["t", "z"])
    with pytest.raises(DatasetError, match=r"no column 'x'; it has t, k, word, z"):
        columns.read_table(file, ["x"])


@pytest.mark.parametrize("content", [b"", b"MATLAB 5.0 MAT-file" + b"x" * 200, bytes(1000)])
def test_what_is_no_matlab_file_is_refused(file, content):
    file.write_bytes(content)
    with pytest.raises(DatasetError, match=r"cannot be read as CSV with a header or a MATLAB file"):
        columns.read_table(file, ["t"])


def test_a_reader_that_dies_is_one_sentence(file, monkeypatch):
    """A bit flip in a data type leads SciPy's reader beside its buffer."""
    monkeypatch.setattr(matlab, "READER", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    with pytest.raises(DatasetError, match="it is damaged"):
        columns.read_table(file, ["t"])
