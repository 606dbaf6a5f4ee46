"""``dopslam bound``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from dopslam.cli.common import Settings, doppler_choice, overrides, positive


def bound(
    scene: str,
    *,
    doppler_std: str | None = None,
    prior: Literal["std", "var"] = "std",
    visibility: str = "all",
    information: Annotated[Literal["full", "weighted"], Parameter(negative=())] = "full",
    csv: Path | None = None,
    contributions: Path | None = None,
    settings: Settings = None,
) -> None:
    """Posterior Cramér–Rao bounds: of a scenario on its nominal track, or of a dataset file with its own
    detections.

    Parameters
    ----------
    scene
        Scene folder, scenario.toml or shipped scene; or a dataset file (.h5), which gets the bound of its
        own run added.
    doppler_std
        Standard deviation of Doppler in m/s, or none to leave Doppler out; default the scenario's.
    prior
        Reading of track.start_std: standard deviations, or variances (paper A to the letter).
    visibility
        all, or the range in metres within which scatter points are seen.
    information
        full: every visible landmark is detected at every step (p_D = 1); weighted: information times p_D.
    csv
        Write step,peb_m,heb_rad,ceb_m,leb_…_m to this file, steps from 1.
    contributions
        Write how much information each path's Doppler adds directly to position, heading and landmark (paper A, eqs.
        22-25) to this CSV file.
    settings
        Override a scenario key.
    """
    from rich.console import Console

    from dopslam.errors import ConfigError

    doppler, std = doppler_choice(doppler_std)
    console = Console(markup=False)
    if Path(scene).is_file() and Path(scene).suffix != ".toml":
        if std is not None or csv is not None:
            raise ConfigError(f"{scene}: a dataset's bound uses its own R; leave out a numeric --doppler-std and --csv")
        from dopslam.pipeline import file as stages

        stages.bound(Path(scene), overrides(settings), doppler)
        used = "with" if doppler else "without"
        console.print(f"{scene}: bound added ({used} Doppler, the run's own detections and R)")
        return
    from dopslam.config.scenario import load
    from dopslam.pipeline import problem as build
    from dopslam.report.folder import write_text
    from dopslam.store.place import refuse_no_file
    from dopslam.studies.summary import bound_table, contribution_table, nominal_bound

    refuse_no_file(csv, contributions)
    reach = _visibility(visibility)
    scenario = load(scene, overrides(settings))
    result = nominal_bound(scenario, prior, doppler, std, reach, information == "weighted")
    header, rows = bound_table(result, build.model_landmarks(scenario).name)
    used = std if std is not None else scenario.source.model.doppler_std
    console.print(
        f"nominal track, {'p_D = 1' if information == 'full' else 'information weighted by p_D'}, "
        f"Doppler {f'{used:g} m/s' if doppler else 'not used'}, prior read as {prior}, "
        f"scatter points seen {'everywhere' if reach is None else f'within {reach:g} m'}"
        + (" (p_D's own range)" if information == "weighted" else "")
    )
    last = len(result.peb) - 1
    console.print(
        f"mean over steps: PEB {result.peb.mean():.4f} m, HEB {result.heb.mean():.6f} rad, "
        f"CEB {result.ceb.mean():.4f} m; "
        f"last step: {result.peb[last]:.4f} m, {result.heb[last]:.6f} rad, {result.ceb[last]:.4f} m"
    )
    if contributions is not None:
        table = contribution_table(scenario, prior, std)
        write_text(contributions, "\n".join(",".join(row) for row in [table[0], *table[1]]) + "\n")
        console.print(f"written: {contributions}")
    if csv is not None:
        write_text(csv, "\n".join(",".join(row) for row in [header, *rows]) + "\n")
        console.print(f"written: {csv}")


def _visibility(text: str) -> float | None:
    if text.lower() == "all":
        return None
    return positive(text, "--visibility", "give a positive range in m, or all")
