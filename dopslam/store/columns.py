"""Columns of a record in a dataset file: how they are cut into chunks, read and hashed.

HDF5 recomputes the fletcher32 sum of every chunk it reads, which takes about as long as reading and sha256 together.
That sum protects whoever reads a part of a file, or reads it with another program. A reader that compares the sha256
of the whole content anyway takes the chunks as they lie in the file, and hashes one while it reads the next.
"""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import h5py
import numpy as np

CHUNK = 1 << 19  # bytes; small ones cost a call each, large ones leave the processor's cache
OVERLAP = 1 << 23  # bytes, from which a second thread is worth its start
AHEAD = 8  # blocks that reading may be ahead of hashing
_SUM = 4  # bytes of fletcher32 behind every chunk


class Sha256:
    """sha256 of a stream of blocks; where ``size`` bytes are many, on a second thread beside the caller's reading."""

    def __init__(self, size: int):
        self._sha = hashlib.sha256()
        self._thread = ThreadPoolExecutor(1) if size >= OVERLAP else None
        self._pending: deque[Future] = deque()

    def __enter__(self) -> Sha256:
        return self

    def __exit__(self, *_) -> None:
        if self._thread is not None:
            self._thread.shutdown(cancel_futures=True)

    def update(self, block: bytes | memoryview) -> None:
        """Add a block, which must not change afterwards."""
        if self._thread is None:
            self._sha.update(block)
            return
        self._pending.append(self._thread.submit(self._sha.update, block))
        while len(self._pending) > AHEAD:
            self._pending.popleft().result()

    def hexdigest(self) -> str:
        """The sum of everything so far."""
        while self._pending:
            self._pending.popleft().result()
        return self._sha.hexdigest()


def chunk_shape(array: np.ndarray) -> tuple[int, ...]:
    """Whole rows, about half a megabyte of them."""
    row = max(1, array.nbytes // max(1, len(array)))
    return (min(len(array), max(1, CHUNK // row)), *array.shape[1:])


def texts(array: np.ndarray) -> np.ndarray:
    """Texts as an object array of str; other arrays as they are."""
    if array.dtype.kind not in "OS":
        return array
    return np.array([v.decode() if isinstance(v, bytes) else str(v) for v in array], dtype=object)


def digest(columns: dict[str, np.ndarray], scalars: dict[str, Any]) -> str:
    """sha256 of a record's content: names, types, shapes and values."""
    sha = hashlib.sha256()
    for name in sorted(columns):
        for block in _hashed(name, columns[name]):
            sha.update(block)
    sha.update(_scalars(scalars))
    return sha.hexdigest()


def group_in(file: h5py.File, name: str) -> h5py.Group:
    """A group of a file; ValueError where something else has its name."""
    found = file[name]
    if not isinstance(found, h5py.Group):
        raise ValueError(f"{name} is no group")
    return found


def array_in(node: h5py.Group, name: str) -> h5py.Dataset:
    """A dataset of a group; ValueError where something else has its name."""
    found = node[name]
    if not isinstance(found, h5py.Dataset):
        raise ValueError(f"{node.name}/{name} is no array")
    return found


def arrays_of(node: h5py.Group) -> Iterator[tuple[str, h5py.Dataset]]:
    """Names and datasets of a group."""
    for name in node:
        yield str(name), array_in(node, str(name))


def read(node: h5py.Group, names: Iterable[str], scalars: dict[str, Any]) -> tuple[dict[str, np.ndarray], str]:
    """Columns of a group and the sha256 of its content, as :func:`digest` computes it.

    Raises
    ------
    OSError, RuntimeError, ValueError
        What h5py raises for a damaged file. Other damage shows in the sha256 only, which the caller has to compare.
    """
    found: dict[str, np.ndarray] = {}
    names = sorted(names)
    arrays = {name: array_in(node, name) for name in names}
    with Sha256(sum(data.nbytes for data in arrays.values())) as sha:
        for name, data in arrays.items():
            if not _lies_plain(data):
                found[name] = texts(data[()])
                for block in _hashed(name, found[name]):
                    sha.update(block)
                continue
            column = found[name] = np.empty(data.shape, data.dtype)
            sha.update(_header(name, column))
            raw = column.reshape(-1).view(np.uint8)
            at = 0
            for block in _chunks(data):
                raw[at : at + len(block)] = block
                sha.update(raw[at : at + len(block)].data)
                at += len(block)
        sha.update(_scalars(scalars))
        return found, sha.hexdigest()


def stream_digest(data: h5py.Dataset) -> str:
    """sha256 of a dataset's bytes alone, a row at a time at most in memory beside those on their way."""
    with Sha256(data.nbytes) as sha:
        blocks = (chunk.data for chunk in _chunks(data)) if _lies_plain(data) else (row.tobytes() for row in data)
        for block in blocks:
            sha.update(block)
        return sha.hexdigest()


def _hashed(name: str, array: np.ndarray) -> Iterator[bytes | memoryview]:
    array = np.ascontiguousarray(array)
    yield _header(name, array)
    text = array.dtype.kind == "O"
    yield array.reshape(-1).view(np.uint8).data if not text else "\0".join(map(str, array)).encode()


def _header(name: str, array: np.ndarray) -> bytes:
    return f"{name}:{array.dtype.str}:{array.shape};".encode()


def _scalars(scalars: dict[str, Any]) -> bytes:
    return "".join(f"{name}={scalars[name]!r};" for name in sorted(scalars)).encode()


def _lies_plain(data: h5py.Dataset) -> bool:
    """Whether the chunks are whole rows of plain numbers with a fletcher32 sum behind each, and all are there."""
    if data.chunks is None or not data.size or data.chunks[1:] != data.shape[1:] or data.dtype.kind not in "biufc":
        return False
    made = data.id.get_create_plist()
    if made.get_nfilters() != 1 or made.get_filter(0)[0] != h5py.h5z.FILTER_FLETCHER32:
        return False
    whole = data.id.get_type().get_size() == data.dtype.itemsize
    return whole and data.id.get_num_chunks() == -(-len(data) // data.chunks[0])


def _chunks(data: h5py.Dataset) -> Iterator[np.ndarray]:
    """Bytes of a dataset in order, chunk by chunk, without the sums."""
    assert data.chunks is not None  # or it does not lie plain
    row = data.nbytes // len(data)
    rows, rest = data.chunks[0], (0,) * (data.ndim - 1)
    for first in range(0, len(data), rows):
        mask, chunk = data.id.read_direct_chunk((first, *rest))
        if mask or len(chunk) != rows * row + _SUM:
            raise OSError(f"{data.name}: the chunk at row {first} is damaged")
        yield np.frombuffer(chunk, np.uint8, min(rows, len(data) - first) * row)
