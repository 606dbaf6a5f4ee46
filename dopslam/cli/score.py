"""``dopslam score``."""

from __future__ import annotations

from pathlib import Path


def score(
    answer: Path,
    *,
    suite: Path = Path("suite"),
    truth: Path | None = None,
    name: str | None = None,
    json: Path | None = None,
) -> None:
    """Score an answer to a suite beside the truth and the bound.

    Parameters
    ----------
    answer
        Table (.csv; columns case, what, time_s, x_m, y_m, z_m, heading_rad, bias_m, cov_11 …; or of detections, case, step,
        delay_s …; see docs/benchmark.md), dataset file (.h5) of a case with one filter's history, or folder of such files.
    suite
        Folder made by 'dopslam benchmark make'.
    truth
        Its truth; default <suite>-truth.
    name
        Name of the method; default that of the file.
    json
        Write all figures, those of single cases included, to this file (scripts/board.py makes a page of several).
    """
    from rich.console import Console

    from dopslam.report.folder import write_json
    from dopslam.store.place import refuse_no_file
    from dopslam.studies.challenge import board, detected
    from dopslam.studies.challenge.score import score as judge

    refuse_no_file(json)
    apart = suite.with_name(f"{suite.name}-truth") if truth is None else truth
    found = answer.suffix == ".csv" and detected.is_detections(answer)
    result = (detected.score if found else judge)(answer, suite, apart, name)
    console = Console(markup=False)
    console.print((detected.table if found else board.table)(result))
    if json is not None:
        write_json(json, result)
        console.print(f"written: {json}", highlight=False, soft_wrap=True)
