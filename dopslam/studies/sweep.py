"""Sweeps: a Monte Carlo study for every combination of values of any scenario keys, in one table and one figure.

A sweep is a TOML file::

    scenario = "ring_road"
    source = "model"            # detections drawn from the model; or "traced": every seed traced, synthesized and
    estimated
    filter = "joint"            # any that dopslam run takes
    runs = 50
    seed = 0
    set = ["track.steps=40"]    # applied to all

    [vary]
    "source.model.doppler_std" = [0.05, 0.1, 0.2]
    "filter.associations" = [1, 10]

All combinations use the same seeds, so that differences are paired. Intervals are 95 %.
"""

from __future__ import annotations

import itertools
import math
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import tomli_w
from matplotlib.figure import Figure

from dopslam.config.scenario import Scenario, load
from dopslam.config.sentences import shown
from dopslam.errors import ConfigError
from dopslam.filters import FILTERS
from dopslam.pipeline.file import split_variant
from dopslam.pipeline.stages import Progress, quiet
from dopslam.studies import montecarlo
from dopslam.studies import summary as studies
from dopslam.studies import traced as traced_study

LARGEST_SWEEP = 10_000
KEYS = {"scenario": str, "source": str, "filter": str, "runs": int, "seed": int, "set": list, "vary": dict}
LABELS = {
    "position_ratio": "position RMSE / bound", "heading_ratio": "heading RMSE / bound", "clock_ratio": "clock RMSE / bound",
    "nees": "NEES", "gospa_va_m": "GOSPA of VAs [m]", "gospa_sp_m": "GOSPA of SPs [m]",
}  # fmt: skip


@dataclass(frozen=True)
class Sweep:
    """What is repeated: keys and their values, and the study done at every combination."""

    scenario: str
    vary: dict[str, list]
    source: str = "model"
    filter: str = "joint"
    runs: int = 20
    seed: int = 0
    settings: tuple[str, ...] = ()

    @property
    def points(self) -> list[dict[str, Any]]:
        """Every combination of values."""
        return [dict(zip(self.vary, values, strict=True)) for values in itertools.product(*self.vary.values())]

    def at(self, point: dict[str, Any]) -> Scenario:
        """The scenario of one combination."""
        own = [f"{key}={_toml(value)}" for key, value in point.items()]
        return load(self.scenario, [f"source.kind={self.source}", *self.settings, *own])


@dataclass(frozen=True)
class Row:
    """Result of one combination: for every figure its value and 95 % interval, and the number of runs that failed or
    diverged."""

    point: dict[str, Any]
    figures: dict[str, tuple[float, float, float]]
    diverged: int


def _toml(value: Any) -> str:
    return tomli_w.dumps({"value": value}).partition("=")[2].strip()


def read_sweep(path: str | Path) -> Sweep:
    """Read and validate a sweep; every combination must be a valid scenario before anything runs.

    Raises
    ------
    ConfigError
        Naming the key, its value and what is allowed.
    """
    try:
        tree = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: not a readable sweep ({error})") from error
    for key, value in tree.items():
        if key not in KEYS:
            raise ConfigError(f"{path}: unknown key {key!r}; known are {', '.join(KEYS)}")
        if not isinstance(value, KEYS[key]) or isinstance(value, bool):
            raise ConfigError(f"{path}: {key} = {value!r} must be a {KEYS[key].__name__}")
    if "scenario" not in tree or not tree.get("vary"):
        raise ConfigError(f"{path}: needs scenario, and a table [vary] with at least one key and its values")
    for key, values in tree["vary"].items():
        if not isinstance(values, list) or not values:
            raise ConfigError(
                f"{path}: vary.{key!r} = {values!r}; give a list of values (and keys with dots in quotes)"
            )
    sweep = Sweep(
        tree["scenario"], tree["vary"], tree.get("source", "model"), tree.get("filter", "joint"),
        tree.get("runs", 20), tree.get("seed", 0), tuple(map(str, tree.get("set", []))),
    )  # fmt: skip
    if sweep.source not in ("model", "traced"):
        raise ConfigError(f"{path}: source = {sweep.source!r}; possible are 'model' and 'traced'")
    FILTERS[sweep.filter]
    if sweep.runs < 1 or not 0 <= sweep.seed < 2**63:
        raise ConfigError(f"{path}: runs = {sweep.runs}, seed = {sweep.seed}; give at least 1 run and a seed from 0")
    for key, runs, own in (("filter.density", sweep.filter, "filter"), ("source.kind", sweep.source, "source")):
        for value in sweep.vary.get(key, []):
            if value != runs:
                raise ConfigError(
                    f"{path}: vary.{key!r} = {value!r}, but what runs is {own} = {runs!r}; write one sweep for each {own}"
                )
    count = math.prod(len(values) for values in sweep.vary.values())
    if count > LARGEST_SWEEP or sweep.runs > LARGEST_SWEEP:
        raise ConfigError(
            f"{path}: [vary] asks for {count} points of {sweep.runs} runs; at most {LARGEST_SWEEP} of each are possible"
        )
    for point in sweep.points:
        try:
            sweep.at(point)
        except ConfigError as error:
            raise ConfigError(f"{path}: at {_said(point)}: {error}") from error
    return sweep


def _said(point: dict[str, Any]) -> str:
    return ", ".join(f"{key} = {shown(value)}" for key, value in point.items())


def run_sweep(sweep: Sweep, folder: Path, jobs: int = 1, progress: Progress = quiet) -> list[Row]:
    """Run every combination; the numbers do not depend on ``jobs``. ``folder`` keeps the datasets of traced sweeps."""
    return list(rows_of(sweep, folder, jobs, progress))


def rows_of(sweep: Sweep, folder: Path, jobs: int = 1, progress: Progress = quiet) -> Iterator[Row]:
    """The rows of :func:`run_sweep` one by one, each as soon as it is finished."""
    points = sweep.points
    for number, point in enumerate(points):
        progress("sweep", number, len(points))
        one = _model if sweep.source == "model" else _traced
        yield one(sweep, point, Path(folder) / f"point-{number:03d}", jobs)
    progress("sweep", len(points), len(points))


def _model(sweep: Sweep, point: dict[str, Any], folder: Path, jobs: int) -> Row:
    study = studies.study(sweep.at(point), sweep.filter)
    result = montecarlo.summarize(montecarlo.run_study(study, sweep.runs, sweep.seed, jobs), study)
    ratios, intervals = result["rmse_over_bound"], result["rmse_over_bound_interval"]
    figures = {f"{name}_ratio": (ratios[name], *intervals[name]) for name in ("position", "heading", "clock")}
    figures["nees"] = (result["nees_mean"], *result["nees_interval"])
    for name in ("gospa_va_m", "gospa_sp_m"):
        figures[name] = (result[name]["last"], *result[name]["last_interval"])
    return Row(point, figures, result["diverged"])


def _traced(sweep: Sweep, point: dict[str, Any], folder: Path, jobs: int) -> Row:
    folder.mkdir(parents=True, exist_ok=True)
    seeds = range(sweep.seed, sweep.seed + sweep.runs)
    result = traced_study.study(sweep.at(point), seeds, folder, jobs, noises=("estimator",), filters=(sweep.filter,))[
        "estimator"
    ]
    result = next(result[name] for name in result if split_variant(name)[0] == sweep.filter)

    def interval(entry: dict) -> tuple[float, float, float]:
        return entry["mean"], entry["low"], entry["high"]

    figures = {f"{name}_ratio": interval(result["rmse_over_bound"][name]) for name in ("position", "heading", "clock")}
    figures |= {name: interval(result[name]) for name in ("nees", "gospa_va_m", "gospa_sp_m")}
    return Row(point, figures, 0)


def table(rows: list[Row]) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the table: keys, then value, low and high of every figure."""
    names = list(rows[0].figures)
    header = [*rows[0].point, *(f"{n}{part}" for n in names for part in ("", "_low", "_high")), "diverged"]
    body = [
        [*map(str, row.point.values()), *(f"{v:.6g}" for n in names for v in row.figures[n]), str(row.diverged)]
        for row in rows
    ]
    return header, body


def figure(rows: list[Row]) -> Figure:
    """Figures over the first key with error bars, a line for every combination of the others."""
    keys = list(rows[0].point)
    values = [row.point[keys[0]] for row in rows]
    numeric = all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
    ticks = list(dict.fromkeys(map(str, values)))
    lines: dict[str, list[Row]] = {}
    for row in rows:
        lines.setdefault(", ".join(f"{k.rpartition('.')[2]} = {row.point[k]}" for k in keys[1:]), []).append(row)
    drawn = Figure(figsize=(11, 6), layout="constrained")
    colors = mpl.color_sequences["tab10"]
    for axes, name in zip(drawn.subplots(2, 3).flat, rows[0].figures, strict=True):
        for i, (label, those) in enumerate(lines.items()):
            x = np.array([r.point[keys[0]] if numeric else ticks.index(str(r.point[keys[0]])) for r in those], float)
            y, low, high = np.array([r.figures[name] for r in those]).T
            bars = np.maximum([y - low, high - y], 0)
            axes.errorbar(x, y, yerr=bars, marker="o", capsize=3, label=label, color=colors[i % 10])
        if not numeric:
            axes.set_xticks(range(len(ticks)), ticks)
        axes.set_xlabel(keys[0])
        axes.set_ylabel(LABELS[name])
        axes.grid(alpha=0.3)
    if len(lines) > 1:
        drawn.axes[0].legend(fontsize="small")
    return drawn
