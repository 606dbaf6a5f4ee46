"""Stacked-particle belief-propagation SLAM, the implementation that paper B describes (in the plane).

Agent and features are particles, coupled by index: particle i of a feature is evaluated with particle i of
the agent, after a random permutation that keeps copies of one ancestor apart. Each type of a feature has its
own particle set (a scatterer's position is meaningless as a virtual anchor's). The likelihoods run on a
backend of :mod:`dopslam.slam.bp.likelihood`; everything else is linear-time NumPy and compiled loops.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dopslam.compiled import compiled
from dopslam.models.amplitude import Radio
from dopslam.slam.bp.belief import effective_size, normalized, systematic
from dopslam.slam.bp.births import births, order_for
from dopslam.slam.bp.likelihood import Backend, Constants
from dopslam.slam.bp.motion import BIAS, HEADING, POSITION, Motion
from dopslam.slam.bp.records import Features, Form, Info, Parameters, Scan
from dopslam.slam.bp.rows import estimate_of
from dopslam.slam.loopy import loopy_association

_BIRTH_AGENTS = 500


@dataclass(frozen=True, slots=True)
class StackedState:
    """Agent (N, 8) with log weights (N,), features' particles (T, 3, K, N) = x, y [m], u; labels (K,),
    weights (K, T); the line of sight's existence and amplitude particles (N,)."""

    agent: np.ndarray
    log_weight: np.ndarray
    particles: np.ndarray
    label: np.ndarray
    weight: np.ndarray
    sight: float
    sight_amplitude: np.ndarray
    next_label: int


@dataclass(frozen=True)
class Stacked:
    """The filter: parameters only; ``init`` and ``step`` are pure.

    parameters, motion, radio : the models; backend : of :func:`dopslam.slam.bp.likelihood.backend`
    """

    parameters: Parameters
    motion: Motion
    radio: Radio
    backend: Backend

    def init(self, agent: np.ndarray, log_weight: np.ndarray, sight_amplitude: float | None = None) -> StackedState:
        """State before the first step.

        ``sight_amplitude`` is a first guess of the line of sight's amplitude, ±10 %. Without it the amplitude
        is uniform, and since every agent particle carries one, most of them are lost to it in the first step.
        """
        types, size = len(self.parameters.types), len(agent)
        share = ((np.arange(size) * _stride(size)) % size + 0.5) / size  # independent of the particles' order
        if sight_amplitude is None:
            u = 1.0 + share * (0.5 * self.parameters.amplitude_end - 1.0)
        else:
            u = sight_amplitude * (0.9 + 0.2 * share)
        return StackedState(
            np.array(agent, float), np.array(log_weight, float), np.zeros((types, 3, 0, size), np.float32),
            np.zeros(0, int), np.zeros((0, types)), 0.9, u.astype(np.float32), 0,
        )  # fmt: skip

    def step(self, rng: np.random.Generator, state: StackedState, scan: Scan) -> tuple[StackedState, Info]:
        """Predict, evaluate (pass 1), associate, update (pass 2), resample, add births, prune, estimate."""
        parameters, types = self.parameters, self.parameters.types
        constants = Constants.of(self.radio, parameters.amplitude, parameters.anchor)
        agent = self.motion.predict(rng, state.agent)
        size = len(agent)
        if np.any(state.log_weight):  # weighted start
            agent = agent[systematic(rng, normalized(state.log_weight), size)]
        agent = agent[rng.permutation(size)]  # copies of one ancestor meet different feature particles
        particles, sight_u = _predict(rng, parameters, state.particles, state.sight_amplitude)
        weight = parameters.survival * state.weight @ parameters.transition
        sight = parameters.survival * state.sight + parameters.return_probability * (1 - state.sight)
        stacked = _stacked_agent(agent)
        groups = [(Form.LOS, _sight_rows(parameters, sight_u)), *zip(types, particles, strict=True)]

        log_false_alarm = parameters.log_false_alarm(scan)
        means = [self.backend.evidence(form, *rows, stacked, scan, constants) for form, rows in groups]
        log_c = self._birth_evidence(rng, agent, scan)
        association = _associate(weight, sight, means, groups, constants, log_false_alarm, log_c)

        nu = np.exp(np.minimum(association.log_nu, 80.0))
        nu[association.marginal[:, 1:] < 1e-7] = 0.0
        sight_lam = self.backend.messages(Form.LOS, *groups[0][1], stacked, scan, nu[:1], constants)
        lam = np.empty((len(types), len(weight), size), np.float32)
        for t, (form, rows) in enumerate(groups[1:]):
            lam[t] = self.backend.messages(form, *rows, stacked, scan, nu[1:], constants)
        log_weight = np.log(np.maximum(sight * sight_lam[0].astype(float) + 1 - sight, 1e-300))
        exists = weight.sum(axis=1)
        _add_log_gammas(log_weight, lam, weight, np.maximum(1 - exists, 0.0))
        normal = normalized(log_weight)

        evidence = lam.mean(axis=2, dtype=float).T
        weight = weight * evidence / ((weight * evidence).sum(axis=1) + 1 - exists)[:, None]
        found = sight * float(sight_lam.mean(dtype=float))
        sight = found / (found + 1 - sight)
        keep = np.flatnonzero(weight.sum(axis=1) > parameters.pruning_threshold)
        particles = _resampled_rows(rng, particles, lam, keep)
        sight_u = _resampled_rows(rng, groups[0][1][None], sight_lam[None], np.zeros(1, int))[0, 2, 0]
        effective = effective_size(normal)
        ancestors = systematic(rng, normal, size)
        agent = agent[ancestors]
        state = self._with_births(
            rng, agent, scan, association, log_c - log_false_alarm[:, None],
            StackedState(
                agent, np.zeros(size), particles, state.label[keep], weight[keep], sight, sight_u, state.next_label
            ),
        )  # fmt: skip
        estimate = estimate_of(parameters, agent, np.full(size, 1 / size), _moments(state))
        return state, Info(estimate, effective, 0, association.marginal, float(sight), len(state.label))

    def _birth_evidence(self, rng, agent, scan) -> np.ndarray:
        """ln c_ms (M, T) by the deterministic births of a few agent particles."""
        parameters = self.parameters
        chosen = agent[rng.integers(0, len(agent), _BIRTH_AGENTS)]
        heading = chosen[:, HEADING]
        rows = np.column_stack([chosen[:, POSITION], chosen[:, BIAS], np.cos(heading), np.sin(heading)])
        uniform = np.full(len(rows), 1 / len(rows))
        result = np.empty((len(scan), len(parameters.types)))
        for t, form in enumerate(parameters.types):
            order = order_for(scan.tangents, form)
            permuted = np.ascontiguousarray(scan.covariance[:, order][:, :, order])
            result[:, t] = births(
                int(form), scan.tangents, rows, uniform, parameters.anchor, scan.distance, scan.aoa, scan.aod,
                permuted, np.linalg.inv(np.linalg.cholesky(permuted)), order,
            )[0]  # fmt: skip
        constant = np.log(parameters.birth_rate / parameters.volume / parameters.amplitude_end)
        return result + constant + np.log(parameters.prior)

    def _with_births(self, rng, agent, scan, association, log_birth, state: StackedState) -> StackedState:
        """New features likelier than the pruning threshold: particles drawn from measurement and agent."""
        log_new = np.logaddexp.reduce(log_birth, axis=1)
        existence = association.new * np.exp(log_new - np.logaddexp(0.0, log_new))
        likely = np.flatnonzero(existence > self.parameters.pruning_threshold)
        if likely.size == 0:
            return state
        types, size = self.parameters.types, len(agent)
        fresh = np.empty((len(types), 3, likely.size, size), np.float32)
        for j, m in enumerate(likely):
            for t, form in enumerate(types):
                fresh[t, :, j] = _sample_birth(rng, form, self.parameters, agent, scan, m)
        share = normalized(log_birth[likely])
        return StackedState(
            state.agent, state.log_weight, np.concatenate([state.particles, fresh], axis=2),
            np.concatenate([state.label, state.next_label + np.arange(likely.size)]),
            np.concatenate([state.weight, existence[likely, None] * share]),
            state.sight, state.sight_amplitude, state.next_label + likely.size,
        )  # fmt: skip


def _stride(size: int) -> int:
    """A step near the golden section that visits all of ``size`` indices."""
    step = int(0.6180339887 * size) | 1
    while np.gcd(step, size) != 1:
        step += 2
    return step


def _stacked_agent(agent: np.ndarray) -> np.ndarray:
    heading = agent[:, HEADING]
    return np.stack([agent[:, 0], agent[:, 1], np.cos(heading), np.sin(heading)]).astype(np.float32)


def _sight_rows(parameters: Parameters, amplitude: np.ndarray) -> np.ndarray:
    rows = np.empty((3, 1, len(amplitude)), np.float32)
    rows[0], rows[1], rows[2] = parameters.anchor[0], parameters.anchor[1], amplitude
    return rows


def _predict(rng, parameters: Parameters, particles: np.ndarray, sight_u: np.ndarray):
    """Random walks of positions and amplitudes, from one pool of normals read at random offsets per row."""
    types, _, features, size = particles.shape
    pool = rng.standard_normal(4 * size + 1024, dtype=np.float32)
    offsets = rng.integers(0, 3 * size + 1024, (types, 3, features))
    walked = np.empty_like(particles)
    _walk(particles, walked, pool, offsets, np.float32(parameters.position_walk), np.float32(parameters.amplitude_walk))
    noise = rng.standard_normal(size, dtype=np.float32)
    return walked, np.maximum(sight_u * (1 + np.float32(parameters.amplitude_walk) * noise), np.float32(0.5))


@compiled
def _add_log_gammas(log_weight, lam, weight, none):
    """Adds Σ_k ln [Σ_t W_kt λ_kt(i) + 1 − Σ_t W_kt] to every particle's log weight."""
    types, features, size = lam.shape
    product = np.ones(size)
    for k in range(features):
        for i in range(size):
            total = none[k]
            for t in range(types):
                total += weight[k, t] * lam[t, k, i]
            product[i] *= max(total, 1e-300)
            if product[i] > 1e150 or product[i] < 1e-150:  # one logarithm for many factors
                log_weight[i] += np.log(max(product[i], 1e-300))
                product[i] = 1.0
    for i in range(size):
        log_weight[i] += np.log(product[i])


@compiled
def _row_moments(particles):
    """Means (T, K, 3) and the moments xx, xy, yy, uu (T, K, 4) of every row's particles."""
    types, _, features, size = particles.shape
    mean, spread = np.zeros((types, features, 3)), np.zeros((types, features, 4))
    for t in range(types):
        for k in range(features):
            x, y, u = particles[t, 0, k], particles[t, 1, k], particles[t, 2, k]
            x0, y0, u0 = float(x[0]), float(y[0]), float(u[0])
            sx, sy, su, xx, xy, yy, uu = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(size):
                a, b, c = x[i] - x0, y[i] - y0, u[i] - u0
                sx += a
                sy += b
                su += c
                xx += a * a
                xy += a * b
                yy += b * b
                uu += c * c
            sx, sy, su = sx / size, sy / size, su / size
            mean[t, k, 0], mean[t, k, 1], mean[t, k, 2] = x0 + sx, y0 + sy, u0 + su
            spread[t, k, 0], spread[t, k, 1] = xx / size - sx * sx, xy / size - sx * sy
            spread[t, k, 2], spread[t, k, 3] = yy / size - sy * sy, uu / size - su * su
    return mean, spread


@compiled
def _mean_missed(u, table, step):
    """(K,) mean of 1 − p_d over the particles (K, N), from its table."""
    features, size = u.shape
    last = np.float32(table.size - 1.001)
    result = np.empty(features)
    for k in range(features):
        total = 0.0
        for i in range(size):
            position = min(u[k, i] / step, last)
            index = int(position)
            share = position - np.float32(index)
            total += table[index] * (np.float32(1.0) - share) + table[index + 1] * share
        result[k] = total / size
    return result


@compiled
def _walk(particles, walked, pool, offsets, position, amplitude):
    types, _, features, size = particles.shape
    floor = np.float32(0.5)
    one = np.float32(1.0)
    for t in range(types):
        for k in range(features):
            for a in range(2):
                start = offsets[t, a, k]
                for i in range(size):
                    walked[t, a, k, i] = particles[t, a, k, i] + position * pool[start + i]
            start = offsets[t, 2, k]
            for i in range(size):
                walked[t, 2, k, i] = max(particles[t, 2, k, i] * (one + amplitude * pool[start + i]), floor)


def _associate(weight, sight, means, groups, constants, log_false_alarm, log_c):
    """Loopy data association on the Monte Carlo evidence."""
    missed = [_mean_missed(rows[2], constants.missed, np.float32(constants.missed_step)) for _, rows in groups]
    detected = np.vstack([sight * means[0], sum(weight[:, t, None] * means[1 + t] for t in range(weight.shape[1]))])
    lost = np.concatenate(
        [
            sight * missed[0] + 1 - sight,
            sum(weight[:, t] * missed[1 + t] for t in range(weight.shape[1])) + 1 - weight.sum(axis=1),
        ]
    )
    log_new = np.logaddexp(log_false_alarm, np.logaddexp.reduce(log_c, axis=1))
    with np.errstate(divide="ignore"):
        return loopy_association(np.log(np.maximum(lost, 1e-300)), np.log(detected), log_new)


def _resampled_rows(rng, rows: np.ndarray, lam: np.ndarray, keep: np.ndarray) -> np.ndarray:
    """Systematic resampling of the kept rows, (T, 3, K', N), by λ (T, K, N); copies are scattered over the row."""
    types, _, _, size = rows.shape
    out = np.empty((types, 3, keep.size, size), np.float32)
    points, starts = rng.random((types, keep.size)), rng.integers(0, size, (types, keep.size))
    _resample(rows, lam, keep, points, starts, _stride(size), out)
    return out


@compiled
def _resample(rows, lam, keep, points, starts, stride, out):
    types, _, _, size = rows.shape
    for t in range(types):
        for j in range(keep.size):
            k = keep[j]
            total = 0.0
            for i in range(size):
                total += lam[t, k, i]
            step = total / size
            threshold = points[t, j] * step
            source = 0
            cumulative = float(lam[t, k, 0])
            place = starts[t, j]
            for _ in range(size):
                while cumulative < threshold and source < size - 1:
                    source += 1
                    cumulative += lam[t, k, source]
                out[t, 0, j, place] = rows[t, 0, k, source]
                out[t, 1, j, place] = rows[t, 1, k, source]
                out[t, 2, j, place] = rows[t, 2, k, source]
                threshold += step
                place += stride
                if place >= size:
                    place -= size


def _sample_birth(rng, form: Form, parameters: Parameters, agent: np.ndarray, scan: Scan, m: int) -> np.ndarray:
    """(3, N) particles x, y, u of a new feature: proposed from two measured quantities, resampled by the third."""
    size = len(agent)
    sigma = np.sqrt(np.diag(scan.covariance[m]))
    distance = scan.distance[m] - agent[:, BIAS] + sigma[0] * rng.standard_normal(size)
    z_aoa, z_aod = (np.arctan2(v[1], v[0]) for v in (scan.aoa[m], scan.aod[m]))
    p, heading, anchor = agent[:, :2], agent[:, HEADING], parameters.anchor[:2]
    if form == Form.PS:
        angle = z_aod + sigma[2] * rng.standard_normal(size)
        n = np.column_stack([np.cos(angle), np.sin(angle)])
        w = p - anchor
        slack = distance**2 - np.sum(w * w, axis=1)
        reach = np.maximum(0.5 * slack / (distance - np.sum(w * n, axis=1)), 1e-3)
        q = anchor + reach[:, None] * n
        e = (q - p) / np.linalg.norm(q - p, axis=1, keepdims=True)
        off = np.angle(np.exp(1j * (np.arctan2(e[:, 1], e[:, 0]) - heading - z_aoa)))
        log_w = np.log(reach / np.maximum(1 + np.sum(e * n, axis=1), 1e-9)) - 0.5 * (off / sigma[1]) ** 2
        log_w[slack <= 0] -= 1e6
    else:
        angle = z_aoa + heading + sigma[1] * rng.standard_normal(size)
        e = np.column_stack([np.cos(angle), np.sin(angle)])
        q = p + distance[:, None] * e
        log_w = np.log(np.maximum(distance, 1e-3))
        if form == Form.VA_AOD:
            n = (q - anchor) / np.linalg.norm(q - anchor, axis=1, keepdims=True)
            t = -e + 2 * np.sum(e * n, axis=1, keepdims=True) * n
            off = np.angle(np.exp(1j * (np.arctan2(t[:, 1], t[:, 0]) - z_aod)))
            log_w -= 0.5 * (off / sigma[2]) ** 2
    chosen = rng.permutation(systematic(rng, normalized(log_w), size))
    deviation = np.sqrt(parameters.amplitude.variance(scan.amplitude[m]))
    u = np.maximum(scan.amplitude[m] + deviation * rng.standard_normal(size), 0.5)
    return np.stack([q[chosen, 0], q[chosen, 1], u]).astype(np.float32)


def _moments(state: StackedState) -> Features:
    """Gaussian summary of the features' particles, for the estimates."""
    types, _, features, _ = state.particles.shape
    mean, covariance = np.zeros((features, types, 3)), np.zeros((features, types, 3, 3))
    amplitude = np.zeros((features, 2))
    if features:
        center, spread = _row_moments(state.particles)
        mean[:, :, :2] = center[:, :, :2].swapaxes(0, 1)
        for (a, b), column in (((0, 0), 0), ((0, 1), 1), ((1, 0), 1), ((1, 1), 2)):
            covariance[:, :, a, b] = spread[:, :, column].T
        share = state.weight / state.weight.sum(axis=1, keepdims=True)
        amplitude[:, 0] = np.einsum("kt,tk->k", share, center[:, :, 2])
        amplitude[:, 1] = np.einsum("kt,tk->k", share, spread[:, :, 3])
    return Features(state.label, state.weight, mean, covariance, amplitude)
