"""Belief propagation that keeps the correlation between agent and features.

The recursion of :class:`~dopslam.slam.belief.rao_blackwell.RaoBlackwell` (paper B) with messages on the joint of agent and
map: after a step a feature is not a marginal of its own but a Gaussian *given the agent*, x | s ~ N(x̄ + G(s − s̄), C).
The independent form counts what a feature has learnt from the agent as news when the feature informs the agent next time;
here it is not news. Data association is the loopy one, on the evidence of the joint. The agent is a Gaussian, or particles
with exact weights (:mod:`dopslam.slam.belief.conditional.particles`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dopslam.models.detection import SnrDetection
from dopslam.slam.belief.belief import effective_size, normalized, systematic
from dopslam.slam.belief.conditional import particles as sampling
from dopslam.slam.belief.conditional import step as compiled
from dopslam.slam.belief.conditional.amplitude import amplitude_table, log_loss, log_losses
from dopslam.slam.belief.conditional.belief import Belief, Dynamics, empty_map, uncertain
from dopslam.slam.belief.conditional.births import births
from dopslam.slam.belief.conditional.course import Course, course_of
from dopslam.slam.belief.conditional.estimate import estimate_of
from dopslam.slam.belief.conditional.linear import Measured, measured
from dopslam.slam.belief.motion import Motion
from dopslam.slam.belief.rao_blackwell import RaoBlackwell
from dopslam.slam.belief.records import Info, Parameters, Scan


@dataclass(frozen=True)
class Conditional:
    """The filter: parameters only; ``start``, ``init`` and ``step`` are pure.

    Parameters
    ----------
    parameters, motion : the models
    doppler : use radial velocities where the scans have them; doppler_span : m/s, width of their search
    detection : p_D of a search over all path parameters; None: the amplitude model's own
    particles : N of the agent, where it is one
    iterations : linearizations of an update
    kernel : width h of the particles' kernels, of 1
    widening : of the proposal's standard deviation
    pair_gate : squared Mahalanobis distance beyond which a measurement cannot be a feature's
    gate : associations less likely than this are left out of the updates
    hide, unhide : probabilities per step that a feature is hidden by something, and that it comes back
    double : likelihood of a miss of a feature that should be seen beside a detection in its resolution cell, over that of
        none
    correlation : False drops it after every step, everything else equal: the control experiment of what keeping it is worth
    prune_type : types below this share of a feature's existence are dropped
    """

    parameters: Parameters
    motion: Motion
    doppler: bool = True
    doppler_span: float = 50.0
    detection: SnrDetection | None = None
    particles: int = 1000
    iterations: int = 3
    kernel: float = 0.7
    widening: float = 1.15
    pair_gate: float = 25.0
    gate: float = 1e-7
    hide: float = 0.02
    unhide: float = 0.1
    double: float = 0.8
    correlation: bool = True
    prune_type: float = 1e-5

    @cached_property
    def dynamics(self) -> Dynamics:
        """The motion in its coordinates."""
        return Dynamics(self.motion)

    @cached_property
    def _table(self):
        parameters = self.parameters
        return amplitude_table(parameters.amplitude, self.detection, parameters.reacquisition, parameters.amplitude_end)

    @cached_property
    def _course(self) -> Course:
        return course_of(self.motion)

    @cached_property
    def _choices(self) -> compiled.Choices:
        p = self.parameters
        return compiled.Choices(
            np.array(p.anchor, float), self._table, 3 if p.spatial else 2, len(p.types), float(p.survival),
            float(p.return_probability), float(p.type_switch), float(p.position_walk), float(p.amplitude_walk),
            bool(p.rescale_covariance), int(self.iterations), float(self.pair_gate), float(self.gate), float(self.hide),
            float(self.unhide), float(self.double), float(self.prune_type * p.pruning_threshold),
        )  # fmt: skip

    @cached_property
    def _forms(self) -> np.ndarray:
        return np.array([int(form) for form in self.parameters.types], dtype=np.int64)

    @property
    def _sampled(self) -> bool:
        return self.parameters.agent == "particles"

    def start(self, mean: np.ndarray, covariance: np.ndarray, rng: np.random.Generator | None = None) -> Belief:
        """Belief before the first step from a Gaussian of the motion's coordinates, mean (c,) and covariance (c, c)."""
        mean, covariance = np.array(mean, float), np.array(covariance, float)
        active = uncertain(self.dynamics, mean, covariance)
        small = covariance[np.ix_(active, active)]
        points = log_weight = None
        if self._sampled:
            if rng is None:
                rng = np.random.default_rng(0)
            points = (
                mean[active] + rng.standard_normal((self.particles, len(active))) @ sampling.symmetric_root(small).T
            )
            log_weight = np.zeros(self.particles)
        pose, _ = self.dynamics.pose(mean)
        return Belief(mean, small, active, points, log_weight, self._sight(pose, len(active), None))

    def init(self, agent: np.ndarray, log_weight: np.ndarray, sight_amplitude: float | None = None) -> Belief:
        """Belief before the first step from particles (N, 8) that need not be Gaussian
        (:mod:`dopslam.slam.belief.start`): the first step is made with them."""
        coordinates = self.motion.coordinates(agent)
        mean = coordinates.mean(axis=0)
        active = uncertain(self.dynamics, mean, np.cov(coordinates.T))
        pose = agent[int(np.argmax(log_weight))]
        covariance = np.cov(coordinates[:, active].T)
        return Belief(
            mean, covariance, active, None, None, self._sight(pose, len(active), sight_amplitude),
            cloud=(np.array(agent, float), np.array(log_weight, float)),
        )  # fmt: skip

    def _sight(self, pose, size, amplitude):
        """The line of sight before the first step; without a guess of its amplitude as wide as the support."""
        anchor, end = np.asarray(self.parameters.anchor, float), self.parameters.amplitude_end
        mean, deviation = (end / 4, end / 4) if amplitude is None else (amplitude, 0.1 * amplitude)
        loss = np.exp(log_loss(0, pose, *anchor, anchor))
        return empty_map(anchor, size, np.array([0.9, mean * np.sqrt(loss), deviation**2 * loss]))

    def step(self, rng: np.random.Generator, belief: Belief, scan: Scan) -> tuple[Belief, Info]:
        """Predict, associate, update agent and features, add births, prune, estimate."""
        if belief.cloud is not None:
            return self._first(rng, belief, scan)
        choices, course = self._choices, self._course
        rows = measured(scan, self.doppler)
        log_false = self._log_false(scan, rows)
        prior = belief.mean, belief.covariance
        moved, covariance, noise, chart, pose, by_coordinate = compiled.predict(
            course, choices, *prior, belief.active, belief.map
        )
        log_birth = self._log_births(pose, by_coordinate, covariance, rows)[0]
        whole, narrow, after, marginal, new, born, exact = compiled.update(
            course, choices, moved, covariance, belief.active, chart, pose, by_coordinate, rows,
            np.ascontiguousarray(scan.amplitude, float), log_false, log_birth,
        )  # fmt: skip
        posterior, effective = replace(belief, mean=whole, covariance=narrow, map=after), float("nan")
        if belief.points is not None:
            centers, noise = self._centers(belief, moved, covariance, noise)
            told = moved[belief.active], covariance, chart
            posterior, effective = self._resample(rng, posterior, told, centers, noise, exact, rows)
        return self._finish(posterior, scan, rows, new, marginal, born, effective, 0)

    def _centers(self, belief: Belief, moved, covariance, noise):
        """Centers (N, d) and covariance (d, d) of the components of the predicted density, one per particle."""
        assert belief.points is not None
        active, h = belief.active, self.kernel
        mean = belief.mean[active]
        whole = np.tile(belief.mean, (len(belief.points), 1))
        whole[:, active] = mean + np.sqrt(1 - h**2) * (belief.points - mean)
        return self.dynamics.moved(whole, moved)[:, active], noise + h**2 * (covariance - noise)

    def _log_false(self, scan: Scan, rows: Measured) -> np.ndarray:
        """(M,) ln of the false alarms' intensity in the space of the rows used."""
        return self.parameters.log_false_alarm(scan) - (np.log(self.doppler_span) if rows.doppler else 0.0)

    def _log_births(self, pose, by_coordinate, covariance, rows):
        """ln c_ms (M, T) apart from the false alarms, and the newborn features given the agent."""
        parameters = self.parameters
        constant = np.log(parameters.birth_rate / parameters.volume / parameters.amplitude_end)
        log_birth, *born = births(
            self._forms, pose, by_coordinate, covariance, 3 if parameters.spatial else 2,
            np.asarray(parameters.anchor, float), rows,
        )  # fmt: skip
        return log_birth + constant + np.log(parameters.prior), *born

    def _resample(self, rng, posterior: Belief, told, centers, noise, exact, rows):
        """Exact weights of particles from the linearized proposal; the agent becomes theirs, the map follows it."""
        assert posterior.log_weight is not None
        active, chart = posterior.active, posterior.map
        *before_prior, before_chart = told
        means, covariance = sampling.proposal(
            centers, noise, tuple(before_prior), (posterior.mean[active], posterior.covariance), self.widening
        )
        size = len(means)
        chosen = systematic(rng, normalized(posterior.log_weight), size)
        points = means[chosen] + rng.standard_normal(means.shape) @ sampling.symmetric_root(covariance).T
        whole = np.tile(posterior.mean, (size, 1))
        whole[:, active] = points
        log_weight = sampling.log_messages(
            before_chart.form, before_chart.first, before_chart.weight, points, self.dynamics.poses(whole), *exact[:7],
            self._choices.anchor, rows, *exact[7:],
        )  # fmt: skip
        log_weight += sampling.quadratic(points - means[chosen], covariance)
        log_weight -= sampling.quadratic(points - centers[chosen], noise)
        effective = effective_size(normalized(log_weight))
        normal = sampling.tempered(log_weight, 4 * (len(active) + 1))
        mean = normal @ points
        offset = points - mean
        spread = (normal[:, None] * offset).T @ offset
        center = chart.center + (chart.gain @ (mean - posterior.mean[active])).reshape(-1, 3)
        points = sampling.equal_weights(rng, points, normal, spread)
        whole = posterior.mean.copy()
        whole[active] = mean
        return replace(
            posterior, mean=whole, covariance=0.5 * (spread + spread.T), points=mean + points, log_weight=np.zeros(size),
            map=chart._replace(center=center),
        ), effective  # fmt: skip

    def _finish(self, belief, scan, rows, new, marginal, log_new, effective, stages):
        """Births, pruning, estimate."""
        parameters = self.parameters
        belief = replace(belief, map=compiled.pruned(belief.map, parameters.pruning_threshold, self.prune_type))
        existence = new * np.exp(log_new - np.logaddexp(0.0, log_new))
        likely = np.flatnonzero(existence > parameters.pruning_threshold)
        if likely.size:
            belief = self._born(belief, scan, rows, likely, existence[likely])
        if not self.correlation:
            belief = replace(belief, map=belief.map.marginals(belief.covariance))
        pose, full = self.dynamics.pose(belief.mean)
        estimate = estimate_of(parameters, belief, pose, full)
        info = Info(estimate, effective, stages, marginal, float(belief.map.weight[0]), len(belief.map.label) - 1)
        return belief, info

    def _born(self, belief: Belief, scan: Scan, rows: Measured, likely, existence) -> Belief:
        """New features where the updated agent puts them."""
        chart, anchor = belief.map, np.asarray(self.parameters.anchor, float)
        pose, full = self.dynamics.pose(belief.mean)
        by_coordinate = np.ascontiguousarray(full[:, belief.active])
        part = rows._replace(
            distance=rows.distance[likely], rate=rows.rate[likely], aoa=rows.aoa[likely], aod=rows.aod[likely],
            covariance=rows.covariance[likely],
        )  # fmt: skip
        log_c = self._log_births(pose, by_coordinate, belief.covariance, part)[0]
        _, x, gain, spread = self._log_births(pose, by_coordinate, np.zeros_like(belief.covariance), part)
        possible = np.isfinite(log_c) & np.isfinite(self._exact(spread))
        share = np.where(
            possible, np.exp(log_c - np.max(np.where(possible, log_c, -1e300), axis=1, keepdims=True)), 0.0
        )
        total = share.sum(axis=1, keepdims=True)
        share = share / np.maximum(total, 1e-300)
        use = share > self.prune_type
        m, t = np.nonzero(use)
        counts = use.sum(axis=1)
        fine = counts > 0
        z = scan.amplitude[likely][m]
        forms = self._forms[t]
        loss = np.exp(log_losses(forms, pose, x[m, t], anchor))
        noise = self.parameters.amplitude.variance(z)
        labels = belief.next_label + np.arange(int(fine.sum()))
        chart = chart.joined(
            labels, counts[fine], forms, existence[m] * share[m, t],
            np.column_stack([z * np.sqrt(loss), noise * loss, z * np.sqrt(loss)]), x[m, t], gain[m, t], spread[m, t],
        )  # fmt: skip
        return replace(belief, map=chart, next_label=belief.next_label + len(labels))

    @staticmethod
    def _exact(spread):
        """(M, T) finite where a newborn's covariance is one."""
        trace = np.trace(spread, axis1=-2, axis2=-1)
        return np.where(trace > 0, trace, np.nan)

    def _first(self, rng, belief: Belief, scan: Scan):
        """The first step from particles that are no Gaussian: only the line of sight can inform them, with annealing."""
        plain = RaoBlackwell(self.parameters, self.motion)
        assert belief.cloud is not None
        agent, log_weight = belief.cloud
        sight = belief.map
        pose = agent[int(np.argmax(log_weight))]
        anchor = np.asarray(self.parameters.anchor, float)
        loss = np.exp(log_loss(0, pose, *anchor, anchor))
        known = np.array([0.9, sight.reference[0, 0] / np.sqrt(loss), sight.reference[0, 1] / loss])
        state = replace(plain.init(agent, log_weight), sight=known)
        state, info = plain.step(rng, state, scan.without_doppler)
        normal = normalized(state.log_weight)
        coordinates = self.motion.coordinates(state.agent)
        mean = normal @ coordinates
        active = belief.active
        offset = coordinates[:, active] - mean[active]
        covariance = (normal[:, None] * offset).T @ offset
        pose, full = self.dynamics.pose(mean)
        loss = np.exp(log_loss(0, pose, *anchor, anchor))
        chart = empty_map(anchor, len(active), state.sight * np.array([1.0, np.sqrt(loss), loss]))
        points = None
        if self._sampled:
            points = coordinates[systematic(rng, normal, self.particles)][:, active]
        rows = measured(scan, self.doppler)
        log_false = self._log_false(scan, rows)
        by_coordinate = np.ascontiguousarray(full[:, active])
        log_born = self._log_births(pose, by_coordinate, covariance, rows)[0] - log_false[:, None]
        log_new = np.logaddexp.reduce(log_born, axis=1)
        new = 1 - info.association[0, 1:]
        belief = replace(
            belief, mean=mean, covariance=covariance, points=points, cloud=None, map=chart,
            log_weight=None if points is None else np.zeros(len(points)),
        )  # fmt: skip
        return self._finish(belief, scan, rows, new, info.association, log_new, info.effective, info.stages)
