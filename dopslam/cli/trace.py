"""``dopslam trace``."""

from __future__ import annotations

from pathlib import Path

from dopslam.cli.common import Seed, Settings, overrides, progress_display


def trace(scene: str, *, out: Path, seed: Seed = 0, settings: Settings = None) -> None:
    """Drive a track through the scene and trace its paths into a new dataset file.

    Parameters
    ----------
    scene
        Folder with scenario.toml, or the name of a scene that ships.
    out
        Dataset file to make.
    seed
        Of the track and the phases of the scatter points.
    settings
        Override a scenario key, for instance --set trace.max_depth=2; may be repeated.
    """
    from dopslam.config.scenario import load
    from dopslam.pipeline import file as stages

    with progress_display() as progress:
        stages.trace(out, load(scene, overrides(settings)), seed, progress)
