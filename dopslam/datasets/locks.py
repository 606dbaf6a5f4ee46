"""One lock per shard, so that processes on one folder share the work and a killed one leaves nothing locked."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from dopslam.errors import DatasetError

FOLDER = ".locks"


@contextlib.contextmanager
def claim(folder: Path, number: int, wait: bool = False) -> Iterator[bool]:
    """Whether this process may make a shard: True while the lock is held, False if another process holds it.

    The operating system releases the lock of a process that dies. On file systems without locks everybody may: shards
    are
    put in place whole and are the same whoever makes them, so that only time is lost.
    """
    try:
        (Path(folder) / FOLDER).mkdir(exist_ok=True)
        handle = os.open(Path(folder) / FOLDER / f"{number:05d}", os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise DatasetError(f"{folder}: cannot be written ({error.strerror}); give a folder that can") from error
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            mine = True
        except BlockingIOError:
            mine = False
        except OSError:  # no locks here
            mine = True
        yield mine
    finally:
        os.close(handle)
