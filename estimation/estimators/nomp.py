"""NOMP: greedy search on a dictionary, joint refinement, likelihood-ratio stop, backward elimination. The
default estimator.

One pass: search the residual, refine the candidates each alone, accept those above the threshold, refine all
paths jointly until the likelihood stops growing. No new path is looked for before the joint fit has
converged, since a path added to an unconverged fit ends in a wrong local optimum. After the last pass every
component must be worth its threshold against a refitted model without it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..ambiguities import check_schedule
from ..detections import Detections
from ..errors import ModelError
from ..signal.algebra import coherence, signal_of, weighted_blocks
from ..signal.model import SignalModel
from ..signal.noise import white_noise
from ..signal.paths import Geometry, PathTable
from . import report
from .beyond import beyond
from .choice import accepted_of
from .clearing import cleared, heard, standing_out
from .clock import Clock
from .detect import SHARE, calibrated_volume, search_volume, threshold_for
from .dmc import pilot_covariance
from .floor import Floor
from .grids import EVERYWHERE, View, directions_in
from .kinds import Search, search_kind
from .noise import Noise
from .pairs import told_apart, worthwhile
from .polish import novelty, separate_fit
from .projector import Bases, Projector
from .refine import Linearization, joint_fit, linearize
from .search import Effort, StagedSearch, distinct
from .sound import pruned, sounder
from .split import split
from .veiled import hidden, without_errors


@dataclass(frozen=True, eq=False)
class Nomp:
    """Newtonized orthogonal matching pursuit with a calibrated stop.

    Parameters
    ----------
    model : the link
    false_alarm_rate : expected false paths per snapshot
    max_delay : longest delay searched [s]; default: the unambiguous range. Paths beyond it alias into it unseen; with a
        shorter max_delay those between the two are found outside (:attr:`~estimation.Flag.EDGE_OF_VIEW`)
    max_speed : largest |radial velocity| searched [m/s]
    arrival_view, departure_view : directions searched, in the arrays' parent frames
    dynamic_range : several peaks are accepted in one pass only within this ratio of the strongest [dB];
        sidelobes lie below
    max_paths : give up looking for more (:attr:`~estimation.Flag.LIMITED` then)
    max_seconds : the same for the time spent on a burst; what is found by then is reported
    model_error_db : energy relative to a path that errors of its model are taken to have in any one mode; whatever is given,
        the error is also measured on every burst (:mod:`~.floor`)
    calibration : noise-only searches that measure the effective search volume when the estimator is made; 0 takes the share
        of Rice's volume that searches find as a rule (:data:`~.detect.SHARE`) and no time
    threshold : fixed threshold on rho instead of a false-alarm rate
    dense_multipath : estimate the delay profile of dense multipath from the residual and whiten it (the reported noise
        variance is then relative to that profile, that is 1)
    white : take the noise for equal and independent at all ports; otherwise, where more seems to arrive than paths explain,
        its covariance over the ports is estimated and the burst searched anew (the reported noise variance is then the
        mean over the ports)
    resolve : look for close pairs: candidates count by what they add to the known paths, and pairs are tried in place of
        single paths; sensible once a joint fit has converged
    search_options : further arguments of the coarse search's ``build`` (oversampling, retained, ...)
    """

    model: SignalModel
    false_alarm_rate: float = 0.01
    max_delay: float | None = None
    max_speed: float = 25.0
    arrival_view: View = EVERYWHERE
    departure_view: View = EVERYWHERE
    dynamic_range: float = 10.0
    max_paths: int = 40
    max_seconds: float | None = None
    model_error_db: float | None = None
    calibration: int = 0
    threshold: float | None = None
    dense_multipath: bool = False
    white: bool = False
    resolve: bool = True
    search_options: dict = field(default_factory=dict)
    _search: Search = field(init=False, repr=False)
    _basis: Bases = field(init=False, repr=False)
    volume: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        period = self.model.max_delay
        longest = period if self.max_delay is None else self.max_delay
        if not 0 <= longest <= period * (1 + 1e-9):
            raise ModelError(
                f"Nomp: max_delay {longest:.3e} s must lie between 0 and the unambiguous {period:.3e} "
                "s of the pilot spacing"
            )
        if not (np.isfinite(self.max_speed) and self.max_speed >= 0):
            raise ModelError(f"Nomp: max_speed must be finite and not negative, got {self.max_speed} m/s")
        object.__setattr__(self, "max_delay", longest)
        if self.model.schedule.precoders is not None and self.max_speed > 0:
            check_schedule(self.model, self.max_speed, self.departure_view)
        search = search_kind(self.model).build(
            self.model, longest, self.max_speed, self.arrival_view, self.departure_view, **self.search_options
        )
        object.__setattr__(self, "_search", search)
        object.__setattr__(self, "_basis", Bases.build(self.model))
        arrivals, arrival_angle = directions_in(self.arrival_view, self.model.receiver)
        departures, departure_angle = directions_in(self.departure_view, self.model.transmitter)
        speeds, angles = (-self.max_speed, self.max_speed), (arrival_angle, departure_angle)
        volume = search_volume(self.model, longest, speeds, arrivals, departures, angles)
        object.__setattr__(self, "volume", volume)
        if self.threshold is None:
            searched = SHARE * volume
            if self.calibration:
                searched = calibrated_volume(self.suprema(self.calibration), volume, self.parameters)
            object.__setattr__(self, "volume", searched)
        if self.threshold is None:
            object.__setattr__(self, "threshold", threshold_for(self.false_alarm_rate, self.volume, self.parameters))

    @property
    def level(self) -> float:
        """The threshold on rho in force; nothing passes before the calibration has set one."""
        return np.inf if self.threshold is None else float(self.threshold)

    @property
    def parameters(self) -> int:
        """Number of observable parameters per path."""
        return int(self.model.active.sum())

    def suprema(self, count: int, seed: int = 0):
        """Largest statistics (count,) found in noise alone: the material of the calibration."""
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
        largest = []
        for _ in range(count):
            data = Projector(self.model, white_noise(self.model.shape, 1.0, rng), self._basis)
            filtered = self._search.filtered(data)
            largest.append(self._candidates(data, filtered, None, 1.0, self._search.full)[1].max(initial=1.0))
        return np.array(largest)

    def run(
        self, signal, noise_variance: float | None = None, prior: PathTable | Detections | None = None
    ) -> Detections:
        """Estimate all paths in a received signal (``model.shape``).

        Parameters
        ----------
        signal : received burst
        noise_variance : of the noise before combining; estimated from the residual if not given
        prior : predicted paths to start from (warm start); those not found in the data are eliminated again

        Raises
        ------
        SignalError
            if the signal does not fit the model or is not finite.
        """
        signal, energy = self.model.measured(signal)
        white = self.model.whiten(signal)
        start = None
        if not energy:
            return report.empty(self, 0.0 if noise_variance is None else noise_variance)
        if prior is not None and len(prior):
            start = (prior.table if isinstance(prior, Detections) else prior).geometry
        if not self.dense_multipath:
            energy = energy if white is signal else None
            data, lin, noise = self._search_all(self.model, white, start, noise_variance, energy=energy)
            if noise.ports is not None:
                told = replace(self.model, port_covariance=noise.ports)
                left = noise.clock.left
                told_so = replace(self, model=told, threshold=self.level, white=True, max_seconds=left)
                return told_so.run(signal, prior=prior)
            return self._reported(data, lin, noise)
        model = self.model
        for inflation in (10.0, 1.0):
            # First only what stands out clearly, lest false paths carry off the dense multipath
            # that is to be measured.
            _, lin, _ = self._search_all(model, white, start, noise_variance, inflation)
            residual = white if lin is None else white - signal_of(model, lin.blocks, lin.gain)
            model = replace(self.model, pilot_covariance=pilot_covariance(residual, model.waveform))
            start, noise_variance = None if lin is None else lin.geometry, 1.0
        return self._reported(*self._search_all(model, white, start, noise_variance))

    def _search_all(
        self,
        model: SignalModel,
        white,
        start: Geometry | None,
        noise_variance: float | None,
        inflation: float = 1.0,
        energy: float | None = None,
    ) -> tuple[Projector, Linearization | None, Noise]:
        """All passes of the search on a whitened signal, whose ``energy`` may be known already."""
        data = Projector(model, model.weighted(white), self._basis)
        if energy is None:
            energy = float(np.vdot(white, data.signal).real)
        noise = Noise(energy, white.size, noise_variance, inflation, clock=Clock.of(self.max_seconds))
        filtered: Any = self._search.filtered(data)  # in a form of its own
        lin = None
        if start is not None and len(start):
            lin = self._eliminated(data, self._fit(data, start, noise), noise)
        efforts, spare, height = self._search.efforts, None, 0.0
        due = np.inf if self.white or model.weight is not None or model.subbands > 1 else MANY
        while efforts and not noise.clock.over:
            variance = noise.variance(lin)
            residual = filtered
            if lin is not None and model.subbands > 1:
                # A path that squints is not one outer product: take it out of the data and filter again.
                rest = data.signal - signal_of(model, lin.blocks, lin.gain)
                residual = self._search.filtered(Projector(model, rest, self._basis))
            elif lin is not None:
                spare = residual = self._search.without(filtered, weighted_blocks(model, lin.blocks), lin.gain, spare)
            found, statistic = self._candidates(data, residual, lin, variance, efforts[0])
            endless = lin is not None and len(lin.gain) >= due and int(np.sum(statistic > self.level)) >= SEVERAL
            raw, (found, statistic) = statistic, self._credible(data, lin, variance, found, statistic)
            if lin is not None and hidden(model, raw, statistic, self.level):
                rest = without_errors(self._search, Floor(data, lin, variance), filtered, self.level)
                again = self._credible(data, lin, variance, *self._candidates(data, rest, lin, variance, efforts[0]))
                if again[1].max(initial=0.0) > self.level:  # else what is seen may be the lobes of a pair
                    found, statistic = again
            if endless and lin is not None:
                due *= 2
                noise = heard(model, white, lin, noise)
                if noise.ports is not None:
                    return data, lin, noise
            told = cleared(self, white, lin, noise, found, statistic)
            if told is not None:
                (data, lin, noise), spare = told, None
                filtered = self._search.filtered(data)
                continue
            if lin is not None and len(lin.gain) < self.max_paths and not noise.hazes:
                better, height = sounder(self, data, lin, noise, float(statistic.max(initial=0.0)), height)
                if better is not None:
                    lin = better
                    continue
            if lin is not None and len(lin.gain) >= self.max_paths:
                break
            accepted, more = accepted_of(self, found, statistic, None if lin is None else lin.geometry)
            if len(accepted):
                start = accepted if lin is None else lin.geometry.joined(accepted)
                grown = self._eliminated(data, self._fit(data, start, noise), noise)
                # A pass that ends with neither more paths nor better ones would repeat itself for ever.
                if self._better(grown, lin, noise):
                    lin = grown
                else:
                    accepted, more = accepted.take([]), False
            if not len(accepted) and lin is not None and len(efforts) == 1 and self.resolve:
                resolved = split(self, data, lin, found, statistic, noise)
                if resolved is not None:
                    lin = resolved
                    continue
            # A quick pass is for paths that stand out; the last of them leaves nothing that would.
            faint = len(statistic) and statistic[0] < FAINT * self.level
            if not len(accepted) or (not more if len(efforts) == 1 else faint):
                efforts.pop(0)
        limited = bool(efforts)
        if limited and lin is not None and due < np.inf:
            noise = heard(model, white, lin, noise)
        if noise.ports is None:
            lin = standing_out(self, data, pruned(self, data, lin, noise), noise)
        return data, lin, replace(noise, limited=limited)

    def _credible(self, data: Projector, lin: Linearization | None, variance: float, found: Geometry, statistic):
        """Candidates with statistics in terms of the noise about them, and those beyond the searched region where they
        are.
        """
        if not len(statistic) or statistic[0] <= self.level:
            return found, statistic
        floor = Floor(data, lin, variance, self.error_share)
        if statistic[0] > STRONG * self.level:
            limits = float(self.max_delay or 0.0), self.max_speed
            grids = self._search.arrivals, self._search.departures
            outside = beyond(floor, found.take([0]), statistic[0] * variance, *limits, grids)
            if outside is not None:
                worth = statistic[:1] / floor.over(outside, statistic[:1])
                if worth[0] > self.level:
                    return outside, worth
        strong = np.flatnonzero(statistic > self.level)
        statistic = statistic.copy()
        statistic[strong] /= floor.over(found.take(strong), statistic[strong])
        order = np.argsort(-statistic, kind="stable")
        return found.take(order), statistic[order]

    @property
    def error_share(self) -> float:
        """Energy of a model's error relative to its path, as given."""
        return 0.0 if self.model_error_db is None else 10 ** (self.model_error_db / 10)

    def _better(self, grown: Linearization | None, lin: Linearization | None, noise: Noise) -> bool:
        """Whether a fit is progress: it has more paths, or explains more by the worth of one with no more."""
        if grown is None or lin is None:
            return grown is not None
        gained = grown.explained - lin.explained
        return len(grown.gain) > len(lin.gain) or gained > self.level * noise.variance(grown)

    def _reported(self, data: Projector, lin: Linearization | None, noise: Noise) -> Detections:
        if lin is None:
            return report.empty(self, noise.variance(None))
        lin = self._fit(data, lin, noise, tolerance=3e-3)
        single = len(lin.gain)
        lin, spread = told_apart(self, data, lin, noise) if self.resolve else (lin, np.zeros((single, 6, 6)))
        if len(lin.gain) > single:
            lin = self._fit(data, lin, noise, tolerance=3e-3)
        lin, spread = worthwhile(self, data, lin, spread, noise)
        limited = noise.limited or noise.clock.over
        return report.detections(self, data, lin, noise.variance(lin), spread, limited, noise.hazes)

    def _fit(
        self, data: Projector, start: Geometry | Linearization, noise: Noise, tolerance: float = 0.5
    ) -> Linearization:
        """Refine all paths until the predicted gain in log-likelihood falls below ``tolerance``."""
        lin = start if isinstance(start, Linearization) else linearize(data, start)
        return joint_fit(data, lin, noise.variance(lin), tolerance, clock=noise.clock)

    def _candidates(self, data: Projector, residual, lin: Linearization | None, variance: float, effort: Effort):
        """Refined candidates in a filtered residual (the paths ``lin`` are out of it) and their statistics,
        strongest first.
        """
        model = data.model
        scale = None
        if model.weight is not None:
            # Cells of delays with much dense power carry less signal: equal noise in every cell again.
            scale = self._search.delay.equalizer(model.waveform.frequencies, model.weight)
        interest = self.level * variance
        points = self._search.candidates(residual, effort, variance, interest, scale)
        if not len(points):
            return points, np.zeros(0)
        points, energies = self._refined(data, residual, lin, points, variance)
        significant = np.flatnonzero(energies > max(interest, 10 ** (-self.dynamic_range / 10) * energies.max()))
        if isinstance(self._search, StagedSearch) and len(significant) and model.subbands == 1:
            overlap = coherence(model, points.take(significant))
            significant = significant[distinct(overlap, energies[significant], len(significant), limit=0.25)]
            peaks = points.take(significant)
            cells = self._search.projector(data, residual, lin, peaks)
            rivals = self._search.alternatives(model, cells, peaks, energies[significant])  # pyright: ignore[reportArgumentType]  # without sub-bands
            if len(rivals):
                rivals, rival_energies = self._refined(data, residual, lin, rivals, variance)
                points, energies = points.joined(rivals), np.concatenate([energies, rival_energies])
        order = np.argsort(energies)[::-1]
        return points.take(order), energies[order] / variance

    def _refined(self, data: Projector, residual, lin: Linearization | None, points: Geometry, variance: float):
        """Points moved to their peaks, and the energies that they would add to what is explained."""
        known = lin if self.resolve else None
        fresh = novelty(data.model, points, known)
        cells = self._search.projector(data, residual, lin, points)
        points, energies = separate_fit(cells, points, variance, self.level * variance, novel=fresh)
        return points, energies if fresh.min() > 0.9 else energies / novelty(data.model, points, known)

    def _eliminated(self, data: Projector, lin: Linearization | None, noise: Noise) -> Linearization | None:
        """Remove components that are not worth the threshold, weakest first and all at once that do not overlap."""
        while lin is not None:
            worth = lin.drop / noise.variance(lin)
            low = np.flatnonzero(worth < self.level)
            if not len(low):
                return lin
            if len(low) > 1:
                low = low[distinct(lin.coherence[np.ix_(low, low)], -worth[low], len(low), limit=0.2)]
            rest = np.delete(np.arange(len(worth)), low)
            lin = self._fit(data, lin.geometry.take(rest), noise) if len(rest) else None
        return None


MANY = 8
"""Paths from which on it is asked, if there are still more, whether they are none; again at twice as many."""
SEVERAL = 3
"""Candidates that make it worth asking."""
STRONG = 4.0
"""Above this multiple of the threshold the strongest candidate may be a side lobe of a path outside the searched region."""
FAINT = 10.0
"""Below this multiple of the threshold the strongest path of a pass ends the quick passes."""
