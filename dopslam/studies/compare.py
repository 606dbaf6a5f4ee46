"""Several runs beside each other: figures with intervals, and differences on the same seeds.

What is read: results folders (``summary.json`` and ``errors.csv``), folders that hold several of them, and the JSON files of
``dopslam montecarlo`` and of the traced study. Two entries are compared over the runs that both have: the same scenario
name, seed and number of the run, so that what the draw decides cancels. With a single run in common the differences are
taken over its steps, and their interval speaks of that run alone (:func:`dopslam.evaluate.statistics.over_steps`).
"""

from __future__ import annotations

import csv
import json
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dopslam.errors import DatasetError
from dopslam.evaluate.statistics import Interval, over_runs, over_steps

Run = tuple[str, int, int]  # scenario, seed, number of the run within a study

QUANTITIES = {  # figure of a run → (title, digits, column of errors.csv that it is the root mean square of)
    "position_rmse_m": ("position m", 4, "position_error_m"),
    "position_over_bound": ("× bound", 2, ""),
    "heading_rmse_deg": ("heading °", 4, "heading_error_deg"),
    "clock_bias_rmse_m": ("clock m", 4, "clock_bias_error_m"),
    "nees": ("NEES", 2, ""),
    "gospa_va_m": ("GOSPA VA m", 2, ""),
    "gospa_sp_m": ("GOSPA SP m", 2, ""),
    "wall_distance_m": ("walls m", 3, ""),
}


@dataclass(frozen=True)
class Entry:
    """One filter of one argument.

    Attributes
    ----------
    name : as in the table
    runs : figures by run; a figure that a run lacks is missing or None
    steps : per-step errors by run, by column of ``errors.csv``
    diverged : number of runs that lost the receiver or failed
    configuration : effective keys of the scenario, flat; empty where they are not at hand
    """

    name: str
    runs: dict[Run, dict[str, float]] = field(default_factory=dict)
    steps: dict[Run, dict[str, np.ndarray]] = field(default_factory=dict)
    diverged: int = 0
    configuration: dict[str, Any] = field(default_factory=dict)

    def values(self, quantity: str, runs: Sequence[Run]) -> np.ndarray:
        """Figures of some runs, NaN where there is none."""
        return np.array([self.runs[run].get(quantity, np.nan) for run in runs], dtype=float)

    def interval(self, quantity: str) -> Interval:
        """The figure over all runs of this entry, or over the steps of its only one."""
        values = self.values(quantity, list(self.runs))
        column = QUANTITIES[quantity][2]
        if len(values) == 1 and column and self.steps:
            return over_steps(next(iter(self.steps.values()))[column])
        return over_runs(values[np.isfinite(values)])

    def difference(self, other: Entry, quantity: str) -> Interval | None:
        """This entry's figure less another's, over the runs that both have; None if there is none."""
        shared = [run for run in self.runs if run in other.runs]
        pairs = self.values(quantity, shared) - other.values(quantity, shared)
        pairs = pairs[np.isfinite(pairs)]
        if not len(pairs):
            return None
        column = QUANTITIES[quantity][2]
        if len(shared) == 1 and column and shared[0] in self.steps and shared[0] in other.steps:
            mine, theirs = self.steps[shared[0]][column], other.steps[shared[0]][column]
            if len(mine) == len(theirs):
                return over_steps(mine, theirs)
        return over_runs(pairs)


@dataclass(frozen=True)
class Comparison:
    """Entries, the first of them the one that the others are compared with."""

    entries: tuple[Entry, ...]

    @property
    def quantities(self) -> list[str]:
        """Figures that at least one entry has."""
        return [q for q in QUANTITIES if any(np.isfinite(e.interval(q).value) for e in self.entries)]

    def shared(self, entry: Entry) -> int:
        """Runs that an entry has in common with the first."""
        return sum(run in self.entries[0].runs for run in entry.runs)

    @property
    def differing(self) -> dict[str, list]:
        """Keys of the scenarios that are not the same everywhere, with the value of each entry."""
        known = [e.configuration for e in self.entries if e.configuration]
        keys = sorted({key for c in known for key in c})
        shown = {key: [e.configuration.get(key) for e in self.entries] for key in keys}
        return {k: v for k, v in shown.items() if len({json.dumps(c.get(k), default=str) for c in known}) > 1}

    def tree(self) -> dict:
        """Everything as plain numbers for JSON."""
        first = self.entries[0]
        return {
            "against": first.name,
            "entries": [
                {
                    "name": e.name,
                    "runs": len(e.runs),
                    "shared_with_first": self.shared(e),
                    "diverged": e.diverged,
                    "figures": {q: e.interval(q)._asdict() for q in self.quantities},
                    "difference": {
                        q: None if (d := e.difference(first, q)) is None else d._asdict() for q in self.quantities
                    },
                }
                for e in self.entries
            ],
            "differing_keys": self.differing,
        }


def read(paths: Sequence[str | Path], filters: Sequence[str] = ()) -> Comparison:
    """Everything that the paths hold, in their order.

    Parameters
    ----------
    paths : results folders, folders of results folders, JSON files of studies
    filters : names of the variants that are wanted; empty: all

    Raises
    ------
    DatasetError
        If a path holds no result, or fewer than two entries remain.
    """
    found: list[Entry] = []
    labels = _labels([Path(p) for p in paths])
    for path, label in zip(paths, labels, strict=True):
        entries = _entries(Path(path))
        wanted = {n: e for n, e in entries.items() if not filters or n in filters}
        if not wanted:
            raise DatasetError(f"{path}: holds no filter {' or '.join(filters)}; it has {', '.join(entries)}")
        found += [_named(e, f"{label}: {n}" if len(paths) > 1 else n) for n, e in wanted.items()]
    if len(found) < 2:
        raise DatasetError(f"{paths[0]}: one entry alone; name a second run or file to compare it with")
    return Comparison(tuple(found))


def _named(entry: Entry, name: str) -> Entry:
    return Entry(name, entry.runs, entry.steps, entry.diverged, entry.configuration)


def _labels(paths: list[Path]) -> list[str]:
    """Short names of the paths that are all different: the last part, or as many as it takes."""
    whole = [path.resolve() for path in paths]
    for count in range(1, max(len(path.parts) for path in whole) + 1):
        labels = ["/".join(path.parts[-count:]) for path in whole]
        if len(set(labels)) == len(labels):
            return labels
    return [f"{number}. {path.name}" for number, path in enumerate(whole, start=1)]


def _entries(path: Path) -> dict[str, Entry]:
    """Entries of one argument by the name of the filter's variant."""
    if path.is_dir():
        folders = [path] if (path / "summary.json").exists() else sorted(
            p.parent for p in path.glob("*/summary.json") if not p.parent.is_symlink() and not p.parent.name.startswith(".")
        )  # fmt: skip
        if not folders:
            raise DatasetError(
                f"{path}: neither a results folder (summary.json) nor a folder of some; 'dopslam run' makes one"
            )
        return _joined(_of_folder(folder) for folder in folders)
    tree = _json(path)
    if "variants" in tree:
        return _of_folder(path.parent)
    if "per_run" in tree or "filters" in tree:
        return _of_montecarlo(path, tree)
    if isinstance(tree.get("runs"), dict) and "seeds" in tree:
        return _of_traced(tree)
    raise DatasetError(
        f"{path}: holds no figures of single runs; give a results folder, summary.json, or the file of "
        "'dopslam montecarlo --json' (made by this version)"
    )


def _json(path: Path) -> dict:
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise DatasetError(f"{path}: no such file or folder; name a results folder or a result file") from error
    except (OSError, ValueError) as error:
        raise DatasetError(f"{path}: no readable JSON ({error}); name a results folder or a result file") from error
    if not isinstance(tree, dict):
        raise DatasetError(f"{path}: holds no result; name a results folder or a result file")
    return tree


def _joined(parts: Iterator[dict[str, Entry]]) -> dict[str, Entry]:
    joined: dict[str, Entry] = {}
    for entries in parts:
        for name, entry in entries.items():
            have = joined.setdefault(name, Entry(name, configuration=entry.configuration))
            twice = have.runs.keys() & entry.runs.keys()
            if twice:
                scenario, seed, _ = next(iter(twice))
                raise DatasetError(f"{scenario}, seed {seed}, {name}: is there twice; compare the folders one by one")
            joined[name] = Entry(
                name, have.runs | entry.runs, have.steps | entry.steps, have.diverged + entry.diverged, have.configuration
            )  # fmt: skip
    return joined


def _of_folder(folder: Path) -> dict[str, Entry]:
    tree = _json(folder / "summary.json")
    try:
        run = (str(tree["scenario"]), int(tree["seed"]), 0)
        variants: dict[str, dict] = tree["variants"]
        steps, configuration = _steps(folder / "errors.csv"), _configuration(folder / "scenario.toml")
        return {
            name: Entry(
                name,
                {run: _figures(figures)},
                {run: steps[name]} if name in steps else {},
                int(bool(figures.get("diverged"))),
                configuration,
            )
            for name, figures in variants.items()
        }
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DatasetError(f"{folder / 'summary.json'}: not the summary of a run ({error!r}); make it anew") from error


def _figures(tree: dict) -> dict[str, float]:
    own = {q: float(tree[q]) for q in QUANTITIES if isinstance(tree.get(q), int | float)}
    ratio = (tree.get("rmse_over_bound") or {}).get("position")
    return own | ({} if ratio is None else {"position_over_bound": float(ratio)})


def _steps(path: Path) -> dict[str, dict[str, np.ndarray]]:
    if not path.exists():
        return {}
    wanted = [column for *_, column in QUANTITIES.values() if column]
    rows: dict[str, dict[str, list[float]]] = {}
    with open(path, encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            columns = rows.setdefault(row["filter"], {column: [] for column in wanted})
            for column in wanted:
                columns[column].append(float(row[column]))
    return {name: {c: np.array(v) for c, v in columns.items()} for name, columns in rows.items()}


def _configuration(path: Path) -> dict[str, Any]:
    if not path.exists():
        return {}
    flat: dict[str, Any] = {}

    def walk(tree: dict, prefix: str) -> None:
        for key, value in tree.items():
            if isinstance(value, dict):
                walk(value, f"{prefix}{key}.")
            else:
                flat[prefix + key] = value

    walk(tomllib.loads(path.read_text(encoding="utf-8")), "")
    return flat


def _of_montecarlo(path: Path, tree: dict) -> dict[str, Entry]:
    entries = {}
    for name, result in (tree.get("filters") or {tree["filter"]: tree}).items():
        table = result.get("per_run")
        if table is None:
            raise DatasetError(
                f"{path}: an older study without the figures of single runs; run 'dopslam montecarlo' again"
            )
        runs = {
            (str(result["scene"]), int(result["seed"]), int(number)): {
                q: float(table[q][row]) for q in QUANTITIES if q in table
            }
            for row, number in enumerate(table["run"])
        }
        entries[name] = Entry(name, runs, diverged=int(result.get("diverged", 0)))
    return entries


def _of_traced(tree: dict) -> dict[str, Entry]:
    entries: dict[str, Entry] = {}
    for noise, runs in tree["runs"].items():
        for seed, variants in zip(tree["seeds"], runs, strict=True):
            for name, figures in variants.items():
                label = name if noise == "estimator" else f"{name}, noise of the {noise}"
                entry = entries.setdefault(label, Entry(label))
                entry.runs[(str(tree["scenario"]), int(seed), 0)] = _figures(figures)
    return entries
