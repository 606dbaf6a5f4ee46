"""``dopslam slam``."""

from __future__ import annotations

import sys
from pathlib import Path

from dopslam.cli.common import (
    REMEDY,
    Filters,
    Settings,
    doppler_choice,
    filter_names,
    overrides,
    progress_display,
    restarted_text,
    told_of_compiling,
)


def slam(
    dataset: Path,
    *,
    filters: Filters = None,
    doppler_std: str | None = None,
    settings: Settings = None,
) -> None:
    """Run SLAM filters over the detections of a dataset file and add their tracks and maps.

    Parameters
    ----------
    dataset
        A file with detections.
    filters
        One or several, repeated or with commas: joint keeps the cross-covariances of receiver and map, marginal drops
        them as paper A does, smoother adds a fixed lag of filter.lag steps to joint, mixture keeps filter.hypotheses
        global hypotheses, bp is the belief propagation of paper B, batch smooths the whole run over all detections,
        interval smooths joint over the whole run on its own associations, lagged is the smoother asked filter.lag steps later;
        module:Class is one of your own. Default the
        scenario's filter.density.
    doppler_std
        none: leave Doppler out. (A number sets its standard deviation where detections come from the model.)
    settings
        Override a scenario key, for instance --set filter.associations=1.
    """
    from rich.console import Console

    from dopslam.pipeline import file as stages
    from dopslam.pipeline.judge import split_variant

    used, _ = doppler_choice(doppler_std)
    lost, console = {}, Console(markup=False, soft_wrap=True)
    names = filter_names(filters)
    wanted = names or [None]
    with progress_display() as progress:
        for done, name in enumerate(wanted):
            progress("slam", done, len(wanted))
            variant = stages.slam(dataset, overrides(settings), name, used)
            lost[variant], restarted = stages.mishaps(dataset, variant)
            if restarted:
                console.print(restarted_text(variant, restarted))
        progress("slam", len(wanted), len(wanted))
    told_of_compiling(console, [split_variant(variant)[0] for variant in lost])
    for variant, why in lost.items():
        if why:
            console.print(f"diverged: {variant}: {why}; do not use this track ({REMEDY})", style="bold red")
    good = [variant for variant, why in lost.items() if not why]
    if good:
        console.print(
            f"{dataset}: track and map of {', '.join(good)}; next: {stages.after_slam(dataset)}", highlight=False
        )
    if next(iter(lost.values())):
        sys.exit(3)
