"""Loopy data association: marginal association probabilities by belief propagation, in the log domain.

K known features compete for M measurements; each feature takes at most one measurement and each measurement
has at most one source, a known feature or something new (a first detection or a false alarm). Messages of
Williams and Lau as in theory §5 (paper B [13], [19]):

    ζ_{k→m} = β_k(m) / (β_k(0) + Σ_{m'≠m} β_k(m') ν_{m'→k}),    ν_{m→k} = 1 / (ξ_m + Σ_{k'≠k} ζ_{k'→m}),

iterated until no ln ν moves by more than the tolerance; then p(a_k = m) ∝ β_k(m) ν_{m→k}, p(a_k = 0) ∝
β_k(0). A common factor of column m (β_k(m) for all k, and ξ_m) cancels, so densities may be handed over
relative to the false alarms. The sums are formed by excluding the own term, never as total minus own: β
ratios of 1e15 are usual and the difference would be rounding noise. The result is exact when the association
graph is a tree.

:func:`exact_association` sums over all joint associations (dynamic programming over measurement subsets) and
is the oracle of the tests.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dopslam.compute.compiled import compiled
from dopslam.errors import FilterError


@dataclass(frozen=True, slots=True)
class Association:
    """Result of data association.

    Attributes
    ----------
    log_nu : (K, M) message of measurement m to feature k, ln ν_{m→k}
    log_zeta : (K, M) message of feature k to measurement m, ln ζ_{k→m}
    marginal : (K, M + 1) p(a_k), column 0 = missed
    new : (M,) probability that no known feature generated measurement m
    iterations : rounds used
    converged : whether the tolerance was reached
    """

    log_nu: np.ndarray
    log_zeta: np.ndarray
    marginal: np.ndarray
    new: np.ndarray
    iterations: int
    converged: bool


def loopy_association(
    log_missed: np.ndarray,
    log_detected: np.ndarray,
    log_new: np.ndarray,
    tolerance: float = 1e-6,
    max_iterations: int = 1000,
) -> Association:
    """Approximate marginals of the association of K features with M measurements.

    Parameters
    ----------
    log_missed : (K,) ln β_k(0)
    log_detected : (K, M) ln β_k(m), −inf where impossible
    log_new : (M,) ln ξ_m, finite
    tolerance : largest change of ln ν in the last round
    max_iterations : rounds after which the current messages are returned with ``converged = False``

    Raises
    ------
    FilterError
        If the shapes disagree or a value is NaN.
    """
    log_missed, log_detected, log_new = (np.asarray(a, float) for a in (log_missed, log_detected, log_new))
    if log_detected.shape != (log_missed.size, log_new.size):
        raise FilterError(
            f"loopy_association: log_detected has shape {log_detected.shape}, expected "
            f"{(log_missed.size, log_new.size)} from log_missed and log_new"
        )
    for name, value in (("log_missed", log_missed), ("log_detected", log_detected), ("log_new", log_new)):
        if np.isnan(value).any() or np.isposinf(value).any():
            raise FilterError(f"loopy_association: {name} holds NaN or +inf; check the likelihoods handed over")
    ordered = (np.ascontiguousarray(a) for a in (log_missed, log_detected, log_new))
    nu, zeta, marginal, new, iterations, converged = associate(*ordered, tolerance, max_iterations)
    return Association(
        log_nu=nu, log_zeta=zeta, marginal=marginal, new=new, iterations=int(iterations), converged=bool(converged)
    )


@compiled
def _logaddexp(a, b):
    if a < b:
        a, b = b, a
    if b == -np.inf:
        return a
    return a + np.log1p(np.exp(b - a))


@compiled
def _iterate(log_missed, log_detected, log_new, tolerance, max_iterations):
    """Message passing; exclusive sums as prefix plus suffix."""
    features, measurements = log_detected.shape
    nu = np.empty((features, measurements))
    zeta = np.full((features, measurements), -np.inf)
    for m in range(measurements):
        nu[:, m] = -log_new[m]
    suffix = np.empty(max(features, measurements) + 1)
    iterations = 0
    converged = features == 0 or measurements == 0
    while not converged and iterations < max_iterations:
        iterations += 1
        for k in range(features):
            suffix[measurements] = -np.inf
            for m in range(measurements - 1, -1, -1):
                suffix[m] = _logaddexp(suffix[m + 1], log_detected[k, m] + nu[k, m])
            prefix = log_missed[k]
            for m in range(measurements):
                zeta[k, m] = log_detected[k, m] - _logaddexp(prefix, suffix[m + 1])
                prefix = _logaddexp(prefix, log_detected[k, m] + nu[k, m])
        change = 0.0
        for m in range(measurements):
            suffix[features] = -np.inf
            for k in range(features - 1, -1, -1):
                suffix[k] = _logaddexp(suffix[k + 1], zeta[k, m])
            prefix = log_new[m]
            for k in range(features):
                value = -_logaddexp(prefix, suffix[k + 1])
                change = max(change, abs(value - nu[k, m]))
                nu[k, m] = value
                prefix = _logaddexp(prefix, zeta[k, m])
        converged = change < tolerance
    return nu, zeta, iterations, converged


@compiled
def _shares(first, rest, result):
    """exp of (first, rest…) over its sum, into result (1 + len(rest),)."""
    top = first
    for value in rest:
        top = max(top, value)
    result[0] = np.exp(first - top)
    total = result[0]
    for i in range(rest.shape[0]):
        result[1 + i] = np.exp(rest[i] - top)
        total += result[1 + i]
    for i in range(rest.shape[0] + 1):
        result[i] /= total


@compiled
def associate(log_missed, log_detected, log_new, tolerance, max_iterations):
    """:func:`loopy_association` for compiled code, which sees to its inputs itself: the fields of :class:`Association`."""
    features, measurements = log_detected.shape
    nu, zeta, iterations, converged = _iterate(log_missed, log_detected, log_new, tolerance, max_iterations)
    marginal, new = np.empty((features, measurements + 1)), np.empty(measurements)
    weight, column = np.empty(max(features, measurements)), np.empty(1 + features)
    for k in range(features):
        for m in range(measurements):
            weight[m] = log_detected[k, m] + nu[k, m]
        _shares(log_missed[k], weight[:measurements], marginal[k])
    for m in range(measurements):
        for k in range(features):
            weight[k] = zeta[k, m]
        _shares(log_new[m], weight[:features], column)
        new[m] = column[0]
    return nu, zeta, marginal, new, iterations, converged


def exact_association(log_missed: np.ndarray, log_detected: np.ndarray, log_new: np.ndarray) -> np.ndarray:
    """Exact marginals p(a_k), (K, M + 1) with column 0 = missed: the sum over every joint association.

    Forward and backward sums over subsets of used measurements: K·2^M·M operations, for M up to about 14.
    """
    log_missed, log_detected, log_new = (np.asarray(a, float) for a in (log_missed, log_detected, log_new))
    features, measurements = log_detected.shape
    if measurements > 16:
        raise FilterError(f"exact_association: {measurements} measurements need 2^{measurements} subsets; at most 16")
    # Divide measurement m by ξ_m and row k by its largest entry: neither changes the marginals.
    log_ratio = log_detected - log_new
    top = np.maximum(log_missed, log_ratio.max(axis=1, initial=-np.inf))
    missed, detected = np.exp(log_missed - top), np.exp(log_ratio - top[:, None])
    subsets = np.arange(2**measurements)
    free = [subsets[(subsets >> m) & 1 == 0] for m in range(measurements)]
    forward = np.zeros((features + 1, subsets.size))  # used by features before k
    forward[0, 0] = 1.0
    for k in range(features):
        forward[k + 1] = missed[k] * forward[k]
        for m in range(measurements):
            forward[k + 1, free[m] | (1 << m)] += detected[k, m] * forward[k, free[m]]
    backward = np.zeros((features + 1, subsets.size))  # weight of features from k on, given what is used
    backward[features] = 1.0
    for k in range(features - 1, -1, -1):
        backward[k] = missed[k] * backward[k + 1]
        for m in range(measurements):
            backward[k, free[m]] += detected[k, m] * backward[k + 1, free[m] | (1 << m)]
    marginal = np.zeros((features, measurements + 1))
    for k in range(features):
        marginal[k, 0] = missed[k] * forward[k] @ backward[k + 1]
        for m in range(measurements):
            marginal[k, m + 1] = detected[k, m] * forward[k, free[m]] @ backward[k + 1, free[m] | (1 << m)]
    return marginal / marginal.sum(axis=1, keepdims=True)
