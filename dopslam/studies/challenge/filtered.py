"""Answers of filters to a suite."""

from __future__ import annotations

import csv
import io
import os
from pathlib import Path

from dopslam.config.scenario import parse
from dopslam.errors import DopslamError
from dopslam.pipeline import ahead
from dopslam.pipeline import stages as pipeline
from dopslam.pipeline.stages import Progress, quiet
from dopslam.records import DetectionSeries
from dopslam.store import file as dataset
from dopslam.studies.challenge.answer import header, of_history, to_rows
from dopslam.studies.challenge.score import chosen, verify


def reason(error: Exception) -> str:
    """Why a case has no answer; the others have theirs, unless somebody looks for the fault (``DOPSLAM_DEBUG``)."""
    if os.environ.get("DOPSLAM_DEBUG"):
        raise error
    return str(error) if isinstance(error, DopslamError) else f"{type(error).__name__}: {error}"


def answers(suite: Path, name: str, split: str | None = None, progress: Progress = quiet) -> tuple[str, dict[str, str]]:
    """The answer of a filter as the text of a table, and the cases in which it failed, with the reason.

    Parameters
    ----------
    suite : folder
    name : of :data:`dopslam.filters.FILTERS`, or ``file.py:Class``
    split : the only one that is wanted
    """
    cases = chosen(suite, split)
    verify(suite, None, cases)
    out, failed = io.StringIO(), {}
    lines = csv.writer(out, lineterminator="\n")
    lines.writerow(header())
    with ahead.compiling([name]) as compiler:
        for done, case in enumerate(cases):
            progress(name.rpartition(":")[2], done, len(cases))
            path = Path(suite) / case["split"] / f"{case['name']}.h5"
            text, seed = dataset.read_root(path)
            scenario, detections = (
                parse(text, source=str(path)),
                dataset.read_record(path, "detections", DetectionSeries),
            )
            assert detections.time is not None
            try:
                history = ahead.sooner([name], pipeline.slam, scenario, detections, name, True, seed)
            except Exception as error:
                failed[case["name"]] = reason(error)
                continue
            found = of_history(detections.time, history, scenario.filter.report_existence)
            lines.writerows(to_rows(case["name"], found))
        if ahead.missing([name]):
            ahead.go_on(compiler)
    progress(name.rpartition(":")[2], len(cases), len(cases))
    return out.getvalue(), failed
