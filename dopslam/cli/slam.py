"""``dopslam slam``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from dopslam.cli.common import Settings, doppler_choice, overrides


def slam(
    dataset: Path,
    *,
    density: Annotated[Literal["joint", "marginal", "smoother", "bp"] | None, Parameter(name="--filter")] = None,
    doppler_std: str | None = None,
    settings: Settings = None,
) -> None:
    """Run a SLAM filter over the detections of a dataset file and add its track and map.

    Parameters
    ----------
    dataset
        A file with detections.
    density
        joint keeps the cross-covariances of receiver and map, marginal drops them as paper A does, smoother
        adds a fixed lag of filter.lag steps to joint, bp is the belief propagation of paper B (without Doppler).
    doppler_std
        none: leave Doppler out. (A number sets its standard deviation where detections come from the model.)
    settings
        Override a scenario key, for instance --set filter.associations=1.
    """
    from dopslam.pipeline import file as stages

    used, _ = doppler_choice(doppler_std)
    stages.slam(dataset, overrides(settings), density, used)
