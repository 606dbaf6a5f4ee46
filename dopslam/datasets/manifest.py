"""``manifest.json``: the plan of a dataset and, once complete, what it consists of. Written whole or not at all."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import tempfile
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from dopslam.datasets.plan import LARGEST_SHARDS, Plan
from dopslam.errors import DatasetError

FILE = "manifest.json"
SCHEMA = "dopslam-dataset"
VERSION = 1


@dataclass(frozen=True)
class ShardEntry:
    """One shard: its file, first position, number of positions and paths, and the sha256 of its content."""

    file: str
    first: int
    positions: int
    paths: int
    sha256: str


@dataclass(frozen=True)
class Manifest:
    """A dataset's plan and, if it is complete, its shards, landmarks and hash.

    Attributes
    ----------
    plan : Plan
    shards : one entry each, in order; empty while incomplete
    landmarks : every landmark of the dataset: name, kind, position, order
    sha256 : of everything above; empty while incomplete
    """

    plan: Plan
    shards: tuple[ShardEntry, ...] = ()
    landmarks: tuple[dict[str, Any], ...] = ()
    sha256: str = ""

    @property
    def complete(self) -> bool:
        """Whether every shard was there when the manifest was written."""
        return bool(self.shards)

    def sealed(self) -> Manifest:
        """The same with its hash."""
        return Manifest(self.plan, self.shards, self.landmarks, self.digest())

    def digest(self) -> str:
        """sha256 of plan, shards and landmarks."""
        content = json.dumps(_tree(Manifest(self.plan, self.shards, self.landmarks)), sort_keys=True)
        return hashlib.sha256(content.encode()).hexdigest()


def _tree(manifest: Manifest) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "version": VERSION,
        "complete": manifest.complete,
        "plan": asdict(manifest.plan),
        "shards": [asdict(entry) for entry in manifest.shards],
        "landmarks": list(manifest.landmarks),
        "sha256": manifest.sha256,
    }


def write_manifest(folder: Path, manifest: Manifest, fresh: bool = False) -> None:
    """Write the manifest whole; with ``fresh`` only where there is none, atomically among processes.

    Raises
    ------
    DatasetError
        When the folder cannot be written, or a fresh manifest meets another.
    """
    path = Path(folder) / FILE
    text = json.dumps(_tree(manifest), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    part = None
    try:
        handle, name = tempfile.mkstemp(prefix=f".{FILE}.", suffix=".part", dir=folder)
        part = Path(name)
        with open(handle, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(part, 0o644)
        if fresh:
            os.link(part, path)
        else:
            os.replace(part, path)
        sync_folder(folder)
    except FileExistsError as error:
        raise DatasetError(f"{path}: exists already; add --resume to go on with it, or name another folder") from error
    except OSError as error:
        raise DatasetError(
            f"{path}: cannot be written ({error.strerror or error}); what was there is as it was"
        ) from error
    finally:
        if part is not None:
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)


def sync_folder(folder: Path) -> None:
    """Make renames in a folder last through a power cut."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # some network file systems cannot
            os.fsync(handle)
    finally:
        os.close(handle)


def read_manifest(folder: str | Path) -> Manifest:
    """Read and validate a manifest.

    Raises
    ------
    DatasetError
        Missing, not JSON, of another schema or version, incomplete in its keys, or changed since it was written.
    """
    path = Path(folder) / FILE
    if not path.is_file():
        raise DatasetError(f"{path}: no such manifest; make a dataset with 'dopslam dataset SCENARIO --out {folder}'")
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(tree, dict) or tree.get("schema") != SCHEMA:
            raise ValueError("it is not the manifest of a dopslam dataset")
        if tree["version"] != VERSION:
            raise ValueError(f"it has version {tree['version']}, this program reads {VERSION}")
        manifest = Manifest(
            plan=_exactly(Plan, tree["plan"]),
            shards=tuple(_exactly(ShardEntry, entry) for entry in tree["shards"]),
            landmarks=tuple(_landmark(entry) for entry in tree["landmarks"]),
            sha256=tree["sha256"],
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise DatasetError(
            f"{path}: not a readable manifest ({error}); make the dataset anew or restore the file"
        ) from error
    if manifest.complete and manifest.sha256 != manifest.digest():
        raise DatasetError(f"{path}: its content does not match its own checksum; it was changed or damaged")
    return manifest


def _exactly(kind, values: dict[str, Any]):
    if not isinstance(values, dict):
        raise ValueError(f"{kind.__name__} is {values!r:.80}, no table of keys")
    known = {field.name: field.type for field in fields(kind)}
    if set(values) != set(known):
        raise ValueError(f"keys of {kind.__name__} are {sorted(values)}")
    for name, value in values.items():
        if type(value).__name__ != known[name]:
            raise ValueError(f"{kind.__name__}.{name} = {value!r:.80} is no {known[name]}")
    made = kind(**values)
    if isinstance(made, Plan):
        if made.positions < 1 or made.shard_positions < 1:
            raise ValueError("a number of positions below 1")
        if made.shards > LARGEST_SHARDS:
            raise ValueError(
                f"Plan.positions = {made.positions} by Plan.shard_positions = {made.shard_positions} are {made.shards} "
                f"shards; a dataset has at most {LARGEST_SHARDS}"
            )
    return made


def _landmark(values: Any) -> dict[str, Any]:
    kinds = {"name": str, "kind": int, "order": int, "position": list}
    if not isinstance(values, dict) or set(values) != set(kinds):
        raise ValueError(f"a landmark has the keys {', '.join(kinds)}, not {values!r:.80}")
    place = values["position"]
    right = all(isinstance(values[name], kind) for name, kind in kinds.items()) and len(place) == 3
    if not right or not all(isinstance(x, float | int) and abs(x) < 1e9 for x in place):
        raise ValueError(f"landmark {values!r:.120} is none")
    return values
