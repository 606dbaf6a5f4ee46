"""``dopslam estimate``."""

from __future__ import annotations

from pathlib import Path

from dopslam.cli.common import Settings, overrides, progress_display, worker_count


def estimate(dataset: Path, *, jobs: int | None = None, cluster: str | None = None, settings: Settings = None) -> None:
    """Estimate the paths of every snapshot: detections with covariances.

    Uses the stored signal; without one, the signal of the stored paths is made on the fly, the same to the last bit.

    Parameters
    ----------
    dataset
        A file with a signal, or with track and paths.
    jobs
        Worker processes; by default one for each core. The result does not depend on it.
    cluster
        Address of a Dask scheduler (tcp://host:8786) whose workers do it instead; needs the extra [cluster].
    settings
        Override a scenario key, for instance --set estimator.false_alarm_rate=0.1.
    """
    from dopslam.compute.cluster import workers
    from dopslam.pipeline import file as stages

    with workers(cluster) as threads, progress_display() as progress:
        stages.estimate(dataset, overrides(settings), threads or worker_count(jobs), progress)
