"""EK-PMBM: the same recursion without the projection, a capped mixture of global hypotheses.

Every hypothesis carries its own Gaussian over UE and landmarks; each is predicted, associated and updated as
in the PMB filter, but every association becomes a hypothesis of its own. The mixture is pruned and capped
after each scan.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dopslam.compute.compiled import compiled
from dopslam.errors import FilterError
from dopslam.models.motion import MotionModel
from dopslam.models.scans import Scans
from dopslam.slam.history import Diagnostics, History, history_of, map_table
from dopslam.slam.pmb.birth import new_hypotheses
from dopslam.slam.pmb.density import PMB, Model, Scan, compile_model, initial_density
from dopslam.slam.pmb.ek_pmb import (
    FilterParameters,
    Info,
    check_inputs,
    name_tracks,
    predict,
    prune,
    scan_of,
    ue_size,
    worth_updating,
)
from dopslam.slam.pmb.hypotheses import Associations, best_associations, distort, local_hypotheses
from dopslam.slam.pmb.splinters import pass_over_splinters
from dopslam.slam.pmb.update import update

Array = NDArray[np.float64]

LEAST_WEIGHT = 1e-3  # hypotheses below this share of the best are dropped


class Hypothesis(NamedTuple):
    """One global hypothesis: its log-weight and its density."""

    log_weight: float
    density: PMB


@compiled
def associate(density, scan, model):
    """Everything of one hypothesis up to the choice of associations, and the log-evidence of the scan under
    it.
    """
    n = ue_size(density)
    prior = predict(density, model, scan.pace)
    local = local_hypotheses(prior, n, scan, model)
    log_term, log_new, position = new_hypotheses(prior, n, scan, local, model)
    distort(prior, local, log_new, model)
    associations, log_total = best_associations(local, log_new, model)
    chosen = worth_updating(associations, model.negligible)
    missed = 0.0
    for t in range(local.log_missed.shape[0]):
        missed += local.log_missed[t]
    return prior, local, log_term, log_new, position, associations, chosen, log_total + missed


@compiled
def update_single(prior, local, scan, chosen, index, log_term, log_new, position, model):
    """Posterior under one association, pruned, and its NIS."""
    n = ue_size(prior)
    only = Associations(np.zeros(1), chosen.track[index : index + 1].copy())
    posterior, log_weight, nis, rows = update(prior, n, local, scan, only, log_term, log_new, position, model)
    return prune(posterior, model.prune), nis, rows, name_tracks(prior, local, only, log_weight)


def step(mixture: list[Hypothesis], scan: Scan, model: Model, cap: int) -> tuple[list[Hypothesis], Info]:
    """One recursion (30) of the mixture, capped to its `cap` likeliest hypotheses; normalized, likeliest
    first.
    """
    candidates: list[tuple[float, int, int]] = []
    parts = []
    likeliest = predict(mixture[0].density, model, scan.pace)
    pass_over_splinters(likeliest, ue_size(likeliest), scan, model)
    for h, hypothesis in enumerate(mixture):
        part = associate(hypothesis.density, scan, model)
        parts.append(part)
        log_weights = part[6].log_weight
        candidates += [(hypothesis.log_weight + part[7] + w, h, a) for a, w in enumerate(log_weights)]
    candidates.sort(key=lambda c: -c[0])
    candidates = [c for c in candidates[:cap] if c[0] > candidates[0][0] + np.log(LEAST_WEIGHT)]
    log_weight = np.array([c[0] for c in candidates])
    log_weight -= np.logaddexp.reduce(log_weight)
    result, rows = [], []
    for w, (_, h, a) in zip(log_weight, candidates, strict=True):
        prior, local, log_term, log_new, position, _, chosen, _ = parts[h]
        posterior, nis, dof, named = update_single(prior, local, scan, chosen, a, log_term, log_new, position, model)
        result.append(Hypothesis(float(w), posterior))
        rows.append((named[1][0], named[2], nis, dof))
    info = Info(np.exp(log_weight), np.array([r[0] for r in rows]), rows[0][1], rows[0][2], rows[0][3])
    return result, info


def merged(mixture: list[Hypothesis]) -> PMB:
    """What is reported: the map of the likeliest hypothesis, the UE's moments over all of them."""
    best = mixture[0].density
    n = best.mean.size - 3 * (best.kind.size - 1)
    weights = np.exp([h.log_weight for h in mixture])
    means = np.array([h.density.mean[:n] for h in mixture])
    mean = weights @ means
    spread = sum(
        w * (h.density.covariance[:n, :n] + np.outer(m - mean, m - mean))
        for w, h, m in zip(weights, mixture, means, strict=True)
    )
    full_mean, full_covariance = best.mean.copy(), best.covariance.copy()
    full_mean[:n], full_covariance[:n, :n] = mean, spread
    return best._replace(mean=full_mean, covariance=full_covariance)


def run(
    scans: Scans,
    prior: tuple[Array, Array],
    motion: MotionModel,
    bs: Array,
    parameters: FilterParameters | None = None,
    height: float = 0.0,
    hypotheses: int = 20,
) -> tuple[History, Diagnostics]:
    """Filter a whole run with at most `hypotheses` global hypotheses; other parameters as in `ek_pmb.run`."""
    if hypotheses < 1:
        raise FilterError(f"pmbm: hypotheses is {hypotheses}; it must be at least 1")
    parameters = parameters or FilterParameters()
    model = compile_model(parameters, motion, bs, height)
    check_inputs(scans, parameters, model, *prior)
    mixture = [Hypothesis(0.0, initial_density(*prior))]
    n = motion.dimension
    means, covariances, tables, infos, passed = [], [], [], [], []
    for k in range(scans.steps):
        scan = scan_of(scans, k, parameters.doppler, motion.interval)
        mixture, info = step(mixture, scan, model, hypotheses)
        passed.append(np.isneginf(scan.log_snr).sum())
        posterior = merged(mixture)
        means.append(posterior.mean[:n])
        covariances.append(posterior.covariance[:n, :n])
        tables.append(map_table(posterior))
        infos.append(info)
    offsets = np.concatenate([[0], np.cumsum([len(table) for table in tables])]).astype(np.int64)
    diagnostics = Diagnostics(
        nis=np.array([i.nis for i in infos]),
        nis_rows=np.array([i.rows for i in infos], dtype=np.int64),
        weights=tuple(i.weight for i in infos),
        associations=tuple(i.track for i in infos),
        existence=tuple(i.existence for i in infos),
        passed_over=np.array(passed, dtype=np.int64),
    )
    return history_of(np.array(means), np.array(covariances), offsets, np.concatenate(tables)), diagnostics
