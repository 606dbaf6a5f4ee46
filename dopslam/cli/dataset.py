"""``dopslam dataset``."""

from __future__ import annotations

from pathlib import Path

from dopslam.cli.common import Seed, Settings, overrides, worker_count


def dataset(
    scene: str,
    *,
    out: Path,
    positions: int | None = None,
    seed: Seed = 0,
    resume: bool = False,
    signal: bool = False,
    detections: bool = False,
    jobs: int | None = None,
    cluster: str | None = None,
    settings: Settings = None,
) -> None:
    """Make a large dataset: a folder of shards with tracks, landmarks and paths of many positions, and a manifest.

    Tracks follow the scenario's [dataset] section: draws of its motion model (default), line, circle, drive (random
    drives inside
    a polygon) or file. The result is the same for any number of processes, workers and interruptions.

    Parameters
    ----------
    scene
        Folder with scenario.toml, or the name of a scene that ships.
    out
        Folder of the dataset; made if missing.
    positions
        Number of positions; by default one drive, or the whole track file.
    seed
        Of everything random.
    resume
        Go on with a dataset that was interrupted, or help another process with it.
    signal
        Store the received signal of every position too.
    detections
        Store estimated detections with their covariances too.
    jobs
        Worker processes for the estimation; by default one for each core.
    cluster
        Address of a Dask scheduler (tcp://host:8786) whose workers estimate instead; needs the extra [cluster].
    settings
        Override a scenario key, for instance --set dataset.tracks.kind=circle --set dataset.tracks.radius=60.
    """
    from rich.console import Console

    from dopslam.cli.bars import timed_bars
    from dopslam.compute.cluster import workers
    from dopslam.config.scenario import load
    from dopslam.datasets import generate, make_plan

    scenario = load(scene, overrides(settings))
    plan = make_plan(scenario, positions, seed, signal, detections)
    with workers(cluster) as threads, timed_bars() as progress:
        manifest = generate(out, plan, scenario, resume, threads or worker_count(jobs), progress)
    paths = sum(entry.paths for entry in manifest.shards)
    Console(markup=False).print(
        f"{out}: {plan.positions} positions, {paths} paths, {len(manifest.landmarks)} landmarks in {plan.shards} shards\n"
        f"sha256 {manifest.sha256}",
        highlight=False,
        soft_wrap=True,
    )
