"""Signals of a suite, and the answers of estimators to them: detections, and the maps that filters make of those.

The first drive through every scene has its received signal beside its detections, at the level ``sharp``: ``NAME.signal.h5`` with
``signal/y`` (snapshots, subcarriers, symbols, receive elements) and the scenario that says what the link is. The truth of
the same name holds the traced paths. An answer of an estimator is a table of detections (:func:`header`); a map that was made
of the signal is answered like any other, for the case ``NAME.signal``.
"""

from __future__ import annotations

import csv
import io
import time
from pathlib import Path

import numpy as np

from dopslam.config.scenario import override, parse
from dopslam.errors import DatasetError
from dopslam.pipeline import ahead
from dopslam.pipeline import stages as pipeline
from dopslam.pipeline.signals import StoredSignal
from dopslam.pipeline.stages import Progress, quiet
from dopslam.records import DetectionSeries
from dopslam.store import file as dataset
from dopslam.studies.challenge import answer, make
from dopslam.studies.challenge.filtered import reason
from dopslam.studies.challenge.make import SIGNAL
from dopslam.studies.challenge.score import chosen, verify


def header() -> list[str]:
    """Columns of a table of detections."""
    names = [f"cov_{i + 1}{j + 1}" for i, j in make.PAIRS]
    return ["case", "step", "time_s", *make.QUANTITIES, "rho", *names, "seconds"]


class _Timed:
    """A stored signal that notes when its snapshots are asked for."""

    def __init__(self, stored: StoredSignal):
        self.steps, self.time = stored.steps, stored.time
        self.stored, self.asked = stored, []

    def snapshot(self, step: int) -> np.ndarray:
        self.asked.append(time.perf_counter())
        return self.stored.snapshot(step)


def estimated(
    suite: Path, estimator: str, split: str | None = None, filters: tuple[str, ...] = (), progress: Progress = quiet
) -> tuple[str, dict[str, str], dict[str, str]]:
    """The detections of an estimator as the text of a table, for every filter the map it makes of them likewise, and what
    failed (case, or case and filter) with the reason.

    Parameters
    ----------
    suite : folder
    estimator : of :data:`estimation.estimators.ESTIMATORS`, or ``file.py:Class``
    split : the only one that is wanted
    filters : of :data:`dopslam.filters.FILTERS`, or ``file.py:Class``

    Raises
    ------
    DatasetError
        If the suite has no signals.
    """
    cases = [case for case in chosen(suite, split) if "signal" in case]
    if not cases:
        raise DatasetError(f"{suite}: holds no signals; 'dopslam benchmark make --signal' makes a suite that does")
    verify(suite, None, [case["signal"] for case in cases])
    verify(suite, None, cases)  # times are those of the detections
    out, failed = io.StringIO(), {}
    lines = csv.writer(out, lineterminator="\n")
    lines.writerow(header())
    maps = {name: [answer.header()] for name in filters}
    with ahead.compiling(filters) as compiler:
        for done, case in enumerate(cases):
            progress(estimator.rpartition(":")[2], done, len(cases))
            base = Path(suite) / case["split"]
            path = base / f"{case['name']}{SIGNAL}.h5"
            text, seed = dataset.read_root(path)
            stamps = dataset.read_record(base / f"{case['name']}.h5", "detections", DetectionSeries).time
            scenario = override(parse(text, source=str(path)), [f"estimator.kind={estimator!r}"])
            timed = _Timed(StoredSignal(path, dataset.signal_steps(path), stamps))
            try:
                series = pipeline.estimate(scenario, timed)
            except Exception as error:
                failed[case["name"]] = reason(error)
                continue
            # The first snapshot waits for what is compiled or tabulated once.
            seconds = np.diff([*timed.asked, time.perf_counter()])
            usual = float(np.median(seconds[1:] if len(seconds) > 1 else seconds))
            rows = list(csv.reader(io.StringIO(make.detections_csv(series))))[1:]
            lines.writerows([case["name"], *row, f"{usual:.6g}"] for row in rows)
            for name in filters:
                try:
                    history = ahead.sooner([name], pipeline.slam, scenario, series, name, True, seed)
                except Exception as error:
                    failed[f"{case['name']}, {name}"] = reason(error)
                    continue
                assert series.time is not None
                found = answer.of_history(series.time, history, scenario.filter.report_existence)
                maps[name] += answer.to_rows(f"{case['name']}{SIGNAL}", found)
        if ahead.missing(filters):
            ahead.go_on(compiler)
    progress(estimator.rpartition(":")[2], len(cases), len(cases))
    return out.getvalue(), {name: _text(rows) for name, rows in maps.items()}, failed


def _text(rows: list[list[str]]) -> str:
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue()
