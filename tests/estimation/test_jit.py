"""Compiled kernels against plain numpy, and compilation where no cache can be kept."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from estimation.estimators.kernels import add_power, derotated, row_peaks, scan


def test_kernels_match_numpy():
    rng = np.random.default_rng(0)
    values = rng.standard_normal((7, 10)).astype(np.float32)
    out = np.ones((7, 5), np.float32)
    add_power(values, out)
    assert np.allclose(out, 1 + values[:, :5] ** 2 + values[:, 5:] ** 2)
    peaks = np.empty(7, np.float32)
    row_peaks(values, peaks)
    assert np.allclose(peaks, (values[:, :5] ** 2 + values[:, 5:] ** 2).max(axis=1))
    symbols = rng.standard_normal((3, 2 * 6)).astype(np.float32)
    order = np.array([[0, 1, 2], [3, 4, 5]])
    phase = np.exp(1j * rng.standard_normal((4, 2, 3))).astype(np.complex64)
    cells, speeds = np.array([2, 0]), np.array([3, 1])
    beams = np.empty((2, 2), np.complex64)
    derotated(symbols, np.concatenate([order, order + 6], axis=1), phase, cells, speeds, beams)
    complex_symbols = symbols[:, :6] + 1j * symbols[:, 6:]
    expected = np.einsum("pqb,pqb->pq", complex_symbols[cells][:, order], phase[speeds])
    assert np.allclose(beams, expected, atol=1e-5)


@pytest.mark.parametrize("room", [5000, 40])
def test_scan_finds_what_is_high(room):
    """Entries above the floor and a tenth of the peak; a full list forgets the lowest, never the highest."""
    rng = np.random.default_rng(1)
    shape = (5, 3, 4, 50)
    cells = rng.standard_normal((2, *shape)).astype(np.float32)
    power = (cells[0] ** 2 + cells[1] ** 2).ravel()
    index, found = np.empty(room, np.int64), np.empty(room, np.float32)
    nothing = [np.empty((0, size), np.complex64) for size in shape[:3]]
    count, least = scan(
        cells,
        *nothing,
        np.empty((2, 0, 50), np.float32),
        np.empty(0, np.float32),
        np.ones(5, np.float32),
        np.float32(1.0),
        np.float32(0.1),
        index,
        found,
    )
    high = index[:count][found[:count] > least]
    assert least >= max(1.0, 0.1 * power.max()) - 1e-5
    assert np.array_equal(np.sort(high), np.flatnonzero(power > least))
    assert int(np.argmax(power)) in high
    if room > len(power):
        assert np.isclose(least, max(1.0, 0.1 * power.max()))


def test_an_unwritable_cache_is_slower_but_not_broken(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    code = (
        "import numba.core.caching as c\n"
        "for name in ('_UserProvidedCacheLocator', '_InTreeCacheLocator', '_UserWideCacheLocator', "
        "'_InTreeCacheLocatorFsAgnostic'):\n"
        "    if hasattr(c, name):\n"
        "        setattr(getattr(c, name), 'ensure_cache_path', lambda self: (_ for _ in "
        "()).throw(OSError('read-only')))\n"
        "import numpy as np\n"
        "from estimation.estimators.kernels import add_power\n"
        "out = np.zeros((1, 2), np.float32)\n"
        "add_power(np.arange(4, dtype=np.float32)[None], out)\n"
        "print(out.max())\n"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(blocked)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "10.0"
