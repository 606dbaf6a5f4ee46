"""The contract of a filter; those that there are stand in :data:`dopslam.filters.FILTERS`.

A filter is a frozen record of choices. What it is told about the world is a :class:`Problem`, the same for all; what it
reads is one :class:`~dopslam.models.scans.Scans`. ``init`` and ``step`` are the recursion, one scan at a time; a filter
that has a faster way through a whole run gives ``run`` as well::

    class MyFilter:
        capabilities = Capabilities()

        def init(self, problem, rng): ...                     # -> state before the first scan
        def step(self, state, scan, rng): ...                 # -> state, Info(Estimate(...))

``dopslam slam FILE --filter my_module:MyFilter`` runs it. A state holds whatever the filter wants, its problem included.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np

from dopslam.errors import FilterError
from dopslam.models import ambiguity
from dopslam.models.detection import DetectionModel, SnrDetection
from dopslam.models.motion import CoordinatedTurn, MotionModel
from dopslam.models.scans import Scans, from_detections
from dopslam.records import BaseStations, DetectionSeries
from dopslam.slam import restart
from dopslam.slam.batch.start import guided
from dopslam.slam.history import Diagnostics, Estimate, History, answer_of_run, history_of_estimates, settled
from dopslam.slam.orientation import turnable
from estimation.plugins import blamed


@dataclass(frozen=True, slots=True)
class Problem:
    """All that any filter is told, and no more.

    Attributes
    ----------
    stations : BaseStations; known positions and orientations
    mean, covariance : (n,), (n, n); the receiver's state one period before the first scan, [x m, y m, heading rad,
        bias m, …], what follows as the motion model names it
    motion : MotionModel; how the receiver moves, eq. (1) or any other
    height : m, of the receiver's plane
    detection : DetectionModel or None; None: p_D follows ρ, with the threshold of the detections
    undetected : (VA, SP); initial intensity of undetected landmarks [m⁻³]
    births : (VA, SP); intensity added every step [m⁻³]
    survival : p_S of a landmark per step
    doppler_limit : m/s; largest radial velocity that detections can have, the width of clutter in Doppler
    snapshot : whether the start is found from the scans alone, and mean and covariance are withheld
    yaw_std : rad, standard deviation of the base stations' orientation; only where the start is found from the scans
    restart : whether a filter that has lost its receiver, by its own history, is started anew from the scans
    """

    stations: BaseStations
    mean: np.ndarray
    covariance: np.ndarray
    motion: MotionModel
    height: float = 0.0
    detection: DetectionModel | None = None
    undetected: tuple[float, float] = (1e-7, 4e-6)
    births: tuple[float, float] = (0.0, 0.0)
    survival: float = 1.0
    doppler_limit: float = 25.0
    snapshot: bool = False
    yaw_std: float = 0.0
    restart: bool = False

    def __post_init__(self) -> None:
        n = self.motion.dimension
        if np.shape(self.mean) != (n,) or np.shape(self.covariance) != (n, n):
            raise FilterError(
                f"Problem: mean {np.shape(self.mean)} and covariance {np.shape(self.covariance)} do not fit a motion model "
                f"of {n} states; give ({n},) and ({n}, {n})"
            )

    @property
    def anchor(self) -> np.ndarray:
        """(3,) m; position of the only base station."""
        return self.stations.position[0]

    @property
    def speed(self) -> float:
        """m/s, of a coordinated turn; a filter that reads it takes no other motion by its capabilities."""
        return self.motion.speed  # pyright: ignore[reportAttributeAccessIssue]

    def scans(self, detections: DetectionSeries) -> Scans:
        """Detections of a run as the filters read them, every delay in the turn of the link's range that the prior says.

        A start from the scans alone knows nothing of the receiver; then the delays themselves say where they begin, and
        the prior's clock bias only which of the turns is meant, which nothing else could say.
        """
        covariance = self.covariance
        if self.snapshot:
            covariance = covariance.copy()
            covariance[[0, 1, 3], [0, 1, 3]] += ambiguity.UNKNOWN**2
        told = ambiguity.unwrapped(detections, (self.mean, covariance), self.motion, self.anchor, self.height)
        return from_detections(
            told, bs_yaw=float(self.stations.yaw[0]), doppler_span=2 * self.doppler_limit, period=self.motion.interval
        )

    def detection_of(self, scans: Scans) -> DetectionModel:
        """The model of p_D, with the threshold of these detections where it follows their ρ.

        Raises
        ------
        FilterError
            If it shall follow ρ and the detections have no threshold.
        """
        if self.detection is not None:
            return self.detection
        if scans.threshold is None:
            raise FilterError(
                "Problem.detection is None, so that p_D follows the SNR, but the scans have no threshold; give "
                "Scans.threshold or a detection model"
            )
        return SnrDetection(scans.threshold)


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What a filter can do, as data.

    Attributes
    ----------
    doppler : whether it reads the Doppler row
    states : numbers of states of a coordinated turn that it can carry: 4, and 6 with speed and turn rate unknown
    any_motion : whether it carries every motion model there may be, not only coordinated turns
    stations : most base stations
    whole_run : whether every step's estimate uses the scans of the whole run, so that the smoothing bound is its own;
        such a filter finds its start from the scans by itself where the problem withholds it
    delayed : whether every step's estimate uses the scans up to ``lag`` steps later, an attribute of the filter
    intervals : whether it honours times between scans that are not the motion model's period
    """

    doppler: bool = True
    states: tuple[int, ...] = (4,)
    any_motion: bool = False
    stations: int = 1
    whole_run: bool = False
    delayed: bool = False
    intervals: bool = False


@dataclass(frozen=True, slots=True)
class Info:
    """What one step tells; nothing of it is carried on.

    Attributes
    ----------
    estimate : state and map after the scan
    nis, nis_rows : νᵀS⁻¹ν of the likeliest association and its degrees of freedom; 0 rows where a filter has none
    weights : (g,); normalized association weights, the likeliest first
    associations : (g, M); track of each measurement, −1 the BS, −2 new or clutter
    existence : (M,); predicted existence of the track each measurement went to
    passed_over : measurements that were not read at all, as pieces of one path
    """

    estimate: Estimate
    nis: float = float("nan")
    nis_rows: int = 0
    weights: np.ndarray = field(default_factory=lambda: np.ones(0))
    associations: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), np.int64))
    existence: np.ndarray = field(default_factory=lambda: np.ones(0))
    passed_over: int = 0


@runtime_checkable
class Filter(Protocol):
    """What every entry of :data:`dopslam.filters.FILTERS` is."""

    @property
    def capabilities(self) -> Capabilities:
        """What it can do; a class attribute where that is always the same."""
        ...

    def init(self, problem: Problem, rng: np.random.Generator) -> Any:
        """State before the first scan."""
        ...

    def step(self, state: Any, scan: Scans, rng: np.random.Generator) -> tuple[Any, Info]:
        """State after a scan (``Scans`` of one step), and what is to be told of it."""
        ...


def run(
    problem: Problem, detections: DetectionSeries | Scans, chosen: Filter, seed: int = 0
) -> tuple[History, Diagnostics]:
    """Track and map of a whole run.

    Parameters
    ----------
    problem : what the filter is told
    detections : of an estimator, or ready as measurements
    chosen : the filter
    seed : of its random numbers, if it draws any

    Raises
    ------
    FilterError
        If the filter cannot do what the problem asks, or fails; or no scan tells where the receiver starts.
    """
    scans = detections if isinstance(detections, Scans) else problem.scans(detections)
    check(chosen, problem, scans)
    able = chosen.capabilities
    doppler, reads_all, intervals = uses_doppler(chosen), able.whole_run, able.intervals

    def go(problem: Problem, scans: Scans) -> tuple[History, Diagnostics]:
        if not reads_all:
            problem, guide = guided(problem, scans, doppler)
            if guide is not None:
                problem, scans = guide.begun(problem, scans, 0, intervals)
        rng = np.random.default_rng(np.random.SeedSequence(seed))
        whole = getattr(chosen, "run", None)
        if whole is None:
            return run_steps(chosen, problem, scans, rng)
        with blamed(chosen, f"run: {type(chosen).__name__}", FilterError):
            return answer_of_run(whole(problem, scans, rng), scans.steps, f"{type(chosen).__name__}.run")

    with blamed(problem.motion, f"filter.motion: {type(problem.motion).__name__}", FilterError):
        if not problem.restart:
            history, told = go(problem, scans)
        else:
            history, told = restart.watched(problem, scans, go, whole=reads_all, doppler=doppler, intervals=intervals)
    return (turnable(history, problem.anchor, problem.yaw_std) if problem.yaw_std else history), told


def check(chosen: Filter, problem: Problem, scans: Scans) -> None:
    """Refuse what a filter cannot do, by its capabilities."""
    if not isinstance(chosen, Filter) or not isinstance(chosen.capabilities, Capabilities):
        raise FilterError(
            f"{chosen!r} is not a filter: it needs 'capabilities', 'init' and 'step' (see dopslam.slam.filter)"
        )
    name, able = type(chosen).__name__, chosen.capabilities
    if problem.yaw_std and not problem.snapshot:
        raise FilterError(
            "an uncertain orientation of the base station (base_station.yaw_std_deg) counts where nothing is told of the "
            'start: set filter.start = "snapshot", or leave it out'
        )
    if not isinstance(problem.motion, CoordinatedTurn) and not able.any_motion:
        raise FilterError(
            f"{name} carries coordinated turns only, the motion model is {type(problem.motion).__name__}; choose joint or "
            'marginal, or set filter.motion = "known", "unknown" or "walk" and filter.clock = "walk" or "free"'
        )
    if problem.motion.dimension not in able.states and not able.any_motion:
        raise FilterError(
            f"{name} carries {' or '.join(map(str, able.states))} states, the motion model has {problem.motion.dimension}; "
            'set filter.motion = "known" or choose another filter'
        )
    stations = max(len(problem.stations), 1 + int(scans.anchor.max(initial=0)))
    if stations > able.stations:
        raise FilterError(f"{name} knows {able.stations} base station(s), the problem has {stations}")
    if scans.interval is not None and not able.intervals:
        raise FilterError(
            f"{name} steps by the period of the motion model, {problem.motion.interval:g} s, but the scans are "
            f"{scans.interval.min():g} to {scans.interval.max():g} s apart; choose joint, smoother, marginal, bp, batch or interval, or resample"
        )


def run_steps(chosen: Filter, problem: Problem, scans: Scans, rng: np.random.Generator) -> tuple[History, Diagnostics]:
    """The recursion, one scan after the other: :func:`run` for filters without a way of their own."""
    who, told = type(chosen).__name__, []
    with blamed(chosen, f"init: {who}", FilterError):
        state = chosen.init(problem, rng)
    for k in range(scans.steps):
        with blamed(chosen, f"step {k}: {who}", FilterError):
            try:
                answer = chosen.step(state, scans.take([k]), rng)
            except (ValueError, ArithmeticError, IndexError, np.linalg.LinAlgError) as error:
                raise FilterError(f"step {k}: {who}: {error}") from error
        if not (isinstance(answer, tuple) and len(answer) == 2 and isinstance(answer[1], Info)):
            raise FilterError(f"step {k}: {who}.step must return (state, dopslam.Info(...)), got {_shown(answer)}")
        state, info = answer
        with blamed(chosen, f"step {k}: {who}", FilterError):
            estimate = settled(info.estimate, f"step {k}: {who}", told[0].estimate.mean if told else None)
            told.append(replace(info, estimate=estimate, nis=float(info.nis), nis_rows=int(info.nis_rows)))
    return history_of_estimates([info.estimate for info in told]), Diagnostics(
        nis=np.array([info.nis for info in told]),
        nis_rows=np.array([info.nis_rows for info in told], dtype=np.int64),
        weights=tuple(info.weights for info in told),
        associations=tuple(info.associations for info in told),
        existence=tuple(info.existence for info in told),
        passed_over=np.array([info.passed_over for info in told], dtype=np.int64),
    )


def _shown(answer: Any) -> str:
    return (
        f"({', '.join(type(part).__name__ for part in answer)})" if isinstance(answer, tuple) else type(answer).__name__
    )


def later(chosen: Filter) -> tuple[bool, int | None]:
    """Whether a filter's estimates use later scans than their own, and up to how many steps later; None: all of the run."""
    able = chosen.capabilities
    return able.whole_run or able.delayed, getattr(chosen, "lag", None) if able.delayed else None


def uses_doppler(chosen: Filter) -> bool:
    """Whether a filter, as chosen, reads the Doppler row."""
    return chosen.capabilities.doppler and getattr(chosen, "doppler", True)
