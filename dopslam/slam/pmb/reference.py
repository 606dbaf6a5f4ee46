"""The EK-PMB filter of paper A, Section IV, in plain NumPy: the twin that the compiled filter is compared with.

Written to be read beside the paper, not to be fast (some milliseconds a step instead of 70 µs). The density is (26):
a Poisson process of undetected landmarks with intensity λ (27) and one multi-Bernoulli (28), (29) of the detected ones.
A *block* is one type hypothesis (VA or SP) of a *track* i; its weight is r^i μ^m, existence times type probability. All
blocks and the receiver share one Gaussian over [s; x_1; …]; the paper's filter drops its cross-covariances after every step.

It covers what the paper has: the extended Kalman filter, optionally iterated, p_D constant with a range of scatter points,
an intensity that is constant, no clues from strengths. :func:`paper` gives the compiled filter the same choices.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.optimize import linear_sum_assignment
from scipy.special import logsumexp

from dopslam.errors import FilterError
from dopslam.models.detection import ConstantDetection
from dopslam.models.measurement import BS, VA, residual
from dopslam.models.motion import propagate, transition_jacobian
from dopslam.models.scans import Scans
from dopslam.slam.pmb.birth import OUTWEIGHED, REDUNDANT_LIMIT, TWIN
from dopslam.slam.pmb.density import BS_TRACK, FilterParameters
from dopslam.slam.pmb.newborn import RARE
from dopslam.slam.pmb.reference_single import Setting, detection_probability, fit, linearize, starting_point, there

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Density:
    """The receiver and the detected landmarks of (26): one Gaussian, and r^i μ^m of every block; block 0 is the BS.

    Attributes
    ----------
    mean, covariance : (n + 3 H,), (n + 3 H, n + 3 H)
    kind, weight, track : (H + 1,); the types of a track lie side by side
    """

    mean: Array
    covariance: Array
    kind: NDArray[np.int64]
    weight: Array
    track: NDArray[np.int64]

    @property
    def n(self) -> int:
        """Number of receiver states."""
        return len(self.mean) - 3 * (len(self.kind) - 1)

    def rows(self, block: int) -> slice:
        """Entries of a landmark in the Gaussian."""
        return slice(self.n + 3 * (block - 1), self.n + 3 * block)

    def tracks(self) -> list[NDArray[np.int64]]:
        """Blocks of every track, the BS first."""
        return [np.flatnonzero(self.track == t) for t in dict.fromkeys(self.track.tolist())]


class Seen(NamedTuple):
    """One scan: measurements (M, m), their R (M, m, m), clutter intensity c(z)."""

    z: Array
    noise: Array
    clutter: float


class Local(NamedTuple):
    """p_D (H + 1,) of every block; ln(r μ p_D N(z; ẑ, S)) (M, H + 1); ln ρ^{i,0} (T,); ln(ρ^{i,p}/ρ^{i,0}) (M, T)."""

    probability: Array
    log_detected: Array
    log_missed: Array
    log_ratio: Array


class Births(NamedTuple):
    """ln of each type's birth integral (M, 2), ln ρ^{new,p} = ln(c + their sum) (M,), the landmark (M, 2, 3) of each."""

    log_term: Array
    log_new: Array
    point: Array


def paper(parameters: FilterParameters) -> FilterParameters:
    """The choices of a compiled filter without what it has beyond the paper."""
    only = {"robust": np.inf, "outlier": 0.0, "inform": False, "lazy": False, "hide": 0.0}
    only |= {"merge": False, "curvature": False, "unconfirmed": parameters.existence_limit}
    return replace(parameters, intensity=parameters.intensity[:2], **only)


def step(posterior: Density, scan: Scans, setting: Setting, first: int = 0) -> tuple[Density, Array]:
    """One recursion (30): the next posterior, and the weights of its γ data associations.

    Parameters
    ----------
    scan : of one step; ``first`` is the number of its first measurement in the run, by which new tracks are named
    """
    m = 6 if setting.parameters.doppler else 5
    seen = Seen(scan.z[:, :m], scan.covariance[:, :m, :m], scan.clutter_intensity(m == 6))
    prior = predict(posterior, setting)
    local = local_hypotheses(prior, seen, setting)
    births = birth_hypotheses(prior, seen, local, setting)
    weight, chosen = associations(local.log_ratio, births.log_new, setting.parameters)
    born = newborns(weight, chosen, births, setting.parameters)
    components = []
    for association in chosen:
        updated = joint_update(prior, seen, association, local, setting)
        updated = replace(updated, weight=weights_after(prior, association, local))
        components.append(give_birth(updated, born, association, seen, births, first, setting))
    return prune(project(weight, components, setting), setting.parameters), weight


def predict(density: Density, setting: Setting) -> Density:
    """f(s_{k+1} | Z_{1:k}) by (1): ŝ ← f(ŝ), P ← F P Fᵀ + Q; r ← p_S r; landmarks stand still."""
    n, motion = density.n, setting.motion
    mean, transition = density.mean.copy(), np.eye(len(density.mean))
    transition[:n, :n] = transition_jacobian(density.mean[:n], motion)
    mean[:n] = propagate(density.mean[:n], motion)
    covariance = transition @ density.covariance @ transition.T
    covariance[:n, :n] += motion.process_noise
    weight = density.weight * np.where(density.kind == BS, 1.0, setting.parameters.survival)
    return replace(density, mean=mean, covariance=covariance, weight=weight)


def stacked(mean: Array, density: Density, block: int, setting: Setting, m: int) -> tuple[Array, Array]:
    """h of one block at a point, and its rows H = [A 0 … B … 0] over the whole Gaussian."""
    x = mean[density.rows(block)] if block else setting.bs
    h, by_state, by_landmark = linearize(mean[: density.n], x, int(density.kind[block]), setting, m)
    rows = np.zeros((m, len(mean)))
    rows[:, : density.n] = by_state
    if block:
        rows[:, density.rows(block)] = by_landmark
    return h, rows


def local_hypotheses(prior: Density, seen: Seen, setting: Setting) -> Local:
    """Missed and detected terms of all tracks: sums over the types of each, -∞ outside the gate."""
    n, (count, m) = prior.n, seen.z.shape
    probability, log_detected = np.zeros(len(prior.kind)), np.full((count, len(prior.kind)), -np.inf)
    for b, kind in enumerate(prior.kind):
        if b == 0:
            probability[b] = setting.detection.probability
        elif there(prior.mean[:n], prior.mean[prior.rows(b)], kind, setting):
            apart = np.zeros((3, len(prior.mean)))  # the vector from the receiver to the landmark
            apart[:, prior.rows(b)], apart[:2, :2] = np.eye(3), -np.eye(2)
            spread = apart @ prior.covariance @ apart.T
            probability[b] = detection_probability(prior.mean[prior.rows(b)], spread, prior.mean[:n], kind, setting)
        if probability[b] * prior.weight[b] <= 1e-12:
            continue
        h, rows = stacked(prior.mean, prior, b, setting, m)
        for p in range(count):
            innovation = rows @ prior.covariance @ rows.T + seen.noise[p]
            nu = residual(seen.z[p], h)
            distance = nu @ np.linalg.solve(innovation, nu)
            if distance < setting.parameters.gate:
                log_density = -0.5 * (distance + np.linalg.slogdet(2 * np.pi * innovation)[1])
                log_detected[p, b] = np.log(prior.weight[b] * probability[b]) + log_density
    tracks = prior.tracks()
    log_missed = np.array([np.log(max(1 - prior.weight[b] @ probability[b], 1e-12)) for b in tracks])
    log_ratio = np.stack([logsumexp(log_detected[:, b], axis=1) for b in tracks], axis=1) - log_missed
    return Local(probability, log_detected, log_missed, log_ratio)


def birth_hypotheses(prior: Density, seen: Seen, local: Local, setting: Setting) -> Births:
    """∫ p_D N(z; h(x, ŝ), R̃) λ dx by Laplace's method: p_D λ (2π)^{(3 - m)/2} |R̃|^{-1/2} |BᵀR̃⁻¹B|^{-1/2} exp(-χ²_min/2).

    A birth that the best track outweighs e⁹ times is left out where that is plain early: the filter's only shortcut.
    """
    n, parameters, (count, m) = prior.n, setting.parameters, seen.z.shape
    state, spread = prior.mean[:n], prior.covariance[:n, :n]
    log_term, point = np.full((count, 2), -np.inf), np.zeros((count, 2, 3))
    for p in range(count):
        outweighed, twin = local.log_ratio[p].max() - OUTWEIGHED, np.inf
        for t, intensity in enumerate(np.add(parameters.intensity[:2], parameters.birth_intensity)):
            most = np.log(intensity) + 0.5 * (3 - m) * np.log(2 * np.pi)
            x = starting_point(seen.z[p], state, VA + t, setting)
            if x is None or (t == 1 and twin + TWIN + most < outweighed):
                continue
            found = fit(seen.z[p], seen.noise[p], state, spread, VA + t, x, outweighed - most, setting)
            if found is None or not found.chi2 < REDUNDANT_LIMIT:
                continue
            point[p, t], twin = found.x, found.log_volume - 0.5 * found.chi2
            with np.errstate(divide="ignore"):  # a scatter point out of range
                detected = np.log(detection_probability(found.x, found.own, state, VA + t, setting))
            log_term[p, t] = detected + most + twin
    return Births(log_term, np.logaddexp(np.log(seen.clutter), logsumexp(log_term, axis=1)), point)


def associations(log_ratio: Array, log_new: Array, parameters: FilterParameters) -> tuple[Array, NDArray[np.int64]]:
    """Weights (g,) and tracks (g, M) of the γ best data associations, by Murty's method; -1: new or clutter."""
    count, tracks = log_ratio.shape
    cost = np.hstack([-log_ratio, np.where(np.eye(count, dtype=bool), -log_new[:, None], np.inf)])
    found, open_ = [], [_solved(cost)]
    while open_ and len(found) < parameters.associations:
        open_.sort(key=lambda problem: problem[0])
        total, columns, part = open_.pop(0)
        found.append((total, np.where(columns < tracks, columns, -1)))
        for row in range(count):  # every other solution differs first in one of the rows
            open_ += [_solved(_without(part, row, columns[row]))]
            part = part.copy()
            part[row, np.arange(part.shape[1]) != columns[row]] = np.inf
        open_ = [problem for problem in open_ if np.isfinite(problem[0])]
    weight = np.exp(found[0][0] - np.array([total for total, _ in found]))
    kept = weight >= parameters.negligible
    return weight[kept] / weight[kept].sum(), np.array([tracks for _, tracks in found])[kept].reshape(kept.sum(), count)


def _without(cost: Array, row: int, column: int) -> Array:
    result = cost.copy()
    result[row, column] = np.inf
    return result


def _solved(cost: Array) -> tuple[float, NDArray[np.int64], Array]:
    try:
        rows, columns = linear_sum_assignment(cost)
    except ValueError:  # infeasible
        return np.inf, np.zeros(0, np.int64), cost
    return float(cost[rows, columns].sum()), columns, cost


def newborns(
    weight: Array, chosen: NDArray[np.int64], births: Births, parameters: FilterParameters
) -> list[tuple[int, int]]:
    """Measurement and type of every birth that is not negligible over all associations, the likeliest first."""
    new = ((chosen < 0) * weight[:, None]).sum(axis=0)
    share = new[:, None] * np.exp(births.log_term - births.log_new[:, None])
    least = parameters.prune
    order = np.argsort(-births.log_new)
    return [(p, t) for p in order for t in range(2) if share[p].sum() >= least and share[p, t] >= RARE * least]


def joint_update(prior: Density, seen: Seen, association: Array, local: Local, setting: Setting) -> Density:
    """One EKF update of [s; x_1; …] with all measurements that a data association gives to tracks, stacked.

    The likelier type of a track enters; the other gets an update of its own afterwards, which moves nothing else.
    """
    tracks, m = prior.tracks(), seen.z.shape[1]
    pairs = [
        (p, t, tracks[t][np.argmax(local.log_detected[p, tracks[t]])]) for p, t in enumerate(association) if t >= 0
    ]
    mean, covariance = prior.mean.copy(), prior.covariance.copy()
    for _ in range(setting.parameters.iterations if pairs else 0):
        parts = [stacked(mean, prior, b, setting, m) for _, _, b in pairs]
        h = np.vstack([rows for _, rows in parts])
        nu = np.concatenate([residual(seen.z[p], part[0]) for (p, _, _), part in zip(pairs, parts, strict=True)])
        r = np.asarray(block_diag(*(seen.noise[p] for p, _, _ in pairs)))
        gain = np.asarray(np.linalg.solve(h @ prior.covariance @ h.T + r, h @ prior.covariance)).T
        mean = prior.mean + gain @ (nu - h @ (prior.mean - mean))
        covariance = prior.covariance - gain @ h @ prior.covariance
    for p, t, used in pairs:
        for b in tracks[t]:
            if b != used and local.log_detected[p, b] > -np.inf:
                predicted, h = stacked(mean, prior, b, setting, m)
                gain = np.linalg.solve(h @ covariance @ h.T + seen.noise[p], h @ covariance).T
                own = prior.rows(b)
                mean[own] += gain[own] @ residual(seen.z[p], predicted)
                covariance[own] -= gain[own] @ h @ covariance
                covariance[:, own] = covariance[own].T
    return replace(prior, mean=mean, covariance=covariance)


def weights_after(prior: Density, association: Array, local: Local) -> Array:
    """r'μ' of every block: r μ (1 - p_D)/ρ^{i,0} where its track was missed, its share of ρ^{i,p} where it was detected."""
    weight = prior.weight.copy()
    for t, blocks in enumerate(prior.tracks()):
        by = np.flatnonzero(association == t)
        if t > 0 and len(by):
            total = local.log_ratio[by[0], t] + local.log_missed[t]
            weight[blocks] = np.exp(local.log_detected[by[0], blocks] - total)
        elif t > 0:
            weight[blocks] *= (1 - local.probability[blocks]) / np.exp(local.log_missed[t])
    return weight


def give_birth(
    density: Density,
    born: list[tuple[int, int]],
    association: Array,
    seen: Seen,
    births: Births,
    first: int,
    setting: Setting,
) -> Density:
    """The density with the newborn: where the updated receiver makes them be, their errors -G(A e_s + ε) with all that
    follows for the cross-covariances; the receiver stays."""
    n, old = density.n, len(density.mean)
    mean, covariance = np.zeros(old + 3 * len(born)), np.zeros((old + 3 * len(born), old + 3 * len(born)))
    mean[:old], covariance[:old, :old] = density.mean, density.covariance
    state, spread, weight = mean[:n], covariance[:n, :n].copy(), np.zeros(len(born))
    for c, (p, t) in enumerate(born):
        own, before = slice(old + 3 * c, old + 3 * c + 3), slice(0, old + 3 * c)
        mean[own], covariance[own, own] = births.point[p, t], np.eye(3)
        if association[p] >= 0:  # explained otherwise here: weight zero
            continue
        weight[c] = np.exp(births.log_term[p, t] - births.log_new[p])
        found = fit(seen.z[p], seen.noise[p], state, spread, VA + t, births.point[p, t], -np.inf, setting)
        if found is None:  # the updated receiver makes the path impossible: somewhere there
            start = starting_point(seen.z[p], state, VA + t, setting)
            mean[own], covariance[own, own] = births.point[p, t] if start is None else start, 100.0 * np.eye(3)
            continue
        mean[own] = found.x
        pull = -found.gain @ linearize(state, found.x, VA + t, setting, seen.z.shape[1])[1]
        covariance[own, before] = pull @ covariance[:n, before]
        covariance[before, own] = covariance[own, before].T
        covariance[own, own] = found.gain @ seen.noise[p] @ found.gain.T + pull @ spread @ pull.T
    kind, track = [VA + t for _, t in born], [first + p for p, _ in born]
    kinds, tracks = (np.append(a, np.array(b, np.int64)) for a, b in ((density.kind, kind), (density.track, track)))
    return Density(mean, covariance, kinds, np.append(density.weight, weight), tracks)


def project(weight: Array, components: list[Density], setting: Setting) -> Density:
    """PMBM to PMB: moments over the associations, a block's by the associations in which it exists; then (31), (32)."""
    one, weights = components[0], np.array([c.weight for c in components])
    total = weight @ weights
    share = np.where(total > 0, weight[:, None] * weights / np.where(total > 0, total, 1.0), 1.0 / len(weight))
    share = np.hstack([np.repeat(share[:, :1], one.n, axis=1), np.repeat(share[:, 1:], 3, axis=1)])
    mean = sum((s * c.mean for s, c in zip(share, components, strict=True)), np.zeros(len(one.mean)))
    covariance = sum(
        np.outer(np.sqrt(s), np.sqrt(s)) * (c.covariance + np.outer(c.mean - mean, c.mean - mean))
        for s, c in zip(share, components, strict=True)
    )
    if not setting.parameters.joint:
        owner = np.append(np.zeros(one.n), np.repeat(np.arange(1, len(one.kind)), 3))
        covariance = np.where(owner[:, None] == owner, covariance, 0.0)
    for blocks in one.tracks()[1:]:
        total[blocks] *= min(1.0, setting.parameters.existence_limit / max(total[blocks].sum(), 1e-300))
    return replace(one, mean=mean, covariance=covariance, weight=total)


def prune(density: Density, parameters: FilterParameters) -> Density:
    """Without the tracks that hardly exist, and without the types of a track that are much rarer still."""
    existence = np.array([density.weight[density.track == t].sum() for t in density.track])
    kept = (existence >= parameters.prune) & (density.weight >= RARE * parameters.prune)
    kept[0] = True
    rows = np.append(np.full(density.n, True), np.repeat(kept[1:], 3))
    kind, weight, track = density.kind[kept], density.weight[kept], density.track[kept]
    return Density(density.mean[rows], density.covariance[np.ix_(rows, rows)], kind, weight, track)


def run(scans: Scans, prior: tuple[Array, Array], setting: Setting) -> list[tuple[Density, Array]]:
    """Posterior and association weights after every scan.

    Raises
    ------
    FilterError
        If the choices are not those of the paper (:func:`paper`).
    """
    told = setting.parameters
    if told.cubature or told.reweight or told.thinning or not isinstance(told.detection, ConstantDetection):
        raise FilterError(
            "the reference filter has no cubature, no reweighting, no thinning and a constant p_D only; use the compiled one"
        )
    mean, covariance = (np.array(part, float) for part in prior)
    density = Density(mean, covariance, np.array([BS]), np.ones(1), np.array([BS_TRACK]))
    result = []
    for k in range(scans.steps):
        density, weight = step(density, scans.take([k]), setting, scans.rows(k).start)
        result.append((density, weight))
    return result
