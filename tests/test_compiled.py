"""Kernels work without a cache folder."""

import numba

from dopslam.compiled import compiled


def test_no_cache_folder_is_slower_never_broken(monkeypatch):
    real = numba.njit

    def refuses_to_cache(*args, **options):
        if options.get("cache"):
            raise RuntimeError("cannot cache function: no locator available")
        return real(*args, **options)

    monkeypatch.setattr(numba, "njit", refuses_to_cache)
    assert compiled(lambda x: x + 1)(2) == 3
