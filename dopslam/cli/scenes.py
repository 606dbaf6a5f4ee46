"""``dopslam scenes``."""

from __future__ import annotations


def scenes() -> None:
    """List the scenes that ship with the package."""
    from rich.console import Console
    from rich.table import Table

    from dopslam.config.scenario import load, shipped_scenes

    table = Table("scene", "what it is", "steps", "scatter points", box=None)
    for name, folder in shipped_scenes().items():
        scenario = load(folder)
        table.add_row(name, scenario.title, str(scenario.track.steps), str(len(scenario.scatter_point)))
    Console(markup=False).print(table)
