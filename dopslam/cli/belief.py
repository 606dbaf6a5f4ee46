"""``dopslam montecarlo --filter bp``: paper B's synthetic experiment, many times."""

from __future__ import annotations

from pathlib import Path


def belief_study(
    scene: str,
    settings: list[str],
    runs: int,
    particles: int | None,
    seed: int,
    jobs: int,
    json: Path | None,
) -> None:
    """Run the experiment, print its figures, write them to ``json`` if given."""
    from rich.console import Console
    from rich.table import Table

    from dopslam.bp_montecarlo import case_of
    from dopslam.cli.common import progress_display
    from dopslam.config import load
    from dopslam.report.folder import write_json
    from dopslam.slam.bp.cases import run_case
    from dopslam.slam.bp.study import summary

    scenario = load(scene, settings)
    case = case_of(scenario)
    size = particles or case.particles
    with progress_display() as progress:
        results = run_case(case, runs, seed, size, lambda done: progress("runs", done, runs), jobs)
    result = {
        "scene": scene,
        "source": "model",
        "filter": "bp",
        "engine": case.engine,
        "particles": size,
        "seed": seed,
        "settings": settings,
        **summary(results),
    }
    table = Table("", "RMSE", "95 %", "bound", "RMSE / bound", box=None)
    for name, key, unit, factor in (
        ("position", "position_rmse", "m", 1e3),
        ("orientation", "orientation_rmse", "deg", 1),
    ):
        low, high = (factor * v for v in result[f"{key}_interval_{unit}"])
        limit = factor * result[key.replace("rmse", "bound") + f"_{unit}"]
        ratio = result["rmse_over_bound"]["position" if factor > 1 else "heading"]
        shown = "mm" if factor > 1 else "°"
        table.add_row(
            name,
            f"{factor * result[f'{key}_{unit}']:.3f} {shown}",
            f"{low:.3f} – {high:.3f}",
            f"{limit:.3f}",
            f"{ratio:.3f}",
        )
    console = Console()
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
