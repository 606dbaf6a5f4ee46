"""Named arrays of any shape from .npy, .npz, MATLAB (all versions) and HDF5 files."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from dopslam.errors import DatasetError
from dopslam.formats import matlab

LARGEST = 8e9  # bytes of an array


def names_in(path: Path) -> list[str]:
    """Names of the arrays of numbers in a file; one without a name is called ''."""
    return list(_opened(path))


def array_of(path: Path, name: str | None) -> np.ndarray:
    """An array of a file by its name, the only one or the largest complex one without.

    Raises
    ------
    DatasetError
        For a file that cannot be read, or an array that it does not hold; naming those it does.
    """
    found = _opened(path)
    if name is not None and name not in found:
        raise DatasetError(f"{path}: has no array {name!r}; it has {', '.join(found) or 'none'}")
    if name is None:
        several = {n: a for n, a in found.items() if a.dtype.kind == "c"} if len(found) > 1 else found
        if len(several) != 1:
            raise DatasetError(
                f"{path}: which array is meant? Say variable = … in [csi]; it has {', '.join(found) or 'no numbers'}"
            )
        name = next(iter(several))
    return found[name]


def _opened(path: Path) -> dict[str, np.ndarray]:
    if not path.is_file():
        raise DatasetError(f"{path}: no such file")
    kind = path.suffix.lower()
    try:
        if kind == ".npy":
            return {"": np.load(path, allow_pickle=False)}
        if kind == ".npz":
            with open(path, "rb") as raw, np.load(raw, allow_pickle=False) as archive:
                return {name: archive[name] for name in archive.files}
        if h5py.is_hdf5(path):
            return _hdf5(path)
        if kind == ".mat":
            return {n: a for n, a in matlab.arrays(path).items() if a.dtype.kind in "biufc"}
    except DatasetError:
        raise
    except Exception as error:  # NumPy, SciPy and HDF5 raise all kinds for damaged files
        raise DatasetError(f"{path}: cannot be read as arrays of numbers ({error})") from error
    raise DatasetError(f"{path}: is no .npy, .npz, .mat or HDF5 file; save the channel as one of these")


def _hdf5(path: Path) -> dict[str, np.ndarray]:
    """Every array of numbers; a MATLAB file's (v7.3) with the axes in MATLAB's order."""
    found: dict[str, np.ndarray] = {}
    with h5py.File(path, "r") as file:

        def visit(name: str, node) -> None:
            if not isinstance(node, h5py.Dataset) or node.external or name.startswith("#"):
                return
            fields = node.dtype.names
            pair = next((p for p in (("real", "imag"), ("r", "i")) if fields and set(p) == set(fields)), None)
            if pair is None and node.dtype.kind not in "biufc":
                return
            if node.size * node.dtype.itemsize > LARGEST:
                raise DatasetError(f"{path}: {name} has {node.size:.2g} numbers; at most {LARGEST:.0e} bytes are read")
            values = node[()]
            if pair is not None and values.dtype.names:
                values = values[pair[0]] + 1j * values[pair[1]]
            found[name] = np.asarray(values).T if "MATLAB_class" in node.attrs else np.asarray(values)

        file.visititems(visit)
    return found
