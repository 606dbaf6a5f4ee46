"""Figures of the estimator studies (matplotlib is imported only here and only when drawing)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")


def draw(study: str, result, path: Path) -> None:
    """Draw one study's result into a PNG, if it is one to draw."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    painter = {
        "accuracy": _accuracy,
        "weak": _weak,
        "hybrid": _weak,
        "resolution": _resolution,
        "false_alarms": _false_alarms,
        "ambiguity": _ambiguity,
        "speed": _speed,
        "search_loss": _loss,
        "swept": _weak,
    }.get(study)
    if painter is None:
        return
    figure = painter(plt, result)
    figure.tight_layout()
    figure.savefig(path, dpi=150)
    plt.close(figure)


def _accuracy(plt, result):
    figure, axes = plt.subplots(2, 3, figsize=(10, 5.5), sharex=True, sharey=True)
    for color, (name, values) in zip(COLORS, result.items(), strict=False):
        levels = list(values["per_snr"])
        for axis, parameter in zip(axes.flat, values["rmse_over_crb"], strict=True):
            ratio = [values["per_snr"][s]["rmse_over_crb"][parameter] for s in levels]
            spread = np.array([values["per_snr"][s]["rmse_interval"][parameter] for s in levels]).T
            axis.errorbar(
                [float(s) for s in levels],
                ratio,
                np.abs(spread - ratio),
                color=color,
                marker="o",
                ms=3,
                capsize=2,
                label=name,
            )
            axis.set_title(parameter.replace("_", " "), fontsize=9)
            axis.axhline(1, color="0.6", lw=0.8)
    axes[0, 0].legend(fontsize=8)
    axes[0, 0].set_ylim(0.7, 1.6)
    for axis in axes[1]:
        axis.set_xlabel("per-sample SNR of the strongest path [dB]", fontsize=8)
    for axis in axes[:, 0]:
        axis.set_ylabel("RMSE / sqrt(CRB)")
    return figure


def _weak(plt, result):
    figure, axis = plt.subplots(figsize=(5, 3.5))
    centers, measured, law, spread = [], [], [], []
    for band, value in result["p_detect"].items():
        low, high = (float(b) for b in band.split("-"))
        centers.append((low + high) / 2)
        measured.append(value["p_detect"])
        law.append(value["model"])
        spread.append(np.abs(np.array(value["interval"]) - value["p_detect"]))
    axis.errorbar(centers, measured, np.array(spread).T, marker="o", color=COLORS[0], capsize=3, label="measured")
    axis.plot(centers, law, "s--", color=COLORS[1], label="model p_D(rho)")
    axis.set(xlabel="rho [dB]", ylabel="probability of detection")
    axis.legend()
    return figure


def _resolution(plt, result):
    figure, axes = plt.subplots(1, len(result), figsize=(3 * len(result), 3.2), sharey=True)
    for axis, (dimension, levels) in zip(np.atleast_1d(axes), result.items(), strict=True):
        for color, (label, rows) in zip(COLORS, levels.items(), strict=False):
            resolved = np.array([r["resolved"] for r in rows])
            spread = np.abs(np.array([r["interval"] for r in rows]).T - resolved)
            axis.errorbar(
                [r["separation"] for r in rows],
                resolved,
                spread,
                marker="o",
                color=color,
                capsize=2,
                label=f"rho {label}",
            )
            possible = [r["possible"] for r in rows]
            axis.plot([r["separation"] for r in rows], possible, "--", color=color, lw=0.8, label="likelihood ratio")
        axis.set(title=dimension, xlabel="separation [bins]")
    np.atleast_1d(axes)[0].set_ylabel("both found, nothing else")
    np.atleast_1d(axes)[0].legend(fontsize=8)
    return figure


def _false_alarms(plt, result):
    figure, axis = plt.subplots(figsize=(4, 3.5))
    nominal = np.array([r["nominal"] for r in result])
    measured = np.array([r["measured"] for r in result])
    spread = np.abs(np.array([r["interval"] for r in result]).T - measured)
    axis.errorbar(nominal, measured, spread, marker="o", color=COLORS[0], capsize=3)
    axis.plot(nominal, nominal, "--", color="0.5")
    axis.set(xscale="log", xlabel="nominal false paths per snapshot", ylabel="measured in noise alone")
    return figure


def _ambiguity(plt, result):
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.3), sharey=True)
    for axis, book in zip(axes, ("dft", "antenna_switching", "random_phase"), strict=True):
        rows = {label.split(", ")[1]: row for label, row in result.items() if label.startswith(book)}
        for color, (order, row) in zip(COLORS, rows.items(), strict=False):
            axis.plot(row["speeds"], row["profile"], color=color, lw=1, label=order.replace("_", " "))
        axis.axhline(0.9, color="0.6", lw=0.8)
        axis.set(title=book.replace("_", " "), xlabel="speed difference [m/s]")
    axes[0].set_ylabel("worst correlation over AOD")
    axes[0].legend(fontsize=8)
    return figure


def _speed(plt, result):
    figure, axis = plt.subplots(figsize=(4.5, 3.5))
    samples = [r["samples"] for r in result]
    for color, key in zip(COLORS, ("ms_cold", "ms_warm"), strict=False):
        axis.loglog(samples, [r[key] for r in result], marker="o", color=color, label=key.replace("ms_", ""))
    axis.set(xlabel="samples", ylabel="ms per snapshot")
    axis.legend()
    return figure


def _loss(plt, result):
    figure, axis = plt.subplots(figsize=(4.5, 3.5))
    axis.plot(result["rho_db"], result["search"], marker="o", color=COLORS[0], label="staged search")
    axis.plot(
        result["rho_db"], result["from_truth"], marker="s", ls="--", color=COLORS[1], label="started at the truth"
    )
    axis.set(xlabel="rho [dB]", ylabel="probability of detection", title=f"loss {result['loss_db']:.2f} dB")
    axis.legend()
    return figure
