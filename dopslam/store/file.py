"""The dataset file: every noun of the pipeline in one HDF5 file that can be entered and left anywhere.

Layout: one group per record (``base_stations``, ``track``, ``landmarks``, ``paths``, ``signal``, ``detections``, …), one
dataset per array field with a ``units`` attribute, scalars as attributes, the effective scenario as TOML text and the
seed at the root. Each group carries the sha256 of its content; every dataset carries a fletcher32 checksum. Units,
frames and dimensions are listed in :mod:`dopslam.store.schema`. Files are written beside their target, synced and moved
into place, so that a file is either the old one or the new one.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import itertools
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import h5py
import numpy as np

from dopslam.errors import DatasetError, DopslamError
from dopslam.store.columns import array_in, arrays_of, chunk_shape, digest, group_in, read, stream_digest, texts
from dopslam.store.schema import (
    EARLIER,
    READ,
    SCHEMA,
    UNITS,
    VERSION,
    annotate,
    fault_of,
    is_scale,
    plain,
    remedy,
    set_text,
    unit_of,
)

_LIBVER = ("v110", "v110")  # checksummed metadata: a damaged file is noticed, not misread
IN_MEMORY = 512_000_000  # bytes, up to which a file is built in memory

Record = TypeVar("Record")


@contextlib.contextmanager
def _replacing(path: Path, extra: int = 0) -> Iterator[h5py.File]:
    """Open a copy of ``path`` (or a new file) for writing and move it into place when all went well.

    HDF5 cannot close a file cleanly once a write to the disk has failed. Files are therefore built in memory and
    written as
    bytes; only beyond ``IN_MEMORY`` (``extra`` bytes are to come) on the disk, after making sure that there is room.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise DatasetError(f"{path}: the folder {str(path.parent)!r} does not exist; create it first")
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
        os.close(handle)
    except OSError as error:
        raise DatasetError(f"{path}: cannot write in {str(path.parent)!r} ({error.strerror})") from error
    part = Path(name)
    try:
        size = extra
        if path.exists():
            _check_schema_of(path)
            size += path.stat().st_size
            _check_room(path, size)
            shutil.copyfile(path, part)
            mode = "r+"
        else:
            _check_room(path, size)
            mode = "w"
        memory = size <= IN_MEMORY
        driver: dict[str, Any] = {"driver": "core", "backing_store": False, "block_size": 1 << 20} if memory else {}
        with h5py.File(part, mode, libver=_LIBVER, **driver) as file:
            set_text(file, "schema", SCHEMA)
            file.attrs["schema_version"] = VERSION
            yield file
            file.flush()
            image = file.id.get_file_image() if memory else None
        with open(part, "rb+" if image is None else "wb") as raw:
            if image is not None:
                raw.write(image)
                raw.flush()
            os.fsync(raw.fileno())
        os.chmod(part, 0o644)
        os.replace(part, path)
    except OSError as error:
        raise DatasetError(f"{path}: writing failed ({error}); the file is as it was") from error
    finally:
        part.unlink(missing_ok=True)


def _check_room(path: Path, size: int) -> None:
    free = shutil.disk_usage(path.parent).free
    if size > free:
        raise DatasetError(f"{path}: needs {size / 1e6:.0f} MB and {free / 1e6:.0f} MB are free; make room first")


def _check_schema_of(path: Path) -> None:
    with _reading(path):
        pass


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[h5py.File]:
    path = Path(path)
    if not path.is_file():
        raise DatasetError(f"{path}: no such dataset file; make one with 'dopslam trace SCENE --out {path}'")
    try:
        with h5py.File(path, "r") as file:
            _check_schema(path, file)
            _check_self_contained(path, file)
            yield file
    except DopslamError:
        raise
    except (OSError, RuntimeError, LookupError, ValueError, TypeError, AttributeError) as error:
        raise DatasetError(f"{path}: not a readable dataset, truncated or damaged ({error})") from error


def _check_self_contained(path: Path, file: h5py.File) -> None:
    """Refuse what would be read from other files: their content is nobody's data here, and may be anybody's secret."""
    for place in (file, *(file[name] for name in file if isinstance(file.get(name, getlink=True), h5py.HardLink))):
        if not isinstance(place, h5py.Group):
            continue
        for name in place:
            link = place.get(name, getlink=True)
            where = f"{place.name}/{name}".replace("//", "/")
            if isinstance(link, h5py.ExternalLink):
                raise DatasetError(f"{path}: {where} is a link into {link.filename!r}; copy its content into this file")
            member = place[name] if isinstance(link, h5py.HardLink) else None
            if isinstance(member, h5py.Dataset) and member.external:
                raise DatasetError(f"{path}: {where} is stored in another file; copy its content into this one")


def _check_schema(path: Path, file: h5py.File) -> None:
    schema, version = (plain(file.attrs.get(name)) for name in ("schema", "schema_version"))
    if schema != SCHEMA:
        raise DatasetError(f"{path}: schema is {schema!r}, expected {SCHEMA!r}; not a dopslam dataset")
    if version not in READ:
        raise DatasetError(
            f"{path}: schema version {version}, this program reads {' and '.join(map(str, READ))}; make the file anew"
        )


def _split(record) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    columns, scalars = {}, {}
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if value is None:
            continue
        if isinstance(value, np.ndarray):
            columns[field.name] = value.astype(object) if value.dtype.kind in "UO" else value
        else:
            scalars[field.name] = value
    return columns, scalars


def content_hash(record) -> str:
    """sha256 of a record's content: names, types, shapes and values of its fields, independent of time and host."""
    return digest(*_split(record))


def write_record(
    path: str | Path, group: str, record, scenario_toml: str | None = None, seed: int | None = None
) -> None:
    """Add or replace one record of a dataset file.

    Parameters
    ----------
    path : file, made if missing
    group : name of the group, for instance ``"paths"``
    record : a frozen dataclass of arrays and scalars
    scenario_toml, seed : set at the root when given

    Raises
    ------
    DatasetError
        When the target exists but is no dataset, or cannot be written. The old file is then untouched.
    """
    write_records(path, {group: record}, scenario_toml, seed)


def write_records(
    path,
    records: dict[str, Any],
    scenario_toml: str | None = None,
    seed: int | None = None,
    attributes: dict | None = None,
) -> None:
    """Add or replace several records at once, and attributes of the root; see :func:`write_record`."""
    extra = sum(column.nbytes for record in records.values() for column in _split(record)[0].values())
    with _replacing(Path(path), extra) as file:
        if scenario_toml is not None:
            set_text(file, "scenario", scenario_toml)
        if seed is not None:
            file.attrs["seed"] = seed
        for name, value in (attributes or {}).items():
            _set_attribute(file, name, value)
        if "scenario" in file.attrs:
            set_text(file, "root_sha256", _root_digest(file))
        for group, record in records.items():
            _write_group(file, group, record)


def _write_group(file: h5py.File, group: str, record) -> None:
    if group in file:
        del file[group]
    node = file.create_group(group)
    columns, scalars = _split(record)
    set_text(node, "record", type(record).__name__)
    set_text(node, "sha256", digest(columns, scalars))
    for name, value in scalars.items():
        _set_attribute(node, name, value)
    for name, array in columns.items():
        text = array.dtype.kind == "O"
        if text:  # of fixed length, as the attributes; Octave reads no other encoding than ASCII
            encoded = [str(word).encode() for word in array]
            encoding = "ascii" if all(word.isascii() for word in encoded) else "utf-8"
            array = np.array(encoded, dtype=h5py.string_dtype(encoding, max([1, *map(len, encoded)])))
        layout: dict[str, Any] = {"fletcher32": True, "chunks": chunk_shape(array)} if array.size else {}
        dataset = node.create_dataset(name, data=array, **layout)
        set_text(dataset, "units", unit_of(type(record).__name__, name))
        if text:  # by which xarray knows that the bytes are a text
            set_text(dataset, "_Encoding", "utf-8")
    annotate(node, type(record).__name__)


def _set_attribute(node, name: str, value: Any) -> None:
    if isinstance(value, str):
        set_text(node, name, value)
    else:
        node.attrs[name] = value


def read_record(path: str | Path, group: str, record_type: type[Record]) -> Record:
    """Read one record and verify its checksum.

    Raises
    ------
    DatasetError
        Missing file or group, damaged or foreign content; the message says which command makes the group.
    """
    with _reading(Path(path)) as file:
        return _read_group(file, Path(path), group, record_type)


def _read_group(file: h5py.File, path: Path, group: str, record_type: type[Record]) -> Record:
    if group not in file:
        have = ", ".join(sorted(file)) or "nothing"
        raise DatasetError(f"{path}: holds no {group!r} (it holds {have}); {remedy(path, group, set(file))}")
    node = file[group]
    if not isinstance(node, h5py.Group):
        raise DatasetError(f"{path}: {group!r} is a single array where a group is expected; it is no record")
    values: dict[str, Any] = {}
    names, scalars, earlier = [], {}, {}
    for field in dataclasses.fields(record_type):  # type: ignore[arg-type]
        old, convert = EARLIER.get((record_type.__name__, field.name), ("", None))
        if field.name in node:
            names.append(field.name)
        elif old in node:
            names.append(old)
            earlier[old] = field.name, convert
        elif field.name in node.attrs:
            scalars[field.name] = values[field.name] = plain(node.attrs[field.name])
            if "float" in str(field.type) and not isinstance(scalars[field.name], int | float):
                raise DatasetError(f"{path}: attribute {field.name} of {group!r} is no number")
        elif field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            raise DatasetError(f"{path}: {group}/{field.name} is missing; the group is not a {record_type.__name__}")
    if "sha256" in node.attrs:
        columns, found = read(node, names, scalars)
        if plain(node.attrs["sha256"]) != found:
            raise DatasetError(f"{path}: the content of {group!r} does not match its checksum; the file is damaged")
    else:
        columns = {name: texts(array_in(node, name)[()]) for name in names}
    for name, array in columns.items():
        name, convert = earlier.get(name, (name, lambda array: array))
        values[name] = convert(array.astype(str) if array.dtype.kind == "O" else array)
    fault = fault_of(record_type.__name__, {k: v for k, v in values.items() if isinstance(v, np.ndarray)})
    if fault:
        raise DatasetError(f"{path}: {group}/{fault}")
    try:
        return record_type(**values)
    except DopslamError as error:
        raise DatasetError(f"{path}: {group}: {error}") from error


def read_root(path: str | Path) -> tuple[str, int]:
    """The scenario as TOML text and the seed that a dataset was made with."""
    with _reading(Path(path)) as file:
        if "scenario" not in file.attrs:
            raise DatasetError(
                f"{path}: holds no scenario; write the text of a scenario.toml into the attribute 'scenario' of the file's root"
            )
        if "root_sha256" in file.attrs and plain(file.attrs["root_sha256"]) != _root_digest(file):
            raise DatasetError(f"{path}: scenario or seed do not match their checksum; the file is damaged")
        return str(plain(file.attrs["scenario"])), int(file.attrs.get("seed", 0))


def _root_digest(file: h5py.File) -> str:
    return hashlib.sha256(f"{plain(file.attrs['scenario'])}\0{file.attrs.get('seed', 0)}".encode()).hexdigest()


def groups(path: str | Path) -> list[str]:
    """Names of the records a dataset holds."""
    with _reading(Path(path)) as file:
        return sorted(file)


def write_signal(path: str | Path, snapshots: Iterable[np.ndarray], steps: int) -> None:
    """Stream the received signal into a dataset: ``signal/y`` (steps, …) complex64, one snapshot a chunk."""
    snapshots = iter(snapshots)
    first = next(snapshots, None)
    extra = 0 if first is None else first.size * 8 * steps
    with _replacing(Path(path), extra) as file:
        if "signal" in file:
            del file["signal"]
        node = file.create_group("signal")
        dataset, sha = None, hashlib.sha256()
        for step, y in enumerate(itertools.chain([] if first is None else [first], snapshots)):
            if dataset is None:
                dataset = node.create_dataset(
                    "y", (steps, *y.shape), np.complex64, chunks=(1, *y.shape), fletcher32=True
                )
                set_text(dataset, "units", UNITS["y"])
            dataset[step] = y
            sha.update(np.ascontiguousarray(y, np.complex64).tobytes())
        set_text(node, "record", "Signal")
        set_text(node, "sha256", sha.hexdigest())
        annotate(node, "Signal")


def read_snapshot(path: str | Path, step: int) -> np.ndarray:
    """One snapshot of the stored signal, complex64."""
    with _reading(Path(path)) as file:
        if "signal" not in file:
            raise DatasetError(f"{path}: holds no 'signal'; run 'dopslam synthesize {path}' first")
        return array_in(file, "signal/y")[step]


def signal_steps(path: str | Path) -> int:
    """Number of stored snapshots, 0 if the dataset holds no signal."""
    with _reading(Path(path)) as file:
        return array_in(file, "signal/y").shape[0] if "signal" in file else 0


def describe(path: str | Path) -> list[tuple[str, str, str, str, str]]:
    """Rows (group, array, shape, type, units) of everything a dataset holds."""
    with _reading(Path(path)) as file:
        return [
            (group, name, "×".join(map(str, data.shape)), str(data.dtype), str(plain(data.attrs.get("units", ""))))
            for group in sorted(file)
            for name, data in arrays_of(group_in(file, group))
            if not is_scale(group_in(file, group), name)
        ]


def stored_hashes(path: str | Path) -> dict[str, str]:
    """Group → sha256 of its content as the file states it, without reading the content; empty where none is stated."""
    with _reading(Path(path)) as file:
        return {group: str(plain(file[group].attrs.get("sha256", ""))) for group in sorted(file)}


def root_attributes(path: str | Path) -> dict[str, Any]:
    """Attributes of the whole file: schema, scenario, seed, and what its maker noted."""
    with _reading(Path(path)) as file:
        return {k: plain(v) for k, v in file.attrs.items()}


def record_type(path: str | Path, group: str) -> str:
    """Name of the record a group holds."""
    with _reading(Path(path)) as file:
        return str(plain(file[group].attrs.get("record", "")))


def verify_group(path: str | Path, group: str) -> str:
    """Read a group whole, a snapshot at a time if it is the signal, and return the sha256 of what was read.

    Raises
    ------
    DatasetError
        When it cannot be read or does not match the hash stated in the file.
    """
    with _reading(Path(path)) as file:
        node = group_in(file, group)
        if group == "signal":
            found = stream_digest(array_in(node, "y"))
        else:
            names = [name for name, _ in arrays_of(node) if not is_scale(node, name)]
            scalars = {k: plain(v) for k, v in node.attrs.items() if k not in ("record", "sha256")}
            _, found = read(node, names, scalars)
        stated = plain(node.attrs.get("sha256"))
        if stated is not None and stated != found:
            raise DatasetError(f"{path}: the content of {group!r} does not match its checksum; the file is damaged")
        return found
