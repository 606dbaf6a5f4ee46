"""Generated scenes from signal to map, nothing tuned: which pass, and what fails first where one does not.

Every scene is a folder ``<kind>-<seed>`` with its dataset (track, paths, detections) and ``result.json``; what is there is
not made again. Judging once more from stored detections takes seconds.
"""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np

from dopslam.config.scenario import Scenario, parse
from dopslam.errors import DopslamError
from dopslam.evaluate import detections as matching
from dopslam.evaluate import mapping
from dopslam.evaluate.run import evaluate_run, summarize
from dopslam.pipeline import file as stages
from dopslam.pipeline import stages as pipeline
from dopslam.pipeline.judge import largest_order, match_series
from dopslam.records import Kind
from dopslam.report.folder import write_json
from dopslam.store import file as dataset

LARGEST_RATIO = 1.5  # of RMSE to PEB
LARGEST_NEES = 8.0
LEAST_SHARE = 0.8  # of the visible landmarks, in the final map
WRONG_DETECTIONS = 1.5  # NEES over 6 of the detections, and
OUTLIERS = 0.05  # share of the detections beyond the 99.9 % point of χ²₆, from which they are named as the cause
CHI2_6 = 22.46
FALSE_DETECTIONS = 0.15  # per snapshot, likewise
JUDGED = ("filter", "belief", "evaluation")  # tables of a scenario that the stored detections do not depend on


def scenario_of(kind: str, seed: int, settings=()) -> Scenario:
    """The scenario that a generator makes of a seed."""
    return parse(f'[scene]\ngenerator = "{kind}"\nseed = {seed}\n', settings, source=f"{kind} {seed}")


def run(kind: str, seed: int, folder: Path, settings=(), density: str = "joint", replay: bool = False) -> dict:
    """One scene: its figures, or why there are none.

    Parameters
    ----------
    kind, seed : of the generator
    folder : of the study
    settings : ``key.path=value`` overrides
    density : the filter that is judged, with Doppler unless it is ``"bp"``
    replay : filter and judge again, from the detections that are there
    """
    place = Path(folder) / f"{kind}-{seed}"
    place.mkdir(parents=True, exist_ok=True)
    stored = place / f"result-{density}.json"
    key = {"kind": kind, "seed": seed, "settings": list(settings), "density": density}
    if stored.exists() and not replay:
        kept = json.loads(stored.read_text(encoding="utf-8"))
        if all(kept.get(name) == value for name, value in key.items()):
            return kept
    start, stage = time.perf_counter(), "generate"
    result: dict = dict(key)
    try:
        scenario = scenario_of(kind, seed, settings)
        stage = "trace"
        data = place / "dataset.h5"
        if not _same(data, scenario, seed):
            data.unlink(missing_ok=True)
            stages.trace(data, scenario, seed)
            stage = "estimate"
            stages.estimate(data)
            result["seconds_estimate"] = time.perf_counter() - start
        stage, start = "slam", time.perf_counter()
        result |= judged(scenario, seed, data, density)
        result["seconds_slam"] = time.perf_counter() - start
    except Exception as error:
        result["error"] = f"{type(error).__name__ if not isinstance(error, DopslamError) else ''} {error}".strip()
        result["stage"] = stage
    result["failures"], result["cause"] = verdict(result)
    write_json(stored, result)
    return result


def _same(data: Path, scenario: Scenario, seed: int) -> bool:
    """Whether a dataset holds the detections of this scenario, whatever its filter's settings."""
    if not data.exists() or "detections" not in dataset.groups(data):
        return False
    text, stored = dataset.read_root(data)
    trees = [s.model_dump(mode="json", exclude=set(JUDGED)) for s in (scenario, parse(text))]
    return stored == seed and trees[0] == trees[1]


def judged(scenario: Scenario, seed: int, data: Path, density: str) -> dict:
    """Filter the stored detections and judge track, map and detections."""
    track, landmarks, paths, _ = stages.read_truth(data)
    detections = stages.read_detections(data)
    assert paths is not None
    doppler = pipeline.uses_doppler(scenario, density)
    history = pipeline.slam(scenario, detections, density, doppler, seed)
    smoothed, lag = pipeline.reads_later(scenario, density)
    bound = pipeline.bound(scenario, track, landmarks, paths, detections, doppler, smoothed, lag=lag)
    order = largest_order(density, landmarks)
    evaluation = evaluate_run(scenario, track, landmarks, history, bound, order)
    matches = match_series(scenario, track, paths, detections)
    seen = mapping.steps_seen(matches, paths, landmarks, detections.threshold)
    fate = mapping.fate(landmarks, history, scenario.filter.report_existence, *seen)
    squared = np.concatenate([m.nees for m in matches])
    figures = summarize(evaluation, landmarks, scenario.evaluation.found_radius) | fate.figures(landmarks)
    return figures | {
        "steps": track.steps,
        "depth": scenario.trace.max_depth,
        "carrier_ghz": scenario.radio.carrier_frequency / 1e9,
        "arrays": f"{scenario.base_station.array.kind}, {scenario.receiver.array.kind}",
        "detections": matching.figures(matches),
        "detection_outliers": float(np.mean(squared > CHI2_6)) if len(squared) else 0.0,
        "lost": _lost(landmarks, fate),
        "false_near": _false_near(landmarks, fate),
    }


def _lost(landmarks, fate: mapping.Fate) -> dict[str, int]:
    """Visible landmarks that the final map lacks, by what happened to them."""
    missing = (landmarks.kind != Kind.BS) & (landmarks.order <= 1) & (fate.visible >= mapping.STEPS) & ~fate.found
    rarely = fate.detected < mapping.STEPS
    return {
        "forgotten": int((missing & fate.ever).sum()),
        "not resolved": int((missing & ~fate.ever & rarely).sum()),
        "never mapped": int((missing & ~fate.ever & ~rarely).sum()),
    }


def _false_near(landmarks, fate: mapping.Fate) -> dict[str, int]:
    """False entries of the final map by what they lie near: a landmark (a duplicate, or off by more than 3 σ) or none."""
    away = np.linalg.norm(fate.false[:, None] - landmarks.position[None], axis=-1).min(axis=1, initial=np.inf)
    return {"duplicate or off": int((away < 3.0).sum()), "nothing": int((away >= 3.0).sum())}


def verdict(result: dict) -> tuple[list[str], str]:
    """The criteria that a scene fails, and the first thing along the pipeline that went wrong.

    Returns
    -------
    (criteria, cause), empty where all are met
    """
    if "error" in result:
        return ["no result"], f"{result['stage']}: {result['error']}"[:160]
    failures = []
    ratio, visible = result["rmse_over_bound"]["position"], result["landmarks_visible"]
    if not ratio <= LARGEST_RATIO:
        failures.append("track")
    if not result["nees"] <= LARGEST_NEES:
        failures.append("NEES")
    if result["landmarks_found"] < LEAST_SHARE * visible:
        failures.append("landmarks")
    if result["false_landmarks"] > max(1, 0.1 * visible):
        failures.append("false landmarks")
    return failures, _cause(result) if failures else ""


def _cause(result: dict) -> str:
    detections, lost = result["detections"], result["lost"]
    wrong = (detections["nees_over_6"] or 0.0) > WRONG_DETECTIONS and result["detection_outliers"] > OUTLIERS
    if wrong:
        share = result["detection_outliers"]
        return f"covariances of detections too small (NEES/6 {detections['nees_over_6']:.3g}, {share:.0%} outliers)"
    if detections["false_per_snapshot"] > FALSE_DETECTIONS:
        return f"false detections ({detections['false_per_snapshot']:.2f} a snapshot)"
    if result["diverged"]:
        return "track lost with sound detections"
    if max(lost.values()) and result["landmarks_found"] < LEAST_SHARE * result["landmarks_visible"]:
        most = max(lost, key=lambda name: lost[name])
        return f"landmarks {most} ({', '.join(f'{n} {name}' for name, n in lost.items() if n)})"
    if result["false_landmarks"] > max(1, 0.1 * result["landmarks_visible"]):
        return "false landmarks with sound detections"
    return "filter overconfident with sound detections"
