"""Bursts that no estimator was told of: hardware that is off, paths outside the searched region, noise that is not white, echoes
that are no paths. How many ghosts they make, how long they take beside a clean burst, and whether the paths still know how
sure they are.

One link (64 pilots over 400 MHz, 16 symbols, 4 x 4 elements at either end) with six paths, the strongest of rho 50 dB, the
others 22 to 45 dB; paths, noise and errors follow from the seed alone, and are the same in every case.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from .estimators.grids import EVERYWHERE
from .estimators.nomp import Nomp
from .evaluate import associate
from .scenarios import FRONT, Draw, at_snr, draw_paths, reference_link
from .signal.arrays import Array, Complex, Manifold
from .signal.directions import unit_vectors
from .signal.impairments import Impairments
from .signal.model import SignalModel
from .signal.noise import white_noise
from .signal.paths import PathTable
from .signal.synthesis import synthesize
from .statistics import bootstrap

WIDE = 400.0
"""Squared Mahalanobis distance up to which a detection is of a path: errors of a wrong model may exceed what it says."""
STRONG = 28.0
"""Paths above this rho [dB] are to be found whatever the case; weaker ones may drown."""


@dataclass(frozen=True)
class Case:
    """What is wrong: the hardware, the paths, what is added to the signal, and the noise variance that is said."""

    hardware: Impairments = field(default_factory=Impairments)
    moved: Callable[[PathTable], PathTable] = lambda paths: paths
    added: Callable[[SignalModel, np.random.Generator], Complex] | None = None
    said: float | None = None
    max_delay: float | None = None


def echoes(decibel: float, clusters: int = 3, rays: int = 300) -> Callable[[SignalModel, np.random.Generator], Complex]:
    """Clusters of micro-rays a few degrees and delay bins wide with an exponential profile, so strong per sample over unit
    noise.
    """

    def drawn(model: SignalModel, rng: np.random.Generator) -> Complex:
        own = np.repeat(np.arange(clusters), rays)
        spread = 6 / model.waveform.bandwidth
        first = rng.uniform(0.1, 0.6, clusters) * min(model.waveform.max_delay, 60 / model.waveform.bandwidth)
        late = rng.exponential(spread, len(own))

        def ends():
            center = rng.uniform([-1, -0.5], [1, 0.5], (clusters, 2))
            return center[own] + rng.laplace(0, np.deg2rad(5) / np.sqrt(2), (len(own), 2))

        arrival, departure = ends(), ends()
        speed = rng.uniform(-15, 15, clusters)[own] + rng.normal(0, 0.5, len(own))
        gain = np.exp(-0.5 * late / spread) * (rng.standard_normal((len(own), 2)) @ [1, 1j])
        delay = (first[own] + late) % model.waveform.max_delay
        echo = synthesize(model, PathTable(delay, arrival, departure, speed, gain))
        return echo * np.sqrt(10 ** (decibel / 10) / np.mean(np.abs(echo) ** 2))

    return drawn


def interferer(decibel: float) -> Callable[[SignalModel, np.random.Generator], Complex]:
    """A transmitter in some direction, white in all else, so strong at an element over unit noise."""

    def drawn(model: SignalModel, rng: np.random.Generator) -> Complex:
        direction = unit_vectors(rng.uniform([-1, -0.5], [1, 0.5])[None])
        received = white_noise((*model.shape[:2], 1, *model.shape[3:]), 10 ** (decibel / 10), rng)
        return received * at_ports(model, model.receiver.response(direction)[0][0])

    return drawn


def at_ports(model: SignalModel, elements: Complex) -> Complex:
    """What elements (N_R,) receive, behind the combiners of each symbol, in axes that go with a signal's."""
    combiners, index = model.schedule.combiners, model.schedule.combiner_index
    rest = (1,) * (len(model.shape) - 3)
    if combiners is None or index is None:
        return elements.reshape(1, 1, -1, *rest)
    return np.einsum("nrm,r->nm", combiners[index].conj(), elements).reshape(1, *model.shape[1:3], *rest)


def louder(axis: int, decibel: float) -> Callable[[SignalModel, np.random.Generator], Complex]:
    """One pilot (axis 0) or symbol (1) of so much more noise."""

    def drawn(model: SignalModel, rng: np.random.Generator) -> Complex:
        noise = white_noise(model.shape, 10 ** (decibel / 10), rng)
        only = np.zeros(model.shape[axis])
        only[rng.integers(model.shape[axis])] = 1
        return noise * only.reshape([-1 if a == axis else 1 for a in range(noise.ndim)])

    return drawn


def unequal(model: SignalModel, rng: np.random.Generator) -> Complex:
    """Further noise at every port, of a variance of its own: exponentially distributed, twice that of the noise on average."""
    variance = rng.exponential(2, model.shape[2]).reshape(1, 1, -1, *(1,) * (len(model.shape) - 3))
    return white_noise(model.shape, 1.0, rng) * np.sqrt(variance)


def _lead(name: str, value: float) -> Callable[[PathTable], PathTable]:
    """The strongest path with another delay or speed."""

    def moved(paths: PathTable) -> PathTable:
        return replace(paths, **{name: np.r_[value, getattr(paths, name)[1:]]})

    return moved


CASES: dict[str, Case] = {
    "clean": Case(),
    "positions 0.005": Case(Impairments(position=0.005)),
    "positions 0.01": Case(Impairments(position=0.01)),
    "gain 0.5 dB, 5 deg": Case(Impairments(gain_db=0.5, phase_deg=5)),
    "phase noise 3 deg": Case(Impairments(phase_noise_deg=3)),
    "phase noise 10 deg": Case(Impairments(phase_noise_deg=10)),
    "path at 40 m/s": Case(moved=_lead("radial_velocity", 40.0)),
    "path at 150 of 145 ns": Case(moved=_lead("delay", 150e-9), max_delay=145e-9),
    "half the variance": Case(said=0.5),
    "interferer 10 dB": Case(added=interferer(10.0)),
    "bad symbol 20 dB": Case(added=louder(1, 20.0)),
    "bad pilot 20 dB": Case(added=louder(0, 20.0)),
    "unequal ports": Case(added=unequal),
    "echoes -10 dB": Case(added=echoes(-10.0)),
    "echoes -5 dB": Case(added=echoes(-5.0)),
    "echoes 0 dB": Case(added=echoes(0.0)),
}


def burst(case: Case, seed: int, model: SignalModel | None = None) -> dict:
    """One burst: ``ghosts``, ``seconds`` of processor time, shares ``found`` of all paths and of the ``strong`` ones, and each
    found path's ``nees`` over its dimension.
    """
    model = reference_link(64, 16, (4, 4), (4, 4)) if model is None else model
    paths_rng, noise_rng, added_rng = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3))
    drawn = draw_paths(model, paths_rng, Draw(paths=6, separation=1.5))
    decibel = np.r_[50.0, paths_rng.uniform(22, 45, 5)]
    paths = case.moved(at_snr(model, drawn, 10 ** (decibel / 10)))
    signal = case.hardware.signal(model, paths, 1.0, noise_rng, seed)
    if case.added is not None:
        signal = (signal + case.added(model, added_rng)).astype(np.complex64)
    views = [FRONT if _planar(array) else EVERYWHERE for array in (model.receiver, model.transmitter)]
    nomp = Nomp(model, max_delay=case.max_delay, arrival_view=views[0], departure_view=views[1])
    start = time.thread_time()
    found = nomp.run(signal, case.said)
    seconds = time.thread_time() - start
    match = associate(model, found, paths, 1.0, gate=WIDE)
    strong = match.rho > 10 ** (STRONG / 10)
    return {
        "ghosts": match.false,
        "seconds": seconds,
        "found": float(match.detected.mean()),
        "strong": float(match.detected[strong].mean()),
        "nees": (match.nees / match.error.shape[1]).tolist(),
    }


def _planar(array: Manifold) -> bool:
    return isinstance(array, Array) and array.normal is not None


def off_model(seeds: Iterable[int], cases: Iterable[str] = CASES) -> dict[str, dict]:
    """Figures of each case over bursts of given ``seeds``, with 95 % intervals; times also over those of the clean ones, if
    these are among the cases.
    """
    rows, clean = {}, None
    seeds = list(seeds)
    for name in cases:
        bursts = [burst(CASES[name], seed) for seed in seeds]
        ghosts, seconds = (np.array([b[key] for b in bursts], float) for key in ("ghosts", "seconds"))
        means = np.array([np.mean(b["nees"]) for b in bursts if b["nees"]])
        clean = seconds if name == "clean" else clean
        rows[name] = {
            "ghosts_per_snapshot": float(ghosts.mean()),
            "ghosts_interval": bootstrap(ghosts),
            "most_ghosts": int(ghosts.max()),
            "seconds": float(seconds.mean()),
            "most_seconds": float(seconds.max()),
            "over_clean": None if clean is None else float(seconds.mean() / clean.mean()),
            "nees_over_6": float(np.mean([v for b in bursts for v in b["nees"]])),
            "nees_interval": bootstrap(means),
            "nees_median": float(np.median([v for b in bursts for v in b["nees"]])),
            "found": float(np.mean([b["found"] for b in bursts])),
            "strong_found": float(np.mean([b["strong"] for b in bursts])),
            "snapshots": len(bursts),
        }
    return rows
