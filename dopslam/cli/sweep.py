"""``dopslam sweep``."""

from __future__ import annotations

from pathlib import Path

from dopslam.cli.common import worker_count


def sweep(plan: Path, *, out: Path, jobs: int | None = None, cluster: str | None = None) -> None:
    """Repeat a Monte Carlo study for every combination of values of scenario keys: one table, one figure with error
    bars.

    Parameters
    ----------
    plan
        TOML with scenario, runs, seed and the table [vary]; see the documentation of dopslam.studies.sweep.
    out
        Folder to make: table.csv, sweep.json, sweep.png.
    jobs
        Worker processes; by default one for each core. Results do not depend on it.
    cluster
        Address of a Dask scheduler (tcp://host:8786) whose workers run the study instead; needs the extra [cluster].
    """
    from rich.console import Console
    from rich.table import Table

    from dopslam.cli.bars import timed_bars
    from dopslam.compute.cluster import workers
    from dopslam.errors import DatasetError
    from dopslam.report.folder import write_json, write_text
    from dopslam.studies import sweep as library

    study = library.read_sweep(plan)
    if out.exists():
        raise DatasetError(f"{out}: exists already; remove it or name another folder with --out")
    try:
        out.mkdir(parents=True)
    except OSError as error:
        raise DatasetError(f"{out}: cannot be made ({error.strerror}); give another folder") from error

    def write(rows: list) -> None:
        header, body = library.table(rows)
        lines = (",".join(f'"{c}"' if "," in c else c for c in row) + "\n" for row in [header, *body])
        write_text(out / "table.csv", "".join(lines))
        results = [{"point": row.point, "figures": row.figures, "diverged": row.diverged} for row in rows]
        own = {"runs": study.runs, "seed": study.seed, "filter": study.filter}
        write_json(out / "sweep.json", own | {"results": results})

    rows: list = []
    try:
        with workers(cluster) as threads, timed_bars() as progress:
            for row in library.rows_of(study, out, threads or worker_count(jobs), progress):
                rows.append(row)
    except BaseException as error:
        if rows:
            write(rows)
            error.add_note(f"the {len(rows)} of {len(study.points)} points that were finished are in {out}")
        raise
    write(rows)
    library.figure(rows).savefig(out / "sweep.png", dpi=150)
    shown = Table(*rows[0].point, *rows[0].figures, "diverged", box=None)
    for row in rows:
        cells = [f"{value:.3g} [{low:.3g}, {high:.3g}]" for value, low, high in row.figures.values()]
        shown.add_row(*map(str, row.point.values()), *cells, str(row.diverged))
    console = Console(markup=False)
    console.print(shown)
    console.print(f"written: {out}")
