"""``dopslam simulate``."""

from __future__ import annotations

from pathlib import Path

from dopslam.cli.common import Seed, Settings, overrides


def simulate(
    scene: str, *, out: Path, seed: Seed = 0, doppler_std: float | None = None, settings: Settings = None
) -> None:
    """Draw a track and its detections from the measurement model, without tracing, into a new dataset file.

    Parameters
    ----------
    scene
        Folder with scenario.toml, or the name of a scene that ships.
    out
        Dataset file to make.
    seed
        Of track, detections and clutter.
    doppler_std
        Standard deviation of the radial velocity [m/s]; shorthand for --set source.model.doppler_std=….
    settings
        Override a scenario key.
    """
    from dopslam.config.scenario import load
    from dopslam.pipeline import file as stages

    flags = overrides(
        settings, source__kind="model", source__model__doppler_std=None if doppler_std is None else str(doppler_std)
    )
    stages.simulate(out, load(scene, flags), seed)
