"""Test set-up: one BLAS thread, tracing in one worker only."""

import os

for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import pytest  # noqa: E402


def pytest_collection_modifyitems(items):
    """Keep tracing tests together: every process that traces compiles its own kernels."""
    for item in items:
        if item.get_closest_marker("rt"):
            item.add_marker(pytest.mark.xdist_group("rt"))


@pytest.fixture
def call():
    """Run the command line in this process; returns its exit code."""

    def run(*tokens) -> int:
        from dopslam.cli import main

        try:
            main([str(t) for t in tokens])
        except SystemExit as leave:
            return int(leave.code or 0)
        return 0

    return run
