"""Workers on other machines: joblib's Dask backend for everything that runs in parallel."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

from dopslam.errors import DopslamError

TIMEOUT = 20  # s, until a scheduler that does not answer counts as absent


@contextlib.contextmanager
def workers(address: str | None) -> Iterator[int | None]:
    """Send parallel work to a Dask scheduler; yields the number of its threads, None without an address.

    Results are the same as without: every task depends on its own numbers only.

    Parameters
    ----------
    address : e.g. ``tcp://10.0.0.5:8786``, or None to stay on this machine

    Raises
    ------
    DopslamError
        If the extra is not installed or no scheduler with workers answers.
    """
    if address is None:
        yield None
        return
    try:
        from distributed import Client  # pyright: ignore[reportMissingImports]  # an extra
    except ImportError as error:
        raise DopslamError("--cluster needs the extra: pip install 'dopslam[cluster]'") from error
    from joblib import parallel_config

    try:
        client = Client(address, timeout=TIMEOUT, set_as_default=True)
    except (OSError, ValueError, TimeoutError) as error:
        raise DopslamError(
            f"--cluster {address!r}: no Dask scheduler answers there ({type(error).__name__}); start one with 'dask scheduler'"
        ) from error
    try:
        told: Any = client.nthreads()  # a client that is not asynchronous answers at once
        threads = sum(told.values())
        if not threads:
            raise DopslamError(
                f"--cluster {address!r}: the scheduler has no workers; start some with 'dask worker {address}'"
            )
        with parallel_config(backend="dask", n_jobs=threads):
            yield threads
    finally:
        client.close()
