"""Rao-Blackwellized belief-propagation SLAM (paper B): particles for the agent, a Gaussian per feature and
type.

The messages are those of paper B's factor graph (theory §5); integrals over a feature are Kalman updates
given the agent particle, integrals over the agent are sums over particles. Three guards keep few particles
sufficient:

* g1: data association uses the Gaussian moments of the predicted measurement, not a Monte Carlo average;
* g2: when the agent's update leaves fewer than ``effective_floor``·N effective particles, the measurement
  noise is annealed from wide to true, with resampling and a covariance-preserving kernel jitter between the
  stages;
* g3: a small uniform part in the amplitude likelihood lets a blocked path return as the same feature.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dopslam.slam.association.loopy import Association, loopy_association
from dopslam.slam.belief import kernels
from dopslam.slam.belief.belief import effective_size, kernel_jitter, normalized, systematic
from dopslam.slam.belief.births import births, order_for
from dopslam.slam.belief.evidence import gaussian_evidence
from dopslam.slam.belief.motion import Motion
from dopslam.slam.belief.records import Features, Form, Info, Parameters, Scan
from dopslam.slam.belief.rows import (
    amplitude_posterior,
    amplitudes_of,
    estimate_of,
    kernel_agent,
    owner_messages,
    predict,
    row_arrays,
    rows_of,
    thinned,
)

_LOG_ZERO = -700.0
_STAGES = 60  # annealing stages per step at most
_BLIND = 0.01  # below this share of effective particles the noise is widened first
_SIGHTED = 0.9  # association probability from which the line of sight must be explained by the particles
_WIDEST = 1e-6  # smallest noise precision of the annealing, relative
_STRIDE = np.log(8.0)


@dataclass(frozen=True, slots=True)
class State:
    """What the filter carries from step to step.

    agent : (N, 8) particles (:mod:`dopslam.slam.belief.motion`); log_weight : (N,)
    features : :class:`Features`; sight : (3,) existence, mean and variance of the amplitude of the line of
        sight
    next_label : label of the next new feature
    """

    agent: np.ndarray
    log_weight: np.ndarray
    features: Features
    sight: np.ndarray
    next_label: int


@dataclass(frozen=True, slots=True)
class RaoBlackwell:
    """The filter: parameters only; ``init`` and ``step`` are pure.

    Parameters
    ----------
    parameters, motion : the models
    effective_floor, effective_target : shares of N that start and steer the annealing (g2)
    jitter : kernel width of the annealing stages
    evidence_particles, birth_particles : particles used for the moments of g1 and for births
    gate : associations less likely than this are left out of the updates
    """

    parameters: Parameters
    motion: Motion
    effective_floor: float = 0.1
    effective_target: float = 0.5
    jitter: float = 0.35
    evidence_particles: int = 250
    birth_particles: int = 128
    gate: float = 1e-7

    def init(self, agent: np.ndarray, log_weight: np.ndarray, sight_amplitude: float | None = None) -> State:
        """State before the first step from initial particles (:mod:`dopslam.slam.belief.start`).

        ``sight_amplitude`` is a first guess of the line of sight's amplitude, ±10 %; without it the prior is
        as wide as the amplitudes' support.
        """
        end = self.parameters.amplitude_end
        mean, deviation = (end / 4, end / 4) if sight_amplitude is None else (sight_amplitude, 0.1 * sight_amplitude)
        return State(
            np.array(agent, float), np.array(log_weight, float), Features.empty(len(self.parameters.types)),
            np.array([0.9, mean, deviation**2]), 0,
        )  # fmt: skip

    def step(self, rng: np.random.Generator, state: State, scan: Scan) -> tuple[State, Info]:
        """Predict, associate, update agent and features, add births, prune, estimate."""
        parameters = self.parameters
        agent = self.motion.predict(rng, state.agent)
        features, sight = predict(parameters, state.features, state.sight)
        amplitudes = amplitudes_of(parameters, features, sight, scan)
        log_false_alarm = parameters.log_false_alarm(scan)
        log_birth = self._births(rng, agent, state.log_weight, scan)[0] - log_false_alarm[:, None]
        weight = np.vstack([np.r_[sight[0], np.zeros(len(parameters.types) - 1)], features.weight])
        association = self._associate(
            agent, state.log_weight, features, weight, amplitudes, scan, log_false_alarm, log_birth
        )
        rows = rows_of(parameters, self.gate, features, amplitudes, association, scan, log_false_alarm)
        agent, log_weight, log_rows, log_owner, stages = self._update_agent(
            rng, agent, state.log_weight, rows, weight, 1 - association.marginal[0, 0], scan
        )
        features, sight = self._update_features(
            agent, log_weight, log_rows, log_owner, rows, weight, features, amplitudes, scan
        )
        born = self._born(rng, agent, log_weight, scan, association, log_birth, state.next_label)
        features = Features.join(features, born)
        features = features.select(features.existence > parameters.pruning_threshold)
        normal = normalized(log_weight)
        effective = effective_size(normal)
        estimate = estimate_of(parameters, agent, normal, features)
        if effective < 0.5 * len(agent):
            agent, log_weight = agent[systematic(rng, normal, len(agent))], np.zeros(len(agent))
        info = Info(estimate, effective, stages, association.marginal, float(sight[0]), len(features))
        return State(agent, log_weight, features, sight, state.next_label + len(born)), info

    def _associate(self, agent, log_weight, features, weight, amplitudes, scan, log_false_alarm, log_birth):
        """Loopy data association on the Gaussian evidence (g1), everything relative to the false alarms."""
        types = self.parameters.types
        form, mean, covariance, owner = row_arrays(self.parameters, features)
        keep = thinned(normalized(log_weight), self.evidence_particles)
        log_n = gaussian_evidence(
            kernel_agent(agent[keep[0]]), keep[1], self.parameters.anchor, scan.tangents, form, mean, covariance,
            scan.distance, scan.aoa, scan.aod, scan.covariance, amplitudes.scale[owner],
        )  # fmt: skip
        if Form.VA in types:  # its AOD is uniform: all densities live in the same measurement space
            log_n[form == Form.VA] -= np.log(2 * np.pi if scan.tangents == 1 else 4 * np.pi)
        log_w = np.log(np.maximum(weight, 1e-300))
        by_type = np.full((len(weight), len(types), len(scan)), -np.inf)
        by_type[0, 0] = log_n[0]
        by_type[1:] = log_n[1:].reshape(len(features), len(types), len(scan))
        log_detected = np.logaddexp.reduce(log_w[:, :, None] + by_type, axis=1)
        log_detected += amplitudes.log_evidence - log_false_alarm
        exists = weight.sum(axis=1)
        log_missed = np.log(exists * np.exp(amplitudes.log_missed) + np.maximum(1 - exists, 0.0))
        return loopy_association(log_missed, log_detected, np.logaddexp(0.0, np.logaddexp.reduce(log_birth, axis=1)))

    def _row_likelihoods(self, agent, rows, scan, whitener, temper):
        return kernels.row_likelihoods(
            kernel_agent(agent), self.parameters.anchor, scan.tangents, rows.form, rows.mean, rows.covariance,
            rows.log_missed, rows.first, rows.pair, rows.scale, rows.log_weight,
            scan.distance, scan.aoa, scan.aod, whitener, temper,
        )  # fmt: skip

    def _update_agent(self, rng, agent, log_weight, rows, weight, sighted, scan):
        """Weights w_i ∏_k γ_k(i), γ_k = Σ_t W_kt λ_kt + 1 − Σ_t W_kt; annealed if too few particles remain (g2)."""
        whitener = np.linalg.inv(np.linalg.cholesky(scan.covariance))

        def messages(particles, temper):
            log_rows = self._row_likelihoods(particles, rows, scan, whitener, temper)
            log_owner = owner_messages(log_rows, weight, len(self.parameters.types))
            return log_rows, log_owner

        size = len(agent)

        def effective(logs):
            return effective_size(normalized(logs)) / size

        def lost(log_weights, log_rows):
            """Whether few particles are in sight of the optimum, or none where the line of sight is associated."""
            if effective(log_weights) < _BLIND:
                return True
            none = np.log(max(1 / max(weight[0, 0], 1e-12) - 1, 1e-300))  # no line of sight, relative to it
            unseen = np.logaddexp(rows.log_missed[0], none) - np.logaddexp(log_rows[0], none)
            missed = normalized(log_weights) @ np.exp(np.minimum(unseen, 0.0))
            return sighted > _SIGHTED and missed > 0.5

        log_rows, log_owner = messages(agent, 1.0)
        total = log_owner.sum(axis=0)
        stages = 0
        # Widen the noise, whose gradient reaches far, and anneal it to its true width. A likelihood too sharp
        # for the particles leaves them all with the weight of a missed detection: many effective ones, and
        # all of them wrong.
        temper, reached = 0.0, np.zeros(size)
        while temper < 1.0 and stages < _STAGES and lost(log_weight + total - reached, log_rows):
            stages += 1
            low = high = np.log(max(temper, _WIDEST))
            while high < 0.0:  # from wide to sharp: the effective size falls and, past the particles' reach, rises
                high = min(high + _STRIDE, 0.0)
                wide = messages(agent, np.exp(high))[1].sum(axis=0)
                if effective(log_weight + wide - reached) < self.effective_target:
                    break
                low = high
            for _ in range(5 if high > low else 0):
                middle = 0.5 * (low + high)
                wide = messages(agent, np.exp(middle))[1].sum(axis=0)
                enough = effective(log_weight + wide - reached) >= self.effective_target
                low, high = (middle, high) if enough else (low, middle)
            temper = float(np.exp(high))
            wide = messages(agent, temper)[1].sum(axis=0)
            agent = self._moved(rng, agent, log_weight + wide - reached)
            log_weight, reached = np.zeros(size), messages(agent, temper)[1].sum(axis=0)
            log_rows, log_owner = messages(agent, 1.0)
            total = log_owner.sum(axis=0)
        # Then powers of what is left, which cost one evaluation per stage.
        while (
            effective_size(normalized(log_weight + total - reached)) < self.effective_floor * size and stages < _STAGES
        ):
            stages += 1
            left = total - reached
            low, high = 0.0, 1.0
            for _ in range(12):
                middle = 0.5 * (low + high)
                enough = effective_size(normalized(log_weight + middle * left)) >= self.effective_target * size
                low, high = (middle, high) if enough else (low, middle)
            agent = self._moved(rng, agent, log_weight + high * left)
            log_rows, log_owner = messages(agent, 1.0)
            if np.any(reached):
                reached = (1 - high) * messages(agent, temper)[1].sum(axis=0)
            total, log_weight = log_owner.sum(axis=0), np.zeros(size)
            reached = reached + high * total
        return agent, log_weight + total - reached, log_rows, log_owner, stages

    def _moved(self, rng, agent, log_weight):
        """Resampled particles with the kernel jitter."""
        chosen = systematic(rng, normalized(log_weight), len(agent))
        return self.motion.rebuild(kernel_jitter(rng, self.motion.coordinates(agent[chosen]), self.jitter))

    def _update_features(self, agent, log_weight, log_rows, log_owner, rows, weight, features, amplitudes, scan):
        """Moment matching over particles and associations with extrinsic weights w_i/γ_k(i)."""
        log_w = np.maximum(log_weight - np.logaddexp.reduce(log_weight), _LOG_ZERO)
        log_extrinsic = log_w - log_owner[rows.owner]
        reference = (log_extrinsic + log_rows).max(axis=1)
        mass, mean, covariance = kernels.row_moments(
            kernel_agent(agent), self.parameters.anchor, scan.tangents, rows.form, rows.mean, rows.covariance,
            rows.log_missed, rows.first, rows.pair, rows.scale, rows.log_weight,
            scan.distance, scan.aoa, scan.aod, np.linalg.inv(np.linalg.cholesky(scan.covariance)),
            log_extrinsic, log_rows, reference,
        )  # fmt: skip
        types = len(self.parameters.types)
        row_weight = np.r_[weight[0, 0], weight[1:].ravel()]
        share = mass * (row_weight * np.exp(reference))[:, None]  # joint of type, existence and association
        per_owner = np.vstack([share[:1], share[1:].reshape(len(features), types, share.shape[1]).sum(axis=1)])
        amplitude = amplitude_posterior(rows, per_owner, amplitudes, types)
        updated = Features(
            features.label,
            share[1:].sum(axis=1).reshape(len(features), types),
            mean[1:].reshape(-1, types, 3),
            covariance[1:].reshape(-1, types, 3, 3),
            amplitude[1:],
        )
        return updated, np.r_[min(share[0].sum(), 1.0), amplitude[0]]

    def _births(self, rng, agent, log_weight, scan):
        """ln c_ms (M, T), means (M, T, 3) and covariances of new features from every measurement."""
        parameters = self.parameters
        count, types = scan.tangents, parameters.types
        chosen = systematic(rng, normalized(log_weight), self.birth_particles)
        particles, uniform = kernel_agent(agent[chosen]), np.full(len(chosen), 1 / len(chosen))
        log_c = np.full((len(scan), len(types)), -np.inf)
        mean, covariance = np.zeros((len(scan), len(types), 3)), np.zeros((len(scan), len(types), 3, 3))
        constant = np.log(parameters.birth_rate / parameters.volume / parameters.amplitude_end)
        for t, form in enumerate(types):
            order = order_for(count, form)
            permuted = np.ascontiguousarray(scan.covariance[:, order][:, :, order])
            whitener = np.linalg.inv(np.linalg.cholesky(permuted))
            log_c[:, t], mean[:, t], covariance[:, t] = births(
                int(form), count, particles, uniform, parameters.anchor, scan.distance, scan.aoa, scan.aod,
                permuted, whitener, order,
            )  # fmt: skip
        return log_c + constant + np.log(parameters.prior), mean, covariance

    def _born(self, rng, agent, log_weight, scan, association: Association, log_birth, next_label) -> Features:
        """New features that are likelier than the pruning threshold, placed by the updated agent."""
        log_new = np.logaddexp.reduce(log_birth, axis=1)
        existence = association.new * np.exp(log_new - np.logaddexp(0.0, log_new))
        likely = np.flatnonzero(existence > self.parameters.pruning_threshold)
        if likely.size == 0:
            return Features.empty(len(self.parameters.types))
        chosen = scan.select(likely)
        log_c, mean, covariance = self._births(rng, agent, log_weight, chosen)
        possible = np.isfinite(log_c).any(axis=1)
        share = normalized(np.where(possible[:, None], log_c, 0.0))
        walk = self.parameters.position_walk**2
        for t in range(log_c.shape[1]):  # a type that no particle allows starts where another one does
            missing = ~np.isfinite(log_c[:, t]) & possible
            best = np.argmax(log_c, axis=1)
            mean[missing, t] = mean[missing, best[missing]]
            covariance[missing, t] = covariance[missing, best[missing]] + walk * np.eye(3)
        born = Features(
            next_label + np.arange(likely.size),
            existence[likely, None] * share,
            mean,
            covariance,
            np.column_stack([chosen.amplitude, self.parameters.amplitude.variance(chosen.amplitude)]),
        )
        return born.select(possible)
