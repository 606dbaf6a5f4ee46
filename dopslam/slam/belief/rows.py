"""Likelihood rows of one step of the Rao-Blackwellized filter, the predictions before and the estimates after it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dopslam.models.measurement import wrap
from dopslam.slam.belief.belief import amplitude_messages
from dopslam.slam.belief.motion import BIAS, HEADING, POSITION, VELOCITY
from dopslam.slam.belief.records import Estimate, Features, Form, Parameters, Scan


@dataclass(frozen=True, slots=True)
class Rows:
    """One step's likelihood rows: the line of sight (row 0), then every (feature, type)."""

    form: np.ndarray  # (R,)
    owner: np.ndarray  # (R,) 0 line of sight, 1 + k feature k
    mean: np.ndarray  # (R, 3)
    covariance: np.ndarray  # (R, 3, 3)
    log_missed: np.ndarray  # (R,)
    first: np.ndarray  # (R + 1,)
    pair: np.ndarray  # (L,) measurement
    scale: np.ndarray  # (L,)
    log_weight: np.ndarray  # (L,)


@dataclass(frozen=True, slots=True)
class Amplitudes:
    """Amplitude messages of line of sight and features, owners (K + 1) × measurements (M)."""

    log_evidence: np.ndarray
    mean: np.ndarray
    variance: np.ndarray
    log_missed: np.ndarray
    missed_mean: np.ndarray
    missed_variance: np.ndarray
    scale: np.ndarray  # 1/σ at the filtered amplitude over 1/σ at the measured one


def kernel_agent(agent: np.ndarray) -> np.ndarray:
    heading = agent[:, HEADING]
    return np.column_stack([agent[:, POSITION], agent[:, BIAS], np.cos(heading), np.sin(heading)])


def thinned(weight: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Evenly strided particles and their renormalized weights."""
    index = np.arange(0, len(weight), max(1, len(weight) // size))
    total = weight[index].sum()
    if total <= 0:
        index, total = np.arange(len(weight)), weight.sum()
    return index, weight[index] / total


def predict(parameters: Parameters, features: Features, sight: np.ndarray) -> tuple[Features, np.ndarray]:
    """Survival, type chain W ← p_s W [Q], random walks; the line of sight may vanish and return."""
    walk = np.zeros((3, 3))
    axes = 3 if parameters.spatial else 2
    walk[range(axes), range(axes)] = parameters.position_walk**2
    amplitude = features.amplitude.copy()
    amplitude[:, 1] += (parameters.amplitude_walk * amplitude[:, 0]) ** 2
    predicted = Features(
        features.label,
        parameters.survival * features.weight @ parameters.transition,
        features.mean,
        features.covariance + walk,
        amplitude,
    )
    exists = parameters.survival * sight[0] + parameters.return_probability * (1 - sight[0])
    return predicted, np.array([exists, sight[1], sight[2] + (parameters.amplitude_walk * sight[1]) ** 2])


def amplitudes_of(parameters: Parameters, features: Features, sight: np.ndarray, scan: Scan) -> Amplitudes:
    """Amplitude messages with the reacquisition mixture (g3)."""
    prior = np.vstack([sight[1:], features.amplitude])
    log_a, mean, variance, log_missed, missed_mean, missed_variance = amplitude_messages(
        parameters.amplitude, prior[:, 0], prior[:, 1], scan.amplitude
    )
    share = parameters.reacquisition
    if share > 0:
        log_uniform = np.log(share / parameters.amplitude_end)
        known = np.log1p(-share) + log_a
        log_a = np.logaddexp(known, log_uniform)
        p = np.exp(known - log_a)
        z, fresh = scan.amplitude[None, :], parameters.amplitude.variance(scan.amplitude)[None, :]
        mixed = p * mean + (1 - p) * z
        variance = p * (variance + (mean - mixed) ** 2) + (1 - p) * (fresh + (z - mixed) ** 2)
        mean = mixed
    scale = mean / scan.amplitude if parameters.rescale_covariance else np.ones_like(mean)
    return Amplitudes(log_a, mean, variance, log_missed, missed_mean, missed_variance, scale)


def row_arrays(parameters: Parameters, features: Features):
    types = np.array(parameters.types, dtype=np.int64)
    count = len(features)
    form = np.concatenate([[int(Form.LOS)], np.tile(types, count)]).astype(np.int64)
    mean = np.concatenate([parameters.anchor[None], features.mean.reshape(-1, 3)])
    covariance = np.concatenate([np.zeros((1, 3, 3)), features.covariance.reshape(-1, 3, 3)])
    owner = np.concatenate([[0], 1 + np.repeat(np.arange(count), types.size)]).astype(np.int64)
    return form, mean, covariance, owner


def rows_of(
    parameters: Parameters, gate: float, features, amplitudes: Amplitudes, association, scan, log_false_alarm
) -> Rows:
    """Gated association lists: the pairs whose probability exceeds the gate, for every type of the owner."""
    form, mean, covariance, owner = row_arrays(parameters, features)
    likely = association.marginal[:, 1:] > gate
    lists = [np.flatnonzero(row) for row in likely]
    first = np.concatenate([[0], np.cumsum([lists[k].size for k in owner])]).astype(np.int64)
    pair = np.concatenate([lists[k] for k in owner]).astype(np.int64)
    who = np.repeat(owner, np.diff(first))
    log_weight = association.log_nu[who, pair] + amplitudes.log_evidence[who, pair] - log_false_alarm[pair]
    uniform = np.log(2 * np.pi if scan.tangents == 1 else 4 * np.pi)
    log_weight -= np.where(np.repeat(form, np.diff(first)) == Form.VA, uniform, 0.0)
    missed, scale = amplitudes.log_missed[owner], amplitudes.scale[who, pair]
    return Rows(form, owner, mean, covariance, missed, first, pair, scale, log_weight)


def owner_messages(log_rows: np.ndarray, weight: np.ndarray, types: int) -> np.ndarray:
    """ln γ_k(i) (K + 1, N) from the rows' ln λ and the weights W (K + 1, T)."""
    log_w = np.log(np.maximum(weight, 1e-300))
    log_none = np.log(np.maximum(1 - weight.sum(axis=1), 1e-12))
    result = np.empty((len(weight), log_rows.shape[1]))
    result[0] = np.logaddexp(log_w[0, 0] + log_rows[0], log_none[0])
    by_type = log_rows[1:].reshape(len(weight) - 1, types, log_rows.shape[1]) + log_w[1:, :, None]
    result[1:] = np.logaddexp(np.logaddexp.reduce(by_type, axis=1), log_none[1:, None])
    return result


def amplitude_posterior(rows: Rows, share: np.ndarray, amplitudes: Amplitudes, types: int) -> np.ndarray:
    """(K + 1, 2) mean and variance of the amplitude, matched over missed and associated measurements."""
    result = np.empty((len(share), 2))
    for k in range(len(share)):
        row = 0 if k == 0 else 1 + (k - 1) * types
        pairs = rows.pair[rows.first[row] : rows.first[row + 1]]
        p = share[k, : 1 + pairs.size]
        total = p.sum()
        p = p / total if total > 1e-280 else np.r_[1.0, np.zeros(pairs.size)]
        mean = np.append(amplitudes.missed_mean[k], amplitudes.mean[k, pairs])
        variance = np.append(amplitudes.missed_variance[k], amplitudes.variance[k, pairs])
        result[k, 0] = p @ mean
        result[k, 1] = p @ (variance + (mean - result[k, 0]) ** 2)
    return result


def estimate_of(parameters: Parameters, agent: np.ndarray, weight: np.ndarray, features: Features) -> Estimate:
    """MMSE estimates (16)–(18) of the agent and of the declared features."""
    position = weight @ agent[:, POSITION]
    centered = agent[:, POSITION] - position
    phasor = weight @ np.exp(1j * agent[:, HEADING])
    heading = float(np.angle(phasor))
    bias = float(weight @ agent[:, BIAS])
    offset = np.column_stack([centered[:, :2], wrap(agent[:, HEADING] - heading), agent[:, BIAS] - bias])
    declared = features.select(features.existence > parameters.detection_threshold)
    belief = declared.weight / declared.existence[:, None]
    best = belief.argmax(axis=1)
    index = np.arange(len(declared))
    return Estimate(
        position=position,
        covariance=(weight[:, None] * centered).T @ centered,
        velocity=weight @ agent[:, VELOCITY],
        heading=heading,
        heading_deviation=float(np.sqrt(max(-2 * np.log(min(abs(phasor), 1.0)), 0.0))),
        bias=bias,
        state_covariance=(weight[:, None] * offset).T @ offset,
        label=declared.label,
        existence=declared.existence,
        type_belief=belief,
        feature=declared.mean[index, best],
        feature_covariance=declared.covariance[index, best],
        amplitude=declared.amplitude[:, 0],
    )
