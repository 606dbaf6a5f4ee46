"""``dopslam montecarlo``."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from dopslam.cli.common import (
    Filters,
    Runs,
    Seed,
    Settings,
    doppler_choice,
    filter_names,
    overrides,
    progress_display,
    worker_count,
)


def montecarlo(
    scene: str,
    *,
    source: Literal["model", "experiment"] | None = None,
    runs: Runs = 100,
    filters: Filters = None,
    particles: int | None = None,
    doppler_std: str | None = None,
    prior: Literal["std", "var"] = "std",
    seed: Seed = 0,
    jobs: int | None = None,
    cluster: str | None = None,
    json: Path | None = None,
    settings: Settings = None,
) -> None:
    """Run filters many times on detections drawn from the model and compare them with their bound.

    All filters get the same draws: run r depends on seed and r only.

    Parameters
    ----------
    scene
        Scene folder, scenario.toml, or the name of a shipped scene.
    source
        model: detections drawn from the measurement model (paper A, Section V). experiment: the scenario's [experiment]
        (paper B, Section VI-B), for bp only. Default: experiment for bp alone where the scenario has one, else model.
    runs
        Number of independent runs.
    filters
        One or several, repeated or with commas: joint (default), marginal, smoother, mixture, bp, batch, or module:Class.
    particles
        Of belief propagation; default the scenario's filter.particles.
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
    from rich.console import Console

    from dopslam.compute.cluster import workers
    from dopslam.config.scenario import load
    from dopslam.errors import ConfigError
    from dopslam.store.place import refuse_no_file

    refuse_no_file(json)
    names = filter_names(filters) or ["joint"]
    flags = overrides(settings, filter__particles=None if particles is None else str(particles))
    scenario = load(scene, flags)
    if source is None:
        source = "experiment" if names == ["bp"] and scenario.experiment is not None else "model"
    if source == "experiment":
        from dopslam.cli.belief import belief_study

        if names != ["bp"]:
            raise ConfigError("--source experiment: only bp reads its amplitudes; choose --filter bp or --source model")
        if doppler_std is not None or prior != "std":
            raise ConfigError(
                "--source experiment has no Doppler and no track.start_std; drop --doppler-std and --prior"
            )
        with workers(cluster) as threads:
            belief_study(scene, scenario, flags, runs, seed, threads or worker_count(jobs), json)
        return
    from dopslam.pipeline.reads import refuse_unread
    from dopslam.report import tables
    from dopslam.report.folder import write_json
    from dopslam.slam.filter import uses_doppler
    from dopslam.studies.montecarlo import run_study, summarize, warm_up
    from dopslam.studies.summary import study

    refuse_unread(lambda chosen: load(scene, chosen), settings or (), ("montecarlo",), names)
    doppler, std = doppler_choice(doppler_std)
    results = {}
    with workers(cluster) as threads, progress_display() as progress:
        for name in names:
            plan = study(scenario, name, prior, doppler, std)
            progress(name, 0, runs)
            compilation = warm_up(plan)
            done = run_study(
                plan, runs, seed, threads or worker_count(jobs), lambda n, name=name: progress(name, n, runs)
            )
            figures = summarize(done, plan)
            results[name] = {
                "scene": scene, "source": source, "filter": name, "prior": prior, "doppler": uses_doppler(plan.chosen), "seed": seed,
                "compilation_seconds": compilation, **figures,
            }  # fmt: skip
    console = Console(markup=False)
    console.print(tables.ratios(results))
    for result in results.values():
        console.print(_told(result, runs))
    if json is not None:
        first = results[names[0]]
        write_json(json, first if len(names) == 1 else first | {"filters": results})
        console.print(f"written: {json}")


def _told(result: dict[str, Any], runs: int) -> str:
    va, sp = result["gospa_va_m"], result["gospa_sp_m"]
    low, high = result["nees_interval"]
    weight = result["correct_da_weight"]
    association = (
        ""
        if weight is None
        else f"correct association {weight:.4f} "
        f"at λ = {result['intensity_va_per_m3']:g} (VA), {result['intensity_sp_per_m3']:g} (SP) per m³\n"
    )
    return (
        f"{result['filter']}: NEES {result['nees_mean']:.2f} [{low:.2f}, {high:.2f}] of {result['nees_expected']}   "
        f"GOSPA last step: VA {va['last']:.2f} m, SP {sp['last']:.2f} m\n{association}"
        f"diverged {result['diverged']} of {runs}   {result['microseconds_per_step']:.0f} µs per step"
    )
