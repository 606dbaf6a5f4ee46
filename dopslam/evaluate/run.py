"""How good a run is: errors of track and map beside the bound, and the summary that a results folder leads with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from dopslam.config.scenario import Scenario
from dopslam.evaluate import metrics
from dopslam.evaluate.bounds import Bound, row_information
from dopslam.models.measurement import residual
from dopslam.models.scans import CLUTTER, Scans
from dopslam.records import Kind, Landmarks, Track
from dopslam.slam.history import History

ASSOCIATION_GATE = 100.0  # squared Mahalanobis distance (6 degrees of freedom) beyond which a detection is false


LOST_NEES = 500.0


@dataclass(frozen=True)
class Evaluation:
    """Errors and bounds per step of one run.

    Attributes
    ----------
    position_error : (K,) m; heading_error : (K,) rad, signed; bias_error : (K,) m, signed
    peb : (K,) m; heb : (K,) rad; ceb : (K,) m; posterior Cramér–Rao bounds of the same run
    nees : (K,) normalized squared error of the state; ``states`` of it, whose truth is known, are expected
    gospa_va, gospa_sp : (K,) m
    found : (L,) m, distance of every true landmark to its estimate at the last step, inf if there is none
    lost : why the filter's own history counts as lost, without the truth; empty if it does not
    restarted : from which steps the filter was started anew, and why; empty if it was not
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
    lost: str = ""
    restarted: str = ""
    states: int = 4

    @property
    def diverged(self) -> bool:
        """Whether the track is lost by its own history, or by the truth: an error at the end, or a claim of accuracy, that
        no luck explains.

        By the truth: the last position is beyond 10 m and 30 times its bound, or more than half of the NEES exceed
        ``LOST_NEES`` (4 are expected; a filter that is merely overconfident stays in the tens).
        """
        nees = np.nan_to_num(self.nees, nan=np.inf)
        bound = float(np.nan_to_num(self.peb[-1], posinf=1e9))
        astray = np.isfinite(self.peb[-1]) and not self.position_error[-1] <= max(10.0, 30.0 * bound)
        return bool(self.lost or astray or np.median(nees) > LOST_NEES)

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


def true_association(scans: Scans, exact: np.ndarray, offsets: np.ndarray, landmark: np.ndarray) -> np.ndarray:
    """Which landmark each detection stems from, by the truth: one-to-one within a step, nearest by Mahalanobis.

    Only the bound and the evaluation know it; no filter does.

    Parameters
    ----------
    scans : detections as measurements (N rows)
    exact : (M, 6) noise-free measurements of the true paths
    offsets : (K + 1,) rows of ``exact`` of each step
    landmark : (M,) landmark of each true path

    Returns
    -------
    (N,) int, landmark or −1 for a false detection
    """
    label, covariance = np.full(len(scans.z), CLUTTER), scans.covariance
    if np.isnan(exact[:, 0]).any():  # the clock's truth is not known: delays tell nothing of the association
        exact, covariance = exact.copy(), covariance.copy()
        exact[:, 0] = 0.0
        covariance[:, 0] = covariance[:, :, 0] = 0.0
        covariance[:, 0, 0] = np.inf
    weights = row_information(covariance, where="row")
    for step in range(scans.steps):
        rows = np.arange(len(label))[scans.rows(step)]
        truth = slice(int(offsets[step]), int(offsets[step + 1]))
        if not len(rows) or truth.start == truth.stop:
            continue
        difference = residual(scans.z[rows][:, None], exact[truth][None])
        distance = np.einsum("nmi,nij,nmj->nm", difference, weights[rows], difference)
        for row, path in zip(*linear_sum_assignment(np.minimum(distance, ASSOCIATION_GATE)), strict=True):
            if distance[row, path] < ASSOCIATION_GATE:
                label[rows[row]] = landmark[truth][path]
    return label


def landmark_errors(landmarks: Landmarks, history: History, threshold: float, largest_order: int = 1) -> np.ndarray:
    """Distance (L,) of each true landmark to its estimate at the last step, one-to-one within its kind; inf if missed.

    Virtual anchors of more reflections than ``largest_order`` are looked for among the second reflections."""
    found = np.full(len(landmarks), np.inf)
    found[landmarks.kind == Kind.BS] = 0.0
    simple = landmarks.order <= largest_order
    for kind, chosen in (
        (Kind.VA, (landmarks.kind == Kind.VA) & simple),
        (Kind.SP, landmarks.kind == Kind.SP),
        (Kind.SR, (landmarks.kind == Kind.VA) & ~simple),
    ):
        true = np.flatnonzero(chosen)
        estimated = history.reported(history.steps - 1, kind, threshold)
        distance = np.linalg.norm(landmarks.position[true][:, None] - estimated[None], axis=-1)
        for i, j in zip(*linear_sum_assignment(distance), strict=True):
            found[true[i]] = distance[i, j]
    return found


def evaluate_run(
    scenario: Scenario,
    track: Track,
    landmarks: Landmarks,
    history: History,
    bound: Bound | None,
    largest_order: int = 1,
) -> Evaluation:
    """Errors of a filter's history beside the bound of the same run.

    The map is judged over the landmarks that the filter's measurement model describes: scatter points and virtual
    anchors of up to ``largest_order`` reflections (1 for the EK-PMB filters; belief propagation calls the others by the
    same name). Those of higher order count in ``found`` alone.

    What nobody knows is NaN and not judged: a true clock bias (NaN in the track), whose state is left out of the NEES; a
    true map (no landmark but the base station), and with it GOSPA; a bound (None).
    """
    error = metrics.state_errors(history.mean[:, :4], track.state)
    settings, threshold = scenario.evaluation, scenario.filter.report_existence
    known = np.flatnonzero(np.isfinite(error).all(axis=0))
    unbounded = np.full(len(error), np.nan)
    described = landmarks.order <= largest_order

    def gospa(kind: Kind) -> np.ndarray:
        if np.all(landmarks.kind == Kind.BS):
            return unbounded
        true = landmarks.position[(landmarks.kind == kind) & described]
        return np.array([
            metrics.gospa(
                true, history.reported(k, kind, threshold), settings.gospa_cutoff, settings.gospa_order
            ).distance
            for k in range(history.steps)
        ])  # fmt: skip

    return Evaluation(
        position_error=np.hypot(error[:, 0], error[:, 1]),
        heading_error=error[:, 2],
        bias_error=error[:, 3],
        peb=unbounded if bound is None else bound.peb,
        heb=unbounded if bound is None else bound.heb,
        ceb=unbounded if bound is None else bound.ceb,
        nees=metrics.nees(error[:, known], history.covariance[:, known[:, None], known]),
        states=len(known),
        gospa_va=gospa(Kind.VA),
        gospa_sp=gospa(Kind.SP),
        found=landmark_errors(landmarks, history, threshold, largest_order),
        lost=history.lost,
        restarted=history.restarted,
    )


def summarize(evaluation: Evaluation, landmarks: Landmarks, found_radius: float) -> dict:
    """The figures of ``summary.json``; keys carry their units."""
    within, simple = evaluation.found <= found_radius, landmarks.order <= 1
    counts = {}
    for label, kind in (("va", Kind.VA), ("sp", Kind.SP)):
        chosen = simple & (landmarks.kind == kind)
        counts |= {f"{label}_found": int(np.sum(within & chosen)), f"{label}_total": int(np.sum(chosen))}

    def named(chosen: np.ndarray) -> dict:
        pairs = zip(landmarks.name[chosen], evaluation.found[chosen], strict=True)
        return {str(name): (float(error) if np.isfinite(error) else None) for name, error in pairs}

    return {
        "diverged": evaluation.diverged,
        **({"lost": evaluation.lost} if evaluation.lost else {}),
        **({"restarted": evaluation.restarted} if evaluation.restarted else {}),
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
        "landmark_error_m": named(simple & (landmarks.kind != Kind.BS)),
        "higher_order_va_error_m": named(~simple),
        "nees": float(np.mean(evaluation.nees)),
        "nees_states": evaluation.states,
    }
