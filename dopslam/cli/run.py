"""``dopslam run``: the stages one after the other."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Literal

from dopslam.cli.common import (
    Filters,
    Seed,
    Settings,
    derived_text,
    doppler_choice,
    filter_names,
    leave_if_lost,
    overrides,
    progress_display,
    told_of_compiling,
    worker_count,
)
from dopslam.cli.failure import sentence


def run(
    scene: str = "ring_road",
    *,
    seed: Seed = 0,
    source: Literal["traced", "model"] | None = None,
    filters: Filters = None,
    doppler_std: str | None = None,
    jobs: int | None = None,
    out: Path = Path("runs"),
    keep_signal: bool = False,
    settings: Settings = None,
) -> None:
    """Trace, synthesize, estimate, run SLAM, bound and evaluate one scenario; leaves a results folder.

    A run that fails or is interrupted keeps what it finished in <scene>-<time>-unfinished. The table
    shows every filter with and without Doppler on the same detections.

    Parameters
    ----------
    scene
        Folder with scenario.toml, or the name of a scene that ships.
    seed
        Of everything random.
    source
        traced: estimated from the signal of a traced scene. model: drawn from the measurement model, as in paper A.
    filters
        One or several, repeated or with commas, the first leads the summary: joint, marginal, smoother, mixture, bp, batch,
        or module:Class of your own. Default joint, marginal and the scenario's filter.density.
    doppler_std
        none: only filters without Doppler. A number sets the standard deviation [m/s] where the source is the model.
    jobs
        Worker processes for the estimation; by default one for each core. Results do not depend on it.
    out
        Folder that gets the results folder <scene>-<time> and the link "latest".
    keep_signal
        Store the received signal in the dataset too.
    settings
        Override a scenario key, for instance --set trace.max_depth=2; may be repeated.
    """
    from rich.console import Console

    from dopslam.config.scenario import load
    from dopslam.pipeline import ahead
    from dopslam.pipeline import file as stages
    from dopslam.pipeline.look import look_at
    from dopslam.pipeline.preflight import refuse
    from dopslam.pipeline.reads import refuse_unread
    from dopslam.report import folder, tables

    used, std = doppler_choice(doppler_std)
    names = filter_names(filters)

    def made(chosen: list[str] | None):
        flags = {"source__kind": source, "source__model__doppler_std": None if std is None else str(std)}
        return load(scene, overrides(chosen, **flags, filter__density=repr(names[0]) if names else None))

    scenario = made(settings)
    wanted = names or list(dict.fromkeys(["joint", "marginal", scenario.filter.density]))
    before = ["simulate"] if scenario.source.kind == "model" else ["trace", "estimate"]
    refuse_unread(made, settings or (), [*before, "bound", "evaluate", "slam"], wanted)
    console = Console(markup=False)
    if scenario.derived:
        console.print(f"derived: {derived_text(scenario.derived)}", highlight=False)
    seconds: dict[str, float] = {}

    def timed(name: str, function, *arguments):
        start = time.perf_counter()
        function(*arguments)
        seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - start

    failed: dict[str, str] = {}
    foreseen: list = []

    def tried(name: str, stage: str, function, *arguments):
        """A variant that fails is named at the end; the others go on."""
        try:
            timed(stage, function, *arguments)
        except Exception as error:
            if os.environ.get("DOPSLAM_DEBUG"):
                raise
            failed[name] = sentence(error)

    with folder.results_folder(out, scenario.name) as (working, final):
        data = working / "dataset.h5"
        (working / "scenario.toml").write_text(scenario.to_toml(), encoding="utf-8")
        traced = scenario.source.kind == "traced"
        with progress_display() as progress, ahead.compiling(wanted if traced else ()) as compiler:
            if not traced:
                timed("simulate", stages.simulate, data, scenario, seed)
            else:
                timed("trace", stages.trace, data, scenario, seed, progress)
                tried("look ahead", "trace", lambda: foreseen.extend(look_at(data).findings))
                for finding in foreseen:
                    console.print(f"note: {finding}", highlight=False, soft_wrap=True)
                refuse([finding for finding in foreseen if finding.fatal])
                if keep_signal:
                    timed("synthesize", stages.synthesize, data, (), progress)
                timed("estimate", stages.estimate, data, (), worker_count(jobs), progress)
            variants = stages.variants_of(scenario, wanted, used)
            for done, (name, doppler) in enumerate(variants):
                progress("slam", done, len(variants))
                tried(stages.variant_name(name, doppler), "slam", stages.slam, data, (), name, doppler)
            progress("slam", len(variants), len(variants))
            if ahead.missing(wanted):
                ahead.go_on(compiler)
            both = (True, False) if used else (False,)
            for done, doppler in enumerate(both):
                progress("bound", done, len(both))
                tried(stages.bound_name(doppler), "bound", stages.bound, data, (), doppler)
            progress("bound", len(both), len(both))
            start = time.perf_counter()
            summary = None
            progress("report", 0, 2)
            try:
                summary, evaluations = stages.evaluate(data, failed=failed)
                progress("report", 1, 2)
                summary |= {"derived": scenario.derived, "foreseen": [str(finding) for finding in foreseen]}
                summary["seconds"] = seconds | {"evaluate": time.perf_counter() - start}
                stages.report(data, working, summary, evaluations)
                progress("report", 2, 2)
            except Exception as error:  # what was computed is worth more than its report
                failed["evaluate"] = sentence(error)
                folder.write_json(working / "failed.json", failed)
    if summary is not None:
        console.print(tables.run_table(summary))
    told_of_compiling(console, wanted)
    for name, why in failed.items():
        console.print(f"failed: {name}: {why}")
    console.print(f"results: {final}", soft_wrap=True)
    try:
        if failed:
            sys.exit(1)
        if summary is not None:
            leave_if_lost(summary, console)
    finally:  # the last line, whatever else there is to say
        if (final / "report.html").exists():
            console.print(f"report: {final / 'report.html'}", soft_wrap=True)
