"""Large datasets: a folder of shards of bounded size and a manifest, made in any order by any number of processes.

    DIR/manifest.json       what is made, of which scenario and seed; when complete, the sha256 of every shard's content
    DIR/shard-00000.h5 …    dataset files (see :mod:`dopslam.store.schema`) with track, steps, landmarks, paths and what was
    asked for

Every shard depends on the scenario, the seed and its own number only. Neither hashes nor manifest hold times, hosts
or versions:
they are the same for any number of processes and workers, any order, and after any interruption.
"""

from dopslam.datasets.checks import Finding, check
from dopslam.datasets.maker import generate
from dopslam.datasets.manifest import Manifest, read_manifest
from dopslam.datasets.plan import Plan, make_plan

__all__ = ["Finding", "Manifest", "Plan", "check", "generate", "make_plan", "read_manifest"]
