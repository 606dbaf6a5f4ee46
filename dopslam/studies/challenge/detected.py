"""Scoring detections that somebody estimated from the signals of a suite: accuracy beside the Cramér–Rao bound, what was found
of the paths, what was invented, and the time it took."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from rich.table import Table

from dopslam.config.scenario import parse
from dopslam.errors import DatasetError
from dopslam.evaluate.detections import snapshot
from dopslam.pipeline import link
from dopslam.records import DetectionSeries, Paths, Track, edges_of
from dopslam.store import file as dataset
from dopslam.studies.challenge import make
from dopslam.studies.challenge.board import Rows, board_of, table_of
from dopslam.studies.challenge.make import SIGNAL
from dopslam.studies.challenge.score import manifest_of, verify
from dopslam.studies.challenge.signals import header
from estimation import PARAMETERS, statistics
from estimation.evaluate import Match, associate, summarize

TRACK = "signal to detections"
STRONG_DB = 17.0  # ρ from which a path is one that has to be found
ACCURATE_FROM = 10**1.8  # ρ, linear, from which errors are compared with the bound
NORMAL_MEDIAN = 0.6744897501960817  # of the magnitude of a standard normal variable
UNTOLD = 1e-24  # covariance, over what is usual, where none is told


def is_detections(path: Path) -> bool:
    """Whether an answer is a table of detections, by its header."""
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            return {"case", "step", *make.QUANTITIES} <= set(next(csv.reader(file), []))
    except (OSError, UnicodeDecodeError, csv.Error):
        return False


def score(path: Path, suite: Path, truth: Path, name: str | None = None) -> dict:
    """Figures of a table of detections, by split.

    Raises
    ------
    DatasetError
        For a table that is no answer, naming the row, or files that are not the suite's.
    """
    cases = [case for case in manifest_of(suite)["cases"] if "signal" in case]
    answers = _read(path, {case["name"] for case in cases})
    answered = [case for case in cases if case["name"] in answers]
    verify(suite, truth, [case["signal"] for case in answered])
    matches: dict[str, list[Match]] = {}
    told, seconds = True, {}
    for case in answered:
        rows = answers[case["name"]]
        matches[case["name"]] = _matches(path, Path(truth) / f"{case['name']}{SIGNAL}.h5", case["name"], rows)
        told = told and bool(np.isfinite(rows["covariance"]).all())
        seconds[case["name"]] = float(np.nanmedian(rows["seconds"])) if np.isfinite(rows["seconds"]).any() else None
    splits = dict.fromkeys(case["split"] for case in cases)
    return {
        "method": name or Path(path).stem,
        "track": TRACK,
        "suite_sha256": make.sha256(Path(suite) / make.MANIFEST),
        "splits": {
            split: {"cases": sum(c["split"] == split for c in cases)}
            | _figures({c["name"]: matches[c["name"]] for c in answered if c["split"] == split}, told, seconds)
            for split in splits
        },
    }


def _figures(matches: dict[str, list[Match]], told: bool, seconds: dict[str, float | None]) -> dict:
    pooled = [match for found in matches.values() for match in found]
    if not pooled:
        return {"answered": 0}
    known = [match for match in pooled if match.error.shape[1] == len(PARAMETERS)]
    summary = summarize(known, ACCURATE_FROM) if known else None
    rho = np.concatenate([m.rho for m in pooled])
    strong = rho >= 10 ** (STRONG_DB / 10)
    detected = np.concatenate([m.detected for m in pooled])[strong]
    times = [taken for name in matches if (taken := seconds[name]) is not None]
    accurate = summary is not None and summary.associations > 0
    return {
        "answered": len(matches),
        "snapshots": len(pooled),
        "rmse_over_crb": {
            parameter: {"value": float(value), "low": float(low), "high": float(high)}
            for parameter, value, (low, high) in zip(
                PARAMETERS, summary.rmse_over_crb, summary.rmse_interval, strict=True
            )
        } if accurate and summary is not None else None,
        "median_over_crb": _typical(known),
        "gross": summary.gross / summary.associations if accurate and summary is not None else None,
        "nees_over_6": summary.nees_over_n if accurate and told and summary is not None else None,
        "found": statistics.share(int(detected.sum()), len(detected)) if len(detected) else None,
        "strong_paths": len(detected),
        "false_per_snapshot": float(np.mean([m.false for m in pooled])),
        "seconds_per_snapshot": float(np.median(times)) if times else None,
    }  # fmt: skip


def _typical(matches: list[Match]) -> dict[str, float] | None:
    """Median error of each quantity over that of the bound, which few gross errors do not move."""
    if not matches:
        return None
    keep = [m.rho[m.truth] > ACCURATE_FROM for m in matches]
    error = np.concatenate([m.error[k] for m, k in zip(matches, keep, strict=True)])
    bound = np.concatenate([m.bound[k] for m, k in zip(matches, keep, strict=True)])
    if not len(error):
        return None
    ratio = np.median(np.abs(error) / np.sqrt(np.einsum("nii->ni", bound)), axis=0) / NORMAL_MEDIAN
    return dict(zip(PARAMETERS, ratio.tolist(), strict=True))


def _matches(path: Path, file: Path, name: str, rows: dict[str, np.ndarray]) -> list[Match]:
    text, _ = dataset.read_root(file)
    scenario = parse(text, source=str(file))
    track, paths = dataset.read_record(file, "track", Track), dataset.read_record(file, "paths", Paths)
    model, noise = link.signal_model(scenario), link.noise_variance(scenario)
    step = rows["step"] - 1
    if np.any((step < 0) | (step >= track.steps)):
        raise DatasetError(f"{path}: {name} has steps outside 1 to {track.steps}, as its signal has them")
    order = np.argsort(step, kind="stable")
    z, covariance = rows["z"][order], rows["covariance"][order]
    spread = np.array([1e-9, 1e-2, 1e-2, 1e-2, 1e-2, 0.1])
    covariance = np.where(np.isnan(covariance), UNTOLD * np.diag(spread**2), covariance)
    series = DetectionSeries(
        offsets=edges_of(np.bincount(step, minlength=track.steps)),
        delay=z[:, 0], aoa=z[:, 1:3], aod=z[:, 3:5], radial_velocity=z[:, 5],
        gain=np.ones(len(z), complex), covariance=covariance, snr=np.ones(len(z)),
        noise_variance=np.full(track.steps, noise), threshold=1.0, false_alarm_rate=1.0, search_volume=1.0,
    )  # fmt: skip
    tables = (link.path_table(scenario, track, paths, k) for k in range(track.steps))
    return [associate(model, snapshot(model, series, k), table, noise) for k, table in enumerate(tables)]


def _read(path: Path, names: set[str]) -> dict[str, dict[str, np.ndarray]]:
    """Columns by case: step (N,), z (N, 6), covariance (N, 6, 6) with NaN where it is not told, seconds (N,)."""
    with open(path, encoding="utf-8-sig", newline="") as file:
        rows = list(csv.DictReader(file))
    by_case: dict[str, list[dict[str, float]]] = {}
    optional = set(header()) - {"case", "step", "time_s", "rho", *make.QUANTITIES}
    for line, row in enumerate(rows, start=2):
        if row["case"] not in names:
            raise DatasetError(f"{path}, line {line}: {row['case']!r} is no case with a signal; see suite.json")
        numbers = {column: _number(path, line, row, column, column in optional) for column in header()[1:]}
        by_case.setdefault(row["case"], []).append(numbers)
    found = {}
    for case, lines in by_case.items():
        column = {key: np.array([numbers[key] for numbers in lines]) for key in header()[1:]}
        covariance = np.empty((len(lines), 6, 6))
        for i, j in make.PAIRS:
            covariance[:, i, j] = covariance[:, j, i] = column[f"cov_{i + 1}{j + 1}"]
        found[case] = {
            "step": column["step"].astype(np.int64), "z": np.column_stack([column[n] for n in make.QUANTITIES]),
            "covariance": covariance, "seconds": column["seconds"],
        }  # fmt: skip
    return found


def _number(path: Path, line: int, row: dict, column: str, optional: bool) -> float:
    text = (row.get(column) or "").strip()
    if column in ("time_s", "rho") or (optional and text.lower() in ("", "nan")):
        return np.nan
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value) or (column == "step" and value != round(value)):
        raise DatasetError(f"{path}, line {line}: {column} is {text!r}; a finite number is needed (steps count from 1)")
    return value


def _rows() -> Rows:
    def ratio(parameter: str):
        def cell(split: dict) -> str:
            found, usual = split["rmse_over_crb"], split["median_over_crb"]
            return f"{found[parameter]['value']:.2f} ({usual[parameter]:.2f})" if found else "–"

        return cell

    def plain(key: str, digits: int):
        def cell(split: dict) -> str:
            return "–" if split[key] is None else f"{split[key]:.{digits}f}"

        return cell

    def found(split: dict) -> str:
        return "–" if split["found"] is None else f"{split['found']['value']:.0%} of {split['strong_paths']}"

    return [
        ("answered", lambda split: f"{split['answered']} of {split['cases']}"),
        ("snapshots", lambda split: str(split["snapshots"])),
        *((f"{parameter} /√CRB", ratio(parameter)) for parameter in PARAMETERS),
        ("gross", lambda split: "–" if split["gross"] is None else f"{split['gross']:.0%}"),
        ("NEES/6", plain("nees_over_6", 2)),
        (f"found, ρ ≥ {STRONG_DB:g} dB", found),
        ("false a snapshot", plain("false_per_snapshot", 2)),
        ("s a snapshot", plain("seconds_per_snapshot", 3)),
    ]


def table(result: dict) -> Table:
    """One answer: a column for every split."""
    caption = (
        "RMSE over the root of the Cramér–Rao bound where ρ > 18 dB (in brackets the median error over the bound's); "
        "gross: beyond six times the bound."
    )
    return table_of(result, _rows(), caption)


def board(results: list[dict]) -> str:
    """Tables of all answers in Markdown, a table for every split, the most paths found first.

    Raises
    ------
    DatasetError
        If the answers are not to the same suite.
    """
    return board_of(results, _rows(), lambda split: -(split["found"] or {"value": 0.0})["value"])
