"""``dopslam montecarlo``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from dopslam.cli.common import Seed, Settings, doppler_choice, overrides, worker_count


def montecarlo(
    scene: str,
    *,
    source: Literal["model"] = "model",
    runs: int = 100,
    filter_name: Annotated[Literal["joint", "marginal", "smoother", "bp"], Parameter(name="--filter")] = "joint",
    particles: int | None = None,
    doppler_std: str | None = None,
    prior: Literal["std", "var"] = "std",
    seed: Seed = 0,
    jobs: int | None = None,
    cluster: str | None = None,
    json: Path | None = None,
    settings: Settings = None,
) -> None:
    """Run a filter many times on detections drawn from the model and compare it with its bound.

    Parameters
    ----------
    scene
        Scene folder, scenario.toml, or the name of a shipped scene.
    source
        Detections drawn from the measurement model (paper A, Section V).
    runs
        Number of independent runs.
    filter_name
        joint keeps the cross-covariances of receiver and map, marginal drops them as paper A does, smoother
        adds a fixed lag of filter.lag steps to joint; bp is belief propagation on the scenario's [experiment]
        (paper B, Section VI-B).
    particles
        Of belief propagation; default the scenario's.
    doppler_std
        Standard deviation of Doppler in m/s, or none to leave Doppler out; default the scenario's.
    prior
        Reading of track.start_std: standard deviations, or variances (paper A to the letter).
    seed
        Seed of the study; run r depends on seed and r only.
    jobs
        Worker processes; default one per core. The numbers are the same for any.
    cluster
        Address of a Dask scheduler (tcp://host:8786) whose workers do it instead; needs the extra [cluster].
    json
        Write everything, per-step arrays included, to this file.
    settings
        Override a scenario key, for instance --set filter.motion=unknown.
    """
    if filter_name == "bp":
        from dopslam.cli.belief import belief_study
        from dopslam.cluster import workers

        with workers(cluster) as threads:
            belief_study(scene, overrides(settings), runs, particles, seed, threads or worker_count(jobs), json)
        return
    from rich.console import Console
    from rich.table import Table

    from dopslam.cluster import workers
    from dopslam.config.scenario import load
    from dopslam.report.folder import write_json
    from dopslam.studies.montecarlo import run_study, summarize, warm_up
    from dopslam.studies.summary import study

    doppler, std = doppler_choice(doppler_std)
    plan = study(load(scene, overrides(settings)), filter_name, prior, doppler, std)
    compilation = warm_up(plan)
    with workers(cluster) as threads:
        result = summarize(run_study(plan, runs, seed, threads or worker_count(jobs)), plan)
    result = {
        "scene": scene,
        "source": source,
        "filter": filter_name,
        "prior": prior,
        "doppler": doppler,
        "seed": seed,
        "compilation_seconds": compilation,
        **result,
    }
    table = Table("", "RMSE / bound", "95 %", box=None)
    for name, value in result["rmse_over_bound"].items():
        low, high = result["rmse_over_bound_interval"][name]
        table.add_row(name, f"{value:.3f}", f"{low:.3f} – {high:.3f}")
    console = Console(markup=False)
    console.print(table)
    va, sp = result["gospa_va_m"], result["gospa_sp_m"]
    low, high = result["nees_interval"]
    console.print(
        f"NEES {result['nees_mean']:.2f} [{low:.2f}, {high:.2f}] of {result['nees_expected']}   "
        f"GOSPA last step: VA {va['last']:.2f} m, SP {sp['last']:.2f} m\n"
        f"correct association {result['correct_da_weight']:.4f} "
        f"at λ = {result['intensity_va_per_m3']:g} (VA), "
        f"{result['intensity_sp_per_m3']:g} (SP) per m³\n"
        f"diverged {result['diverged']} of {runs}   {result['microseconds_per_step']:.0f} µs per step"
    )
    if json is not None:
        write_json(json, result)
        console.print(f"written: {json}")
