"""Figures of belief-propagation SLAM after paper B: type beliefs (Fig. 2), errors and map (Fig. 4 a–c)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from dopslam.report.figures import house_style
from dopslam.slam.belief.experiment import Experiment, Truth
from dopslam.slam.belief.records import Form
from dopslam.studies.bp_run import History
from dopslam.studies.loopy import LoopyErrors


def type_beliefs(names: Sequence[str], tables: dict[str, dict]) -> Figure:
    """Mean belief in the true type of every feature over the steps; one line style per case.

    names : of the features; tables : case → :func:`dopslam.studies.bp_study.summary`
    """
    with house_style():
        figure = Figure(figsize=(6.4, 3.2))
        axes = figure.subplots()
        for style, (case, table) in zip(("-", "--", ":", "-."), tables.items(), strict=False):
            mean = np.array(table["per_step"]["type_belief_true"])
            for place, name in enumerate(names):
                axes.plot(1 + np.arange(len(mean)), mean[:, place], style, color=f"C{place}", label=f"{name}, {case}")
        axes.set(xlabel="step", ylabel="belief in the true type", ylim=(-0.02, 1.02))
        axes.legend(fontsize="small")
    return figure


def errors_over_time(tables: dict[str, dict]) -> Figure:
    """Position and orientation RMSE over the runs at every step, with the first case's bound."""
    with house_style():
        figure = Figure(figsize=(6.4, 4.6))
        above, below = figure.subplots(2, 1, sharex=True)
        for case, table in tables.items():
            steps = table["per_step"]
            above.plot(1 + np.arange(len(steps["rmse_position"])), 1e3 * np.array(steps["rmse_position"]), label=case)
            below.plot(1 + np.arange(len(steps["rmse_heading"])), np.degrees(steps["rmse_heading"]), label=case)
        first = next(iter(tables))
        limits = tables[first]["per_step"]
        numbers = 1 + np.arange(len(limits["bound_position"]))
        above.plot(numbers, 1e3 * np.array(limits["bound_position"]), "k--", label=f"PCRB, {first}")
        below.plot(numbers, np.degrees(limits["bound_heading"]), "k--", label=f"PCRB, {first}")
        above.set(ylabel="position RMSE [mm]", yscale="log")
        below.set(xlabel="step", ylabel="orientation RMSE [°]", yscale="log")
        above.legend(fontsize="small")
    return figure


def belief_map(experiment: Experiment, truth: Truth, history: History, types: tuple[Form, ...]) -> Figure:
    """Estimated track and features of one run; the color is the belief in the virtual-anchor type."""
    with house_style():
        figure = Figure(figsize=(5.4, 4.6))
        axes = figure.subplots()
        estimate = history.infos[-1].estimate
        virtual = np.array([form != Form.PS for form in types])
        axes.plot(*truth.position[:, :2].T, "k-", lw=2, label="track")
        axes.plot(*history.positions[:, :2].T, "C1-", lw=1, label="estimated track")
        axes.plot(*experiment.anchor[:2], "k^", label="anchor")
        axes.plot(*experiment.features[:, :2].T, "ko", ms=11, mfc="none", label="true features")
        belief = estimate.type_belief[:, virtual].sum(axis=1)
        dots = axes.scatter(*estimate.feature[:, :2].T, c=belief, cmap="coolwarm", vmin=0, vmax=1, zorder=3)
        figure.colorbar(dots, label="belief: virtual anchor (1), point scatterer (0)")
        axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
        axes.legend(fontsize="small")
    return figure


def association_errors(errors: LoopyErrors) -> Figure:
    """Share of cases whose worst marginal error exceeds a value, one line per kind of case."""
    with house_style():
        figure = Figure(figsize=(6.4, 3.2))
        axes = figure.subplots()
        for name, values in errors.worst.items():
            ordered = np.sort(np.maximum(values, 1e-9))
            axes.step(ordered, 1 - np.arange(len(ordered)) / len(ordered), where="post", label=name)
        axes.set(xscale="log", yscale="log", xlim=(1e-6, 1), xlabel="worst error of a marginal", ylabel="share above")
        axes.legend(fontsize="small")
    return figure


def feature_names(experiment: Experiment) -> list[str]:
    """VA 1, VA 2, PS 1, … in the order of the features."""
    names, counts = [], {"VA": 0, "PS": 0}
    for form in experiment.forms:
        kind = "PS" if form == Form.PS else "VA"
        counts[kind] += 1
        names.append(f"{kind} {counts[kind]}")
    return names
