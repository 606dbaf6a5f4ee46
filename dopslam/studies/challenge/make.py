"""Making a suite: detections as files with checksums, what is told about each case, and the truth in a folder apart.

``suite.json`` lists every case and the sha256 of its files; ``develop/`` and ``test/`` hold three files a case::

    NAME.csv    detections, one a row, SI units and radians, covariance included
    NAME.json   what is told: base station, start, motion, how detections come about
    NAME.h5     the same as a dataset file, for 'dopslam slam'

The truth folder holds ``NAME.h5`` with track, landmarks and the bounds of the run.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

from dopslam.config.scenario import Scenario
from dopslam.errors import DatasetError
from dopslam.pipeline import problem as build
from dopslam.pipeline import stages as pipeline
from dopslam.pipeline.stages import Progress, quiet
from dopslam.records import DetectionSeries, Landmarks, Paths, Track
from dopslam.report.folder import write_text
from dopslam.store import file as dataset
from dopslam.studies.challenge.cases import LEVELS, STEPS, Case, Drawn, at_level, drawn, scenario_of

FORMAT = 1
MANIFEST = "suite.json"
SIGNAL = ".signal"  # ending of files with signals, and of the cases that begin at them
SIGNALED = ("sharp", 0)  # level and drive that have one
ANGLES = ("aoa_azimuth_rad", "aoa_elevation_rad", "aod_azimuth_rad", "aod_elevation_rad")
QUANTITIES = ("delay_s", *ANGLES, "radial_velocity_m_s")
PAIRS = [(i, j) for i in range(6) for j in range(i, 6)]
BOUNDS = {(False, True): "bound_doppler", (True, True): "bound_doppler_smoothed"}  # smoothed, Doppler


def make(
    out: Path,
    truth: Path,
    cases: Sequence[Case],
    steps: int = STEPS,
    jobs: int = 1,
    progress: Progress = quiet,
    signals: bool = False,
) -> dict:
    """Make a suite in two new folders; returns the manifest. With ``signals`` the first drive through every scene has its
    received signal too (:mod:`dopslam.studies.challenge.signals`).

    Raises
    ------
    DatasetError
        If one of the folders exists.
    """
    out, truth = Path(out), Path(truth)
    for folder in (out, truth):
        if folder.exists():
            raise DatasetError(f"{folder}: exists already; remove it or name another folder")
    drives = sorted({(c.kind, c.scene, c.seed, c.split) for c in cases})
    parts = [folder.with_name(f".{folder.name}.part") for folder in (out, truth)]
    try:
        for part in parts:
            shutil.rmtree(part, ignore_errors=True)
            for split in {c.split for c in cases} if part is parts[0] else {"."}:
                (part / split).mkdir(parents=True, exist_ok=True)
        work = Parallel(n_jobs=jobs, return_as="generator_unordered")(
            delayed(_drive)(kind, scene, seed, split, steps, signals, *parts) for kind, scene, seed, split in drives
        )
        entries: list[dict] = []
        progress("cases", 0, len(drives))
        for done, made in enumerate(work, start=1):
            entries += made or []
            progress("cases", done, len(drives))
        wanted = {c.name for c in cases}
        manifest = {
            "suite": "dopslam detections to map", "format": FORMAT, "steps": steps,
            "levels": {name: {"power_db": power, "calibration_std": std.tolist()} for name, (power, std) in LEVELS.items()},
            "cases": sorted((e for e in entries if e["name"] in wanted), key=lambda e: (e["split"], e["name"])),
        }  # fmt: skip
        write_text(parts[0] / MANIFEST, json.dumps(manifest, indent=1) + "\n")
        for part, folder in zip(parts, (out, truth), strict=True):
            part.rename(folder)
    except OSError as error:
        raise DatasetError(f"{out}: cannot be written ({error.strerror or error})") from error
    finally:
        for part in parts:
            shutil.rmtree(part, ignore_errors=True)
    return manifest


def _drive(
    kind: str, scene: int, seed: int, split: str, steps: int, signals: bool, out: Path, truth: Path
) -> list[dict]:
    """Both levels of one drive, which is traced once."""
    first = Case(kind, scene, seed, next(iter(LEVELS)), split)
    traced = pipeline.trace(scenario_of(first, steps), seed)
    assert traced.paths is not None
    entries = []
    for level in LEVELS:
        case = at_level(first, level)
        found = drawn(case, scenario_of(case, steps), traced.track, traced.landmarks, traced.paths)
        entries.append(write_case(found, out / split, truth))
        if signals and (level, seed) == SIGNALED:
            hidden = traced.track, traced.landmarks, traced.paths
            entries[-1]["signal"] = write_signal(case.name, split, found.scenario, seed, hidden, out / split, truth)
    return entries


def write_signal(
    name: str, split: str, told: Scenario, seed: int, hidden: tuple[Track, Landmarks, Paths], folder: Path, truth: Path
) -> dict:
    """Write signal and paths of a case; returns what its entry in the manifest says of them.

    Parameters
    ----------
    name, split : of the case
    told : the scenario as participants get it
    seed : of the noise
    hidden : track, landmarks and paths
    folder, truth : of the split, and of the truth
    """
    track, landmarks, paths = hidden
    path, kept = folder / f"{name}{SIGNAL}.h5", truth / f"{name}{SIGNAL}.h5"
    dataset.write_records(path, {"base_stations": build.base_stations(told)}, told.to_toml(), 0)
    dataset.write_signal(path, pipeline.synthesize(told, track, paths, seed), paths.steps)
    dataset.write_records(kept, {"track": track, "landmarks": landmarks, "paths": paths}, told.to_toml(), seed)
    return {
        "files": {f"{split}/{path.name}": sha256(path)},
        "truth": {kept.name: sha256(kept)},
    }


def write_case(found: Drawn, folder: Path, truth: Path) -> dict:
    """Write the files of one case; returns its entry in the manifest."""
    case, scenario = found.case, found.scenario
    base = folder / case.name
    records = {"base_stations": build.base_stations(scenario), "detections": found.detections}
    dataset.write_records(base.with_suffix(".h5"), records, scenario.to_toml(), 0)
    write_text(base.with_suffix(".csv"), detections_csv(found.detections))
    write_text(base.with_suffix(".json"), json.dumps(told(found), indent=1) + "\n")
    run = scenario, found.track, found.landmarks, None, found.detections
    hidden = {"track": found.track, "landmarks": found.landmarks} | {
        group: pipeline.bound(*run, doppler, smoothed, label=found.label)
        for (smoothed, doppler), group in BOUNDS.items()
    }
    seen = np.bincount(found.label[found.label >= 0], minlength=len(found.landmarks))
    kept = truth / f"{case.name}.h5"
    dataset.write_records(kept, hidden, scenario.to_toml(), case.seed, {"detected": json.dumps(seen.tolist())})
    return {
        "name": case.name, "split": case.split, "kind": case.kind, "scene": case.scene, "seed": case.seed, "level": case.level,
        "detections": len(found.detections.delay), "content": dataset.content_hash(found.detections),
        "files": {f"{case.split}/{case.name}{ending}": sha256(base.with_suffix(ending)) for ending in (".csv", ".json", ".h5")},
        "truth": {kept.name: sha256(kept)},
    }  # fmt: skip


def sha256(path: Path) -> str:
    """Checksum of a file's bytes."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def detections_csv(series: DetectionSeries) -> str:
    """Detections as text, one a row: snapshot (from 1), time, the six quantities, ρ, and the upper triangle of the
    covariance in the same order (``cov_12`` is that of delay and AOA azimuth)."""
    assert series.time is not None
    out = io.StringIO()
    lines = csv.writer(out, lineterminator="\n")
    names = [f"cov_{i + 1}{j + 1}" for i, j in PAIRS]
    lines.writerow(["step", "time_s", *QUANTITIES, "rho", *names])
    z = np.column_stack([series.delay, series.aoa, series.aod, series.radial_velocity, series.snr])
    triangle = series.covariance[:, [i for i, _ in PAIRS], [j for _, j in PAIRS]]
    for step in range(series.steps):
        for row in range(*series.rows(step).indices(len(z))):
            numbers = [f"{value:.17g}" for value in (*z[row], *triangle[row])]
            lines.writerow([step + 1, f"{series.time[step]:.17g}", *numbers])
    return out.getvalue()


def told(found: Drawn) -> dict:
    """What a participant is told about a case besides its detections."""
    scenario, series = found.scenario, found.detections
    problem, track = build.problem(scenario), scenario.track
    assert series.time is not None
    return {
        "name": found.case.name,
        "time_s": series.time.tolist(),
        "base_station": {"position_m": problem.anchor.tolist(), "yaw_rad": float(problem.stations.yaw[0])},
        "receiver_height_m": problem.height,
        "start": {
            "of": ["x_m", "y_m", "heading_rad", "bias_m"], "mean": problem.mean[:4].tolist(),
            "std": np.sqrt(np.diag(problem.covariance)[:4]).tolist(), "when": "one period before the first snapshot",
        },
        "motion": {
            "model": "coordinated turn: constant speed and turn rate, white noise on the four states every period",
            "speed_m_s": track.speed, "turn_rate_rad_s": track.turn_rate, "period_s": track.period,
            "noise_std_per_period": list(track.process_std),
        },
        "detections": {
            "threshold_on_rho": series.threshold, "false_per_snapshot": series.false_alarm_rate,
            "search_volume_m_rad4_m_s": series.search_volume,
            "delay_known_modulo_s": series.delay_range if np.isfinite(series.delay_range) else None,
        },
    }  # fmt: skip
