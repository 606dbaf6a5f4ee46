"""``dopslam montecarlo --source experiment``: paper B's synthetic experiment, many times."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dopslam.config.scenario import Scenario


def belief_study(
    scene: str,
    scenario: Scenario,
    settings: list[str],
    runs: int,
    seed: int,
    jobs: int,
    json: Path | None,
) -> None:
    """Run the experiment, print its figures, write them to ``json`` if given."""
    from rich.console import Console
    from rich.table import Table

    from dopslam.cli.common import progress_display
    from dopslam.report.folder import write_json
    from dopslam.studies.bp import case_of
    from dopslam.studies.bp_cases import run_case
    from dopslam.studies.bp_study import summary

    case = case_of(scenario)
    size = case.particles
    with progress_display() as progress:
        results = run_case(case, runs, seed, size, lambda done: progress("runs", done, runs), jobs)
    result = {
        "scene": scene,
        "source": "experiment",
        "filter": "bp",
        "engine": case.engine,
        "particles": size,
        "seed": seed,
        "settings": settings,
        **summary(results),
    }
    table = Table("", "RMSE", "95 %", "bound", "RMSE / bound", box=None)
    low, high = (1e3 * v for v in result["position_rmse_interval_m"])
    position, limit = 1e3 * result["position_rmse_m"], 1e3 * result["position_bound_m"]
    ratio = result["rmse_over_bound"]
    table.add_row(
        "position [mm]", f"{position:.2f}", f"{low:.2f} – {high:.2f}", f"{limit:.2f}", f"{ratio['position']:.3f}"
    )
    low, high = result["orientation_rmse_interval_deg"]
    turn, limit = result["orientation_rmse_deg"], result["orientation_bound_deg"]
    table.add_row(
        "orientation [°]", f"{turn:.3f}", f"{low:.3f} – {high:.3f}", f"{limit:.3f}", f"{ratio['heading']:.3f}"
    )
    console = Console(markup=False)
    console.print(table)
    console.print(
        f"belief in the true types {', '.join(f'{v:.3f}' for v in result['type_belief_true'])}, above 0.9 from step "
        f"{', '.join(str(v) for v in result['type_belief_above_0.9_from_step'])}\n"
        f"lost {result['diverged']}, ghost anchors {result['ghost_runs']}, all features found in "
        f"{result['found_all_runs']} of {runs} runs, {result['false_features']:.2f} false features\n"
        f"{1e3 * result['seconds_per_step']:.1f} ms per step"
    )
    if json is not None:
        write_json(json, result)
        console.print(f"written: {json}")
