"""``dopslam synthesize``."""

from __future__ import annotations

from pathlib import Path

from dopslam.cli.common import Settings, overrides, progress_display


def synthesize(dataset: Path, *, settings: Settings = None) -> None:
    """Add the received signal of every step (paper A, eq. 2) to a dataset file.

    Parameters
    ----------
    dataset
        A file with track and paths.
    settings
        Override a scenario key, for instance --set source.traced.transmit_power_dbm=3.
    """
    from dopslam.pipeline import file as stages

    with progress_display() as progress:
        stages.synthesize(dataset, overrides(settings), progress)
