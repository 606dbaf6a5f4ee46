"""How good a run is: errors of track and map beside the bound, and the summary that a results folder leads with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dopslam.records import Kind, Landmarks, Track


@dataclass(frozen=True)
class Evaluation:
    """Errors and bounds per step of one run.

    Attributes
    ----------
    position_error : (K,) m; heading_error : (K,) rad, signed; bias_error : (K,) m, signed
    peb : (K,) m; heb : (K,) rad; ceb : (K,) m; posterior Cramér–Rao bounds of the same run
    nees : (K,) normalized squared error of the state, 4 expected
    gospa_va, gospa_sp : (K,) m
    found : (L,) m, distance of every true landmark to the nearest reported one of its kind at the last step
    """

    position_error: np.ndarray
    heading_error: np.ndarray
    bias_error: np.ndarray
    peb: np.ndarray
    heb: np.ndarray
    ceb: np.ndarray
    nees: np.ndarray
    gospa_va: np.ndarray
    gospa_sp: np.ndarray
    found: np.ndarray

    @property
    def rmse_over_bound(self) -> dict[str, float]:
        """Ratio of root mean squares over the steps (the single-run convention)."""
        return {
            "position": _rms(self.position_error) / _rms(self.peb),
            "heading": _rms(self.heading_error) / _rms(self.heb),
            "clock": _rms(self.bias_error) / _rms(self.ceb),
        }


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def summarize(evaluation: Evaluation, landmarks: Landmarks, found_radius: float) -> dict:
    """The figures of ``summary.json``; keys carry their units."""
    within = evaluation.found <= found_radius
    counts = {
        f"{label}_found": {"found": int(np.sum(within & (landmarks.kind == kind))), "of": int(np.sum(landmarks.kind == kind))}
        for label, kind in (("va", Kind.VA), ("sp", Kind.SP))
    }
    return {
        "position_rmse_m": _rms(evaluation.position_error),
        "heading_rmse_deg": float(np.degrees(_rms(evaluation.heading_error))),
        "clock_bias_rmse_m": _rms(evaluation.bias_error),
        "peb_m": _rms(evaluation.peb),
        "heb_deg": float(np.degrees(_rms(evaluation.heb))),
        "ceb_m": _rms(evaluation.ceb),
        "rmse_over_bound": evaluation.rmse_over_bound,
        "gospa_va_m": float(evaluation.gospa_va[-1]),
        "gospa_sp_m": float(evaluation.gospa_sp[-1]),
        **counts,
        "found_within_m": found_radius,
        "landmark_error_m": {
            str(name): (float(error) if np.isfinite(error) else None)
            for name, error, kind in zip(landmarks.name, evaluation.found, landmarks.kind, strict=True)
            if kind != Kind.BS
        },
        "nees": float(np.mean(evaluation.nees)),
    }


def state_errors(track: Track, mean: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signed errors (K, 4) of the state, heading wrapped, and their NEES (K,)."""
    error = mean[:, :4] - track.state
    error[:, 2] = (error[:, 2] + np.pi) % (2 * np.pi) - np.pi
    nees = np.einsum("ki,ki->k", error, np.linalg.solve(covariance[:, :4, :4], error[..., None])[..., 0])
    return error, nees
