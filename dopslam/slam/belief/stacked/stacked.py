"""Stacked-particle belief-propagation SLAM, the implementation that paper B describes (in the plane).

Agent and features are particles, coupled by index: particle i of a feature is evaluated with particle i of
the agent, after a random permutation that keeps copies of one ancestor apart. Each type of a feature has its
own particle set (a scatterer's position is meaningless as a virtual anchor's). The likelihoods run on a
backend of :mod:`dopslam.slam.belief.stacked.likelihood`; everything else is linear-time NumPy and compiled loops.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dopslam.models.amplitude import AmplitudeModel, Radio
from dopslam.slam.association.loopy import loopy_association
from dopslam.slam.belief.belief import effective_size, normalized, systematic
from dopslam.slam.belief.births import births, order_for
from dopslam.slam.belief.motion import BIAS, HEADING, POSITION, Motion
from dopslam.slam.belief.records import Features, Form, Info, Parameters, Scan
from dopslam.slam.belief.rows import estimate_of
from dopslam.slam.belief.stacked.clouds import (
    log_gammas,
    mean_missed,
    moments,
    resample_rows,
    sample_births,
    stride,
    walked,
)
from dopslam.slam.belief.stacked.likelihood import Backend, Constants

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

    parameters, motion, radio : the models; backend : of :func:`dopslam.slam.belief.stacked.backends.backend`
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
        share = ((np.arange(size) * stride(size)) % size + 0.5) / size  # independent of the particles' order
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
        assert isinstance(parameters.amplitude, AmplitudeModel)
        constants = Constants.of(self.radio, parameters.amplitude, parameters.anchor)
        agent = self.motion.predict(rng, state.agent)
        size = len(agent)
        if np.any(state.log_weight):  # weighted start
            agent = agent[systematic(rng, normalized(state.log_weight), size)]
        agent = agent[rng.permutation(size)]  # copies of one ancestor meet different feature particles
        particles = walked(rng, state.particles, parameters.position_walk, parameters.amplitude_walk)
        noise = rng.standard_normal(size, dtype=np.float32)
        sight_u = np.maximum(
            state.sight_amplitude * (1 + np.float32(parameters.amplitude_walk) * noise), np.float32(0.5)
        )
        weight = parameters.survival * state.weight @ parameters.transition
        sight = parameters.survival * state.sight + parameters.return_probability * (1 - state.sight)
        stacked = _stacked_agent(agent)
        groups = [(Form.LOS, _sight_rows(parameters, sight_u)), *zip(types, particles, strict=True)]

        log_false_alarm = parameters.log_false_alarm(scan)
        means = [self.backend.evidence(form, x, y, u, stacked, scan, constants) for form, (x, y, u) in groups]
        log_c = self._birth_evidence(rng, agent, scan)
        association = _associate(weight, sight, means, groups, constants, log_false_alarm, log_c)

        nu = np.exp(np.minimum(association.log_nu, 80.0))
        nu[association.marginal[:, 1:] < 1e-7] = 0.0
        x, y, u = groups[0][1]
        sight_lam = self.backend.messages(Form.LOS, x, y, u, stacked, scan, nu[:1], constants)
        lam = np.empty((len(types), len(weight), size), np.float32)
        for t, (form, (x, y, u)) in enumerate(groups[1:]):
            lam[t] = self.backend.messages(form, x, y, u, stacked, scan, nu[1:], constants)
        log_weight = np.log(np.maximum(sight * sight_lam[0].astype(float) + 1 - sight, 1e-300))
        exists = weight.sum(axis=1)
        log_weight += log_gammas(lam, weight, np.maximum(1 - exists, 0.0))
        normal = normalized(log_weight)

        evidence = lam.mean(axis=2, dtype=float).T
        weight = weight * evidence / ((weight * evidence).sum(axis=1) + 1 - exists)[:, None]
        found = sight * float(sight_lam.mean(dtype=float))
        sight = found / (found + 1 - sight)
        keep = np.flatnonzero(weight.sum(axis=1) > parameters.pruning_threshold)
        sight_u = np.empty((1, 3, 1, size), np.float32)
        resample_rows(rng, groups[0][1][None], sight_lam[None], np.zeros(1, int), sight_u)
        effective = effective_size(normal)
        agent = agent[systematic(rng, normal, size)]
        likely, existence, share = self._likely_births(association, log_c - log_false_alarm[:, None])
        cloud = np.empty((len(types), 3, keep.size + likely.size, size), np.float32)
        resample_rows(rng, particles, lam, keep, cloud)
        sample_births(rng, parameters, agent, scan, likely, cloud[:, :, keep.size :])
        state = StackedState(
            agent, np.zeros(size), cloud,
            np.concatenate([state.label[keep], state.next_label + np.arange(likely.size)]),
            np.concatenate([weight[keep], existence[:, None] * share]),
            sight, sight_u[0, 2, 0], state.next_label + likely.size,
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

    def _likely_births(self, association, log_birth) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Measurements (B,) that are new features likelier than the pruning threshold, their existence, types (B, T)."""
        log_new = np.logaddexp.reduce(log_birth, axis=1)
        existence = association.new * np.exp(log_new - np.logaddexp(0.0, log_new))
        likely = np.flatnonzero(existence > self.parameters.pruning_threshold)
        share = normalized(log_birth[likely]) if likely.size else np.zeros((0, log_birth.shape[1]))
        return likely, existence[likely], share


def _stacked_agent(agent: np.ndarray) -> np.ndarray:
    heading = agent[:, HEADING]
    return np.stack([agent[:, 0], agent[:, 1], np.cos(heading), np.sin(heading)]).astype(np.float32)


def _sight_rows(parameters: Parameters, amplitude: np.ndarray) -> np.ndarray:
    rows = np.empty((3, 1, len(amplitude)), np.float32)
    rows[0], rows[1], rows[2] = parameters.anchor[0], parameters.anchor[1], amplitude
    return rows


def _associate(weight, sight, means, groups, constants, log_false_alarm, log_c):
    """Loopy data association on the Monte Carlo evidence."""
    missed = [mean_missed(rows[2], constants.missed, constants.missed_step) for _, rows in groups]
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


def _moments(state: StackedState) -> Features:
    """Gaussian summary of the features' particles, for the estimates."""
    types, _, features, _ = state.particles.shape
    mean, covariance = np.zeros((features, types, 3)), np.zeros((features, types, 3, 3))
    amplitude = np.zeros((features, 2))
    if features:
        center, spread = moments(state.particles)
        mean[:, :, :2] = center[:, :, :2].swapaxes(0, 1)
        for (a, b), column in (((0, 0), 0), ((0, 1), 1), ((1, 0), 1), ((1, 1), 2)):
            covariance[:, :, a, b] = spread[:, :, column].T
        share = state.weight / state.weight.sum(axis=1, keepdims=True)
        amplitude[:, 0] = np.einsum("kt,tk->k", share, center[:, :, 2])
        amplitude[:, 1] = np.einsum("kt,tk->k", share, spread[:, :, 3])
    return Features(state.label, state.weight, mean, covariance, amplitude)
