"""``dopslam check``."""

from __future__ import annotations

from pathlib import Path

from dopslam.cli.common import Seed, Settings


def check(path: str, *, seed: Seed = 0, settings: Settings = None) -> None:
    """Say everything that is wrong with a scene or a dataset; exit code 2 if anything would end a run.

    Of a scene: positions, materials, arrays and beams, then the landmarks that a run will see with their strength, what is
    ambiguous, unresolved or too weak, each with a remedy. Of a dataset: what is wrong where.

    Parameters
    ----------
    path
        Folder with scenario.toml or the name of a scene that ships; or a folder made by 'dopslam dataset', or a dataset
        file.
    seed
        Of the drive that is looked at, as of run.
    settings
        Override a scenario key, for instance --set trace.max_depth=2; may be repeated.
    """
    from dopslam.config.scenario import shipped_scenes

    place = Path(path)
    if place.suffix == ".toml" or (place / "scenario.toml").is_file() or path in shipped_scenes():
        _scene(path, seed, settings)
    else:
        _dataset(place)


def _scene(path: str, seed: int, settings: list[str] | None) -> None:
    from rich.console import Console
    from rich.table import Table

    from dopslam.cli.common import derived_text
    from dopslam.config.scenario import load
    from dopslam.errors import SceneError
    from dopslam.pipeline.look import look

    scenario = load(path, settings or ())
    console = Console(highlight=False, soft_wrap=True, markup=False)
    if scenario.derived:
        console.print(f"derived: {derived_text(scenario.derived)}")
    seen = look(scenario, seed)
    if seen.landmarks:
        table = Table("landmark", "steps with a path", "ρ, dB", "P detected", box=None, pad_edge=False)
        for row in seen.landmarks:
            table.add_row(row.name, f"{row.steps} of {row.of}", f"{row.rho_db:.0f}", f"{row.detection:.2f}")
        console.print(table)
    for finding in seen.findings:
        console.print(str(finding))
    wrong = sum(finding.fatal for finding in seen.findings)
    if wrong:
        raise SceneError(f"{path}: {wrong} fault{'s' if wrong > 1 else ''} that would end a run, listed above")
    console.print(f"{path}: would run" if seen.findings else f"{path}: all is well")


def _dataset(path: Path) -> None:
    from rich.console import Console

    from dopslam.cli.bars import timed_bars
    from dopslam.datasets import check as validate
    from dopslam.errors import DatasetError

    with timed_bars() as progress:
        findings = validate(path, progress)
    console = Console(highlight=False, soft_wrap=True, markup=False)
    for finding in findings:
        console.print(f"{finding.where}: {finding.what}")
    if findings:
        raise DatasetError(f"{path}: {len(findings)} fault{'s' if len(findings) > 1 else ''} found, listed above")
    console.print(f"{path}: all is well")
