"""The stages over one dataset file: each reads the records it needs, adds its own, and can start from anybody's
file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from dopslam.config.scenario import Scenario, override, parse
from dopslam.errors import DatasetError, DopslamError
from dopslam.evaluate.alignment import aligned
from dopslam.evaluate.bounds import Bound
from dopslam.evaluate.run import Evaluation
from dopslam.filters import FILTERS
from dopslam.pipeline import ahead
from dopslam.pipeline import problem as build
from dopslam.pipeline import stages as pipeline
from dopslam.pipeline.judge import WITHOUT, judged, split_variant, variant_name, walls_of
from dopslam.pipeline.reads import refuse_unread
from dopslam.pipeline.signals import StoredSignal
from dopslam.pipeline.stages import Progress, SyntheticSignal, quiet
from dopslam.records import DetectionSeries, FloorPlan, Kind, Landmarks, Mesh, Paths, Track
from dopslam.records.consistency import misfits
from dopslam.report import figures, folder, page, replay, tables
from dopslam.slam.history import History
from dopslam.store import file as dataset
from dopslam.store.place import refuse_unwritable


def scenario_of(path: Path, settings=(), stage: str = "", names: Sequence[str] = ()) -> tuple[Scenario, int]:
    """The scenario and seed a dataset was made with, with later ``--set`` applied; what ``stage`` does not read is refused.

    Raises
    ------
    ConfigError
        If a setting changes nothing of what the stage is handed.
    """
    text, seed = dataset.read_root(path)
    stored = parse(text, source=str(path))
    if stage:
        refuse_unread(lambda chosen: override(stored, chosen), settings, (stage,), names)
    return override(stored, settings), seed


def trace(path: Path, scenario: Scenario, seed: int, progress: Progress = quiet) -> None:
    """Start a dataset: track, landmarks, paths and floor plan of a traced scenario."""
    _check_new(path)
    traced = pipeline.trace(scenario, seed, progress)
    records = {
        "base_stations": build.base_stations(scenario), "track": traced.track, "landmarks": traced.landmarks,
        "paths": traced.paths, "plan": traced.plan, "mesh": traced.mesh,
    }  # fmt: skip
    dataset.write_records(path, records, scenario.to_toml(), seed)


def simulate(path: Path, scenario: Scenario, seed: int) -> None:
    """Start a dataset without a tracer: track, landmarks and detections drawn from the measurement model."""
    _check_new(path)
    track, landmarks, detections = pipeline.simulate(scenario, seed)
    records = {
        "base_stations": build.base_stations(scenario), "track": track, "landmarks": landmarks, "detections": detections,
    }  # fmt: skip
    dataset.write_records(path, records, scenario.to_toml(), seed)


def _check_new(path: Path) -> None:
    """Refuse before the work what could not be written after it."""
    if Path(path).exists():
        raise DatasetError(f"{path}: exists already; remove it or name another file with --out")
    if not Path(path).resolve().parent.is_dir():
        raise DatasetError(f"{path}: the folder {str(Path(path).parent)!r} does not exist; create it first")
    refuse_unwritable(path)


def synthesize(path: Path, settings=(), progress: Progress = quiet) -> None:
    """Add the received signal of every step."""
    scenario, seed = scenario_of(path, settings, "synthesize")
    refuse_unwritable(path)
    track, paths = _read(path, track=Track, paths=Paths)
    dataset.write_signal(path, pipeline.synthesize(scenario, track, paths, seed, progress), paths.steps)


def estimate(path: Path, settings=(), jobs: int = 1, progress: Progress = quiet) -> None:
    """Add the detections of every snapshot, from the stored signal or, without one, from the signal of the paths."""
    scenario, seed = scenario_of(path, settings, "estimate")
    refuse_unwritable(path)
    stored = dataset.signal_steps(path)
    if stored:
        time = dataset.read_record(path, "track", Track).time if "track" in dataset.groups(path) else None
        signal = StoredSignal(Path(path), stored, time)
    else:
        track, paths = _read(path, track=Track, paths=Paths)
        signal = SyntheticSignal(scenario.to_toml(), track, paths, seed)
    detections = pipeline.estimate(scenario, signal, jobs, progress)
    dataset.write_record(path, "detections", detections, scenario.to_toml())


def _read(path: Path, **kinds: type) -> list[Any]:
    """Records of a dataset by their groups, which must belong together."""
    records = {group: dataset.read_record(path, group, kind) for group, kind in kinds.items()}
    _refuse_misfits(path, records)
    return list(records.values())


def _refuse_misfits(path: Path, records: dict[str, Any]) -> None:
    found = misfits(records)
    if found:
        where, what = found[0]
        raise DatasetError(f"{path}: {where} {what}; the records are not of one run")


def read_truth(path: Path) -> tuple[Track, Landmarks, Paths | None, FloorPlan | None]:
    """The truth in a dataset; paths and plan are None where detections were drawn from the model."""
    have = dataset.groups(path)
    kinds: dict[str, type] = {"track": Track, "landmarks": Landmarks, "paths": Paths, "plan": FloorPlan}
    track, landmarks, *others = _read(
        path, **{n: k for n, k in kinds.items() if n in have or n in ("track", "landmarks")}
    )
    found = dict(zip([n for n in ("paths", "plan") if n in have], others, strict=True))
    return track, landmarks, found.get("paths"), found.get("plan")


def read_detections(path: Path) -> DetectionSeries:
    """The detections in a dataset."""
    return dataset.read_record(path, "detections", DetectionSeries)


def variants_of(scenario: Scenario, names: Sequence[str], doppler: bool = True) -> list[tuple[str, bool]]:
    """(filter, Doppler) of every variant: each filter with Doppler if it can and it is wanted, and without."""
    able = {name: pipeline.uses_doppler(scenario, name) for name in dict.fromkeys(names)}
    return [(name, used) for name, can in able.items() for used in (True, False) if (can and doppler) or not used]


_ENDING = "_no_doppler"  # of a group


def _group(kind: str, variant: str) -> str:
    name, doppler = split_variant(variant)
    name = name.replace("%", "%25").replace("/", "%2F")  # path/to/file.py:Class; a slash would be a group in a group
    return f"{kind}_{name}" + ("" if doppler else _ENDING)


def _bound_group(doppler: bool, smoothed: bool = False, lag: int | None = None) -> str:
    later = "" if not smoothed else "_smoothed" if lag is None else f"_lag_{lag}"
    return ("bound_doppler" if doppler else "bound_no_doppler") + later


def blurred(scenario: Scenario, detections: DetectionSeries, seed: int) -> DetectionSeries:
    """The detections with the model source's noise added where the scenario asks for it."""
    wanted = scenario.source.kind == "traced" and scenario.source.traced.added_noise == "model"
    return pipeline.blur(scenario, detections, seed) if wanted else detections


def slam(path: Path, settings=(), filter_name: str | None = None, doppler: bool = True) -> str:
    """Add the history of one filter variant; returns its name (:func:`mishaps` says whether it can be trusted)."""
    scenario, seed = scenario_of(path, settings, "slam", (filter_name,) if filter_name else ())
    refuse_unwritable(path)
    detections = blurred(scenario, read_detections(path), seed)
    filter_name = filter_name or scenario.filter.density
    doppler = doppler and pipeline.uses_doppler(scenario, filter_name)
    history = ahead.sooner([filter_name], pipeline.slam, scenario, detections, filter_name, doppler, seed)
    variant = variant_name(filter_name, doppler)
    records = {_group("slam", variant): history, _group("walls", variant): walls_of(scenario, history)}
    dataset.write_records(path, records, scenario.to_toml())
    return variant


def histories(path: Path) -> dict[str, History]:
    """The filter histories a dataset holds, by variant name: in the order of the table of filters, then others."""
    prefix = _group("slam", "")
    stored = [g.removeprefix(prefix) for g in dataset.groups(path) if g.startswith(prefix)]
    names = {variant_name(unquote(o.removesuffix(_ENDING)), not o.endswith(_ENDING)): prefix + o for o in stored}
    known = [variant for name in FILTERS for variant in (name, name + WITHOUT)]
    order = sorted(names, key=lambda v: (known.index(v) if v in known else len(known), v))
    return {name: dataset.read_record(path, names[name], History) for name in order}


def mishaps(path: Path, variant: str) -> tuple[str, str]:
    """Why a filter variant's receiver counts as lost by its own history, and from which steps it was started anew, each
    empty if that is not so."""
    history = dataset.read_record(path, _group("slam", variant), History)
    return history.lost, history.restarted


def after_slam(path: Path) -> str:
    """The command that shows what the filters of a file found: what is compared with the truth, or what goes out without one."""
    have = dataset.groups(path)
    if "track" not in have:
        return f"dopslam view {path}, or dopslam export {path} --to csv --out FOLDER"
    known = "landmarks" in have and _map_known(
        dataset.read_record(path, "landmarks", Landmarks),
        dataset.read_record(path, "paths", Paths) if "paths" in have else None,
    )
    judged_by = any(group.startswith("bound_") for group in have) or not known
    return f"dopslam {'evaluate' if judged_by else 'bound'} {path}"


def bound(path: Path, settings=(), doppler: bool = True) -> None:
    """Add the posterior Cramér–Rao bounds of this run: its track, its detections and their R, the true association.

    Three of them: of what a step can know from the detections up to it, from those up to ``filter.lag`` steps later, and from
    those of the whole run.
    """
    scenario, seed = scenario_of(path, settings, "bound")
    refuse_unwritable(path)
    track, landmarks, paths, _ = read_truth(path)
    detections = blurred(scenario, read_detections(path), seed)
    _refuse_misfits(path, {"track": track, "paths": paths, "detections": detections})
    if not _map_known(landmarks, paths):
        raise DatasetError(
            f"{path}: holds no true map, and without it there is no bound; name the landmarks on import "
            "(source.model.virtual_anchors, scatter_point), or evaluate without"
        )
    for smoothed, lag in ((False, None), (True, scenario.filter.lag), (True, None)):
        bounds = pipeline.bound(scenario, track, landmarks, paths, detections, doppler, smoothed, lag=lag)
        dataset.write_record(path, _bound_group(doppler, smoothed, lag), bounds)


def _map_known(landmarks: Landmarks, paths: Paths | None) -> bool:
    """Whether the truth of a run says more than where the base station is."""
    return paths is not None or bool(np.any(landmarks.kind != Kind.BS))


def bound_name(doppler: bool) -> str:
    """What a bound is called in messages."""
    return "bound" if doppler else "bound, no Doppler"


def evaluate(
    path: Path, settings=(), failed: dict[str, str] | None = None, align: bool = False
) -> tuple[dict, dict[str, Evaluation]]:
    """Summary of every filter variant a dataset holds, and the evaluations behind it.

    With ``failed`` (name → why) a variant that cannot be judged is added to it, and the others are; the summary holds
    it. With ``align`` each is moved rigidly onto the truth first, and no bound is set beside it.
    """
    scenario, seed = scenario_of(path, settings, "evaluate")
    track, landmarks, paths, _ = read_truth(path)
    have = dataset.groups(path)
    found = histories(path)
    if not found:
        raise DatasetError(f"{path}: holds no filter history; run 'dopslam slam {path}' first")
    bounds: dict[str, Bound] = {}
    for name in list(found):
        filter_name, doppler = split_variant(name)
        group = _bound_group(doppler, *pipeline.reads_later(scenario, filter_name))
        if align:
            _refuse_misfits(path, {"track": track, f"slam_{name}": found[name]})
            continue
        if group in have:
            bounds[name] = dataset.read_record(path, group, Bound)
        elif not _map_known(landmarks, paths):
            _refuse_misfits(path, {"track": track, f"slam_{name}": found[name]})
            continue
        elif failed is not None and bound_name(doppler) in failed:
            del found[name]
            continue
        else:
            option = "" if doppler else " --doppler-std none"
            raise DatasetError(f"{path}: holds no {group!r}; run 'dopslam bound {path}{option}' first")
        _refuse_misfits(path, {"track": track, f"slam_{name}": found[name], group: bounds[name]})
    detections = read_detections(path)
    _refuse_misfits(path, {"track": track, "paths": paths, "detections": detections})
    try:
        moved: dict[str, dict[str, float]] = {}
        if align:
            for name, history in found.items():
                found[name], moved[name] = aligned(history, track)
        summary, evaluations = judged(scenario, seed, (track, landmarks, paths), detections, found, bounds, failed)
        for name, how in moved.items():
            if name in summary["variants"]:
                summary["variants"][name]["aligned"] = how
            if name == summary["filter"]:
                summary["aligned"] = how
        return summary, evaluations
    except DopslamError as error:
        raise DatasetError(f"{path}: {error}") from error


def report(path: Path, target: Path, summary: dict, evaluations: dict[str, Evaluation], align: bool = False) -> None:
    """Write ``summary.json``, ``table.txt``, ``errors.csv`` (per step), ``report.html`` and the figures of an evaluated
    dataset into a folder, made if missing."""
    Path(target).mkdir(parents=True, exist_ok=True)
    scenario, _ = scenario_of(path)
    truth, found = read_truth(path), histories(path)
    track, landmarks, paths, plan = truth
    if align:
        found = {name: aligned(history, track)[0] for name, history in found.items()}
    mesh = dataset.read_record(path, "mesh", Mesh).triangles if "mesh" in dataset.groups(path) else None
    shown = replay.replay(
        *truth,
        found,
        mesh,
        scenario.receiver.height,
        scenario.filter.report_existence,
        scenario.evaluation.found_radius,
    )
    main = summary["filter"]
    with figures.house_style():
        drawn = {
            "plan": figures.plan_view(plan, track, landmarks, paths, found[main], track.steps // 8),
            "errors": figures.errors_over_time(evaluations[main]),
            "gospa": figures.gospa_over_time(evaluations[main]),
        }
        if paths is not None:
            drawn["detections"] = figures.detections_over_paths(track, landmarks, paths, read_detections(path))
        figures.save_all(target, drawn)
        text = page.report_page(
            summary | {"versions": folder.versions()}, tables.cells(summary), drawn, shown,
            scenario.to_toml(),
        )  # fmt: skip
    folder.write_text(Path(target) / "report.html", text)
    folder.write_text(Path(target) / "errors.csv", tables.steps_csv(track.time, evaluations))
    (Path(target) / "table.txt").write_text(tables.as_text(tables.run_table(summary)), encoding="utf-8")
    folder.write_json(Path(target) / "summary.json", summary | {"versions": folder.versions()})
