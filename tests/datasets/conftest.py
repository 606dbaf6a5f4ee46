"""A tracer in closed form, so that what is tested here is the dataset."""

import importlib.util
from pathlib import Path

import pytest

WORKER = Path(__file__).with_name("worker.py")


def _load():
    spec = importlib.util.spec_from_file_location("dataset_worker", WORKER)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def worker():
    """The module of ``worker.py``."""
    return _load()


@pytest.fixture(scope="session")
def program():
    """Path of ``worker.py``, to be run as a process of its own."""
    return WORKER


@pytest.fixture(scope="session")
def made(worker, tmp_path_factory):
    """A complete dataset of 31 positions in 5 shards; do not change it."""
    folder = tmp_path_factory.mktemp("made") / "d"
    worker.make(folder, 31)
    return folder
