"""Scoring an answer to a suite: every case beside its truth and its bound, then means over the cases of each split.

A landmark counts, in all figures of the map, if it was detected at least ``LEAST`` times in the case and comes of at most one
reflection; it is found if an
entry of its kind lies within 1 m (one entry for one landmark). Entries that no landmark explains are false.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from dopslam.config.scenario import parse
from dopslam.errors import DatasetError
from dopslam.evaluate import community
from dopslam.evaluate.bounds import Bound
from dopslam.evaluate.run import Evaluation, evaluate_run, landmark_errors
from dopslam.evaluate.walls import wall_figures, walls
from dopslam.records import Kind, Landmarks, Track
from dopslam.store import file as dataset
from dopslam.studies.challenge.answer import Answer, read
from dopslam.studies.challenge.make import FORMAT, MANIFEST, SIGNAL, sha256
from estimation import statistics

LEAST = 3  # detections
NEAR = 1.0  # m
SAME_TIME = 1e-3  # of a period

FIGURES = {  # key → (title, digits) of what a split is summarized by
    "position_rmse_m": ("position m", 4), "position_over_bound": ("× bound", 2), "heading_rmse_deg": ("heading °", 3),
    "clock_bias_rmse_m": ("clock m", 4), "nees": ("NEES", 1), "rpe_m": ("RPE m", 4), "gospa_va_m": ("GOSPA VA m", 2),
    "gospa_sp_m": ("GOSPA SP m", 2), "wall_distance_m": ("walls m", 4),
}  # fmt: skip


def manifest_of(suite: Path) -> dict:
    """The manifest of a suite.

    Raises
    ------
    DatasetError
        If the folder is no suite of this format.
    """
    path = Path(suite) / MANIFEST
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
        form = tree["format"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DatasetError(f"{suite}: no suite ({MANIFEST}: {error}); 'dopslam benchmark make' makes one") from error
    if form != FORMAT:
        raise DatasetError(f"{suite}: a suite of format {form}, this program reads {FORMAT}; make it anew")
    return tree


def chosen(suite: Path, split: str | None) -> list[dict]:
    """The cases of a split, or of both.

    Raises
    ------
    DatasetError
        If the suite has no such split.
    """
    everything = manifest_of(suite)["cases"]
    cases = [c for c in everything if split in (None, c["split"])]
    if not cases:
        raise DatasetError(
            f"{suite}: has no split {split!r}; it has {', '.join(sorted({c['split'] for c in everything}))}"
        )
    return cases


def _with_signals(cases: Sequence[dict]) -> list[dict]:
    """The cases, and those that begin at the signal as cases of their own, with the truth of their sisters."""
    return [
        *cases,
        *(
            case | {"name": f"{case['name']}{SIGNAL}", "content": "", "truth": case["truth"] | case["signal"]["truth"]}
            for case in cases
            if "signal" in case
        ),
    ]


def verify(suite: Path, truth: Path | None, cases: Sequence[dict]) -> None:
    """Refuse files that are missing or not those of the manifest; with ``truth`` the truth's, else the participant's."""
    for case in cases:
        for name, stated in (case["files"] if truth is None else case["truth"]).items():
            path = Path(suite if truth is None else truth) / name
            if not path.is_file():
                raise DatasetError(f"{path}: is missing; the folder is not whole, or not that of {suite}")
            if sha256(path) != stated:
                raise DatasetError(f"{path}: is not the file that {MANIFEST} lists (its checksum differs); get it anew")


def score(answer: Path, suite: Path, truth: Path, name: str | None = None) -> dict:
    """Figures of an answer, by case and by split.

    Parameters
    ----------
    answer : table, dataset file or folder of dataset files (:mod:`dopslam.studies.challenge.answer`)
    suite, truth : folders that :func:`dopslam.studies.challenge.make.make` made
    name : of the method; default that of the file
    """
    manifest = manifest_of(suite)
    cases = _with_signals(manifest["cases"])
    answers = read(Path(answer), cases, Path(suite))
    answered = [case for case in cases if case["name"] in answers]
    begun = {case["name"].endswith(SIGNAL) for case in answered}
    if len(begun) > 1:
        raise DatasetError(f"{answer}: mixes cases of detections and of signals (…{SIGNAL}); give one file for each")
    cases = [case for case in cases if case["name"].endswith(SIGNAL) in begun or not begun]
    verify(suite, truth, answered)
    judged = {
        case["name"]: {"split": case["split"], "level": case["level"], "kind": case["kind"]}
        | _judged(Path(answer), Path(truth), case["name"], answers[case["name"]])
        for case in answered
    }
    splits = dict.fromkeys(case["split"] for case in cases)
    return {
        "method": name or Path(answer).stem,
        "track": "signal to map" if begun == {True} else "detections to map",
        "suite_sha256": sha256(Path(suite) / MANIFEST),
        "splits": {
            split: _summary(
                [f for f in judged.values() if f["split"] == split], sum(c["split"] == split for c in cases)
            )
            for split in splits
        },
        "cases": judged,
    }


def _judged(path: Path, truth: Path, name: str, answer: Answer) -> dict:
    file = truth / f"{name.removesuffix(SIGNAL)}.h5"
    text, _ = dataset.read_root(file)
    scenario = parse(text, source=str(file))
    track, landmarks = dataset.read_record(file, "track", Track), dataset.read_record(file, "landmarks", Landmarks)
    bound = dataset.read_record(file, "bound_doppler", Bound)
    _refuse_other_times(path, name, answer, track, scenario.track.period)
    detected = np.array(json.loads(dataset.root_attributes(file)["detected"]))
    history, evaluated = answer.history(), scenario.evaluation
    counted = _part(landmarks, (landmarks.kind == Kind.BS) | ((landmarks.order <= 1) & (detected >= LEAST)))
    evaluation = evaluate_run(scenario, track, counted, history, bound)
    entries = community.figures(track, counted, history, 0.5, evaluated.gospa_cutoff, evaluated.gospa_order)
    explained = landmark_errors(landmarks, history, 0.5) <= NEAR
    bs = landmarks.position[landmarks.kind == Kind.BS][0]
    return _errors(evaluation, answer) | {
        "landmarks_counted": len(counted) - 1,
        "landmarks_found": int(np.sum(evaluation.found <= NEAR)) - 1,
        "landmarks_false": len(answer.kind) - (int(explained.sum()) - 1),
        **{k: entries[k] for k in ("ate_m", "rpe_m", "rpe_deg", "ospa_va_m", "ospa_sp_m")},
        **wall_figures(walls(history, bs, scenario.receiver.height), counted, NEAR),
    }


def _part(landmarks: Landmarks, chosen: np.ndarray) -> Landmarks:
    return Landmarks(*(getattr(landmarks, f.name)[chosen] for f in fields(landmarks)))


def _errors(evaluation: Evaluation, answer: Answer) -> dict:
    def rms(values) -> float:
        return float(np.sqrt(np.mean(np.square(values))))

    told = bool(np.isfinite(answer.covariance).all())
    astray = not evaluation.position_error[-1] <= max(10.0, 30.0 * float(evaluation.peb[-1]))
    return {
        "lost": bool(evaluation.diverged if told else astray),
        "position_rmse_m": rms(evaluation.position_error),
        "position_over_bound": evaluation.rmse_over_bound["position"],
        "heading_rmse_deg": float(np.degrees(rms(evaluation.heading_error))),
        "clock_bias_rmse_m": rms(evaluation.bias_error),
        "nees": float(np.mean(evaluation.nees)) if told else None,
        "gospa_va_m": float(evaluation.gospa_va[-1]),
        "gospa_sp_m": float(evaluation.gospa_sp[-1]),
    }


def _refuse_other_times(path: Path, name: str, answer: Answer, track: Track, period: float) -> None:
    if len(answer.time) != track.steps:
        raise DatasetError(
            f"{path}: {name} has {len(answer.time)} states for {track.steps} snapshots; answer every one, once"
        )
    away = np.abs(answer.time - track.time)
    if away.max() > SAME_TIME * period:
        row = int(np.argmax(away))
        raise DatasetError(
            f"{path}: {name} has a state at {answer.time[row]:g} s, the snapshot is at {track.time[row]:g} s; "
            "take time_s from the case's file"
        )


def _summary(cases: list[dict], of: int) -> dict:
    """Medians over the cases with their intervals (one case that is lost says nothing of the others), shares pooled."""
    summary: dict = {"cases": of, "answered": len(cases), "lost": sum(c["lost"] for c in cases)}
    for key in FIGURES:
        values = [c[key] for c in cases if c[key] is not None]
        summary[key] = statistics.median(values) if values else None
    counted = sum(c["landmarks_counted"] for c in cases)
    summary["landmarks_found"] = (
        statistics.share(sum(c["landmarks_found"] for c in cases), counted) if counted else None
    )
    summary["landmarks_counted"] = counted
    summary["landmarks_false_per_case"] = float(np.mean([c["landmarks_false"] for c in cases])) if cases else None
    return summary
