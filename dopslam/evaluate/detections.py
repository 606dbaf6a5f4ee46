"""Detections against traced paths: what the estimator found, missed and invented. Evaluation only; no filter sees
this."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from dopslam.records import DetectionSeries, Paths
from estimation import PARAMETERS, Detections, SignalModel
from estimation.evaluate import Match

RHO_BANDS_DB = (10, 12, 14, 16, 17, 20, 90)


def snapshot(model: SignalModel, detections: DetectionSeries, step: int) -> Detections:
    """The detections of one step as the estimator's own record."""
    rows = detections.rows(step)
    covariance = detections.covariance[rows]
    cosine = np.ones((len(covariance), 6))
    cosine[:, 1], cosine[:, 3] = np.cos(detections.aoa[rows, 1]), np.cos(detections.aod[rows, 1])
    return Detections(
        **{c: getattr(detections, c)[rows] for c in ("delay", "aoa", "aod", "radial_velocity", "gain", "snr")},
        covariance=covariance,
        tangent_covariance=covariance * cosine[:, :, None] * cosine[:, None, :],
        noise_variance=float(detections.noise_variance[step]),
        threshold=detections.threshold,
        false_alarm_rate=detections.false_alarm_rate,
        flags=np.zeros(len(covariance), np.uint8),
        active=model.active,
    )


def true_landmarks(matches: list[Match], paths: Paths, detections: DetectionSeries) -> np.ndarray:
    """(N,) landmark that each detection stems from, −1 for a false one."""
    label = np.full(len(detections.delay), -1)
    for step, match in enumerate(matches):
        label[detections.rows(step).start + match.found] = paths.landmark[paths.rows(step)][match.truth]
    return label


def nees_per_parameter(matches: list[Match]) -> dict[str, float]:
    """Mean squared error of each observed parameter over the detections' own variance."""
    error = np.concatenate([m.error for m in matches])
    variance = np.concatenate([np.diagonal(m.covariance, axis1=1, axis2=2) for m in matches])
    mean = np.mean(error**2 / variance, axis=0)
    return dict(zip(PARAMETERS, mean.tolist(), strict=True)) if len(mean) == len(PARAMETERS) else {}


def figures(matches: list[Match]) -> dict:
    """Probability of detection by band of true ρ, false paths per snapshot and NEES over its dimension of the
    detections."""
    rho = 10 * np.log10(np.maximum(np.concatenate([m.rho for m in matches]), 1e-12))
    detected = np.concatenate([m.detected for m in matches])
    nees = np.concatenate([m.nees for m in matches])
    bands = {}
    for low, high in pairwise(RHO_BANDS_DB):
        inside = (rho >= low) & (rho < high)
        bands[f"{low}-{high}"] = {"found": int(detected[inside].sum()), "of": int(inside.sum())}
    return {
        "per_snapshot": float(np.mean([len(m.truth) + m.false for m in matches])),
        "false_per_snapshot": float(np.mean([m.false for m in matches])),
        "nees_over_6": float(nees.mean() / 6) if len(nees) else None,
        "nees_per_parameter": nees_per_parameter(matches) if len(nees) else None,
        "found_by_rho_db": bands,
    }
