"""Records of the belief-propagation filters: what they read, what they are told, what they answer.

World frame, SI units, radians. Planar problems are three-dimensional ones in the plane z = const: directions
are unit vectors throughout, so no angle is ever wrapped and no pole excluded; a planar scan has one tangent
coordinate per direction (azimuth), a spatial one two (azimuth, elevation).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

import numpy as np

from dopslam.errors import FilterError
from dopslam.models.amplitude import AmplitudeModel, ConstantDetection


class Form(IntEnum):
    """Form of a likelihood: which path model explains distance, AOA and AOD.

    ``LOS`` eq. (9); ``VA`` eq. (8), a virtual anchor that explains distance and AOA only, its AOD left
    uniform; ``PS`` eq. (10); ``VA_AOD`` a virtual anchor of one reflection that explains the AOD as well,
    through the mirror law (the paper's future work).
    """

    LOS = 0
    VA = 1
    PS = 2
    VA_AOD = 3


PAPER = (Form.VA, Form.PS)
AOD_FOR_VA = (Form.VA_AOD, Form.PS)
AOD_FOR_SINGLE_BOUNCE = (Form.VA_AOD, Form.PS, Form.VA)  # the third: reflections of higher order
TYPES = {
    "paper": PAPER,
    "aod_for_va": AOD_FOR_VA,
    "single_bounce": AOD_FOR_SINGLE_BOUNCE,
    "va_only": (Form.VA,),
    "ps_only": (Form.PS,),
}


@dataclass(frozen=True, slots=True)
class Scan:
    """Measurements of one step at one anchor.

    Attributes
    ----------
    distance : (M,) path length c·τ, bias included [m]
    aoa : (M, 3) unit vectors towards the arriving path, receiver's frame (x axis along the heading)
    aod : (M, 3) unit vectors of departure, world frame
    amplitude : (M,) normalized amplitudes
    covariance : (M, n, n) of (distance, AOA tangents, AOD tangents) at the measured amplitude; n = 3 in the
        plane (azimuth tangents), 5 in space (azimuth, then elevation tangents of each direction); with radial
        velocities one row and column more, the last
    radial_velocity : (M,) m/s, positive when approaching, or None
    """

    distance: np.ndarray
    aoa: np.ndarray
    aod: np.ndarray
    amplitude: np.ndarray
    covariance: np.ndarray
    radial_velocity: np.ndarray | None = None

    def __post_init__(self):
        rows = len(self.distance)
        shapes = {"aoa": (rows, 3), "aod": (rows, 3), "amplitude": (rows,)}
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise FilterError(f"Scan.{name} has shape {getattr(self, name).shape}, expected {shape}")
        n, allowed = self.covariance.shape[-1], (3, 5) if self.radial_velocity is None else (4, 6)
        if self.covariance.shape != (rows, n, n) or n not in allowed:
            raise FilterError(
                f"Scan.covariance has shape {self.covariance.shape}, expected ({rows}, n, n), n {allowed[0]} or {allowed[1]}"
            )

    def __len__(self) -> int:
        return len(self.distance)

    @property
    def tangents(self) -> int:
        """Tangent coordinates per direction: 1 in the plane, 2 in space."""
        return (self.covariance.shape[-1] - 1) // 2  # the row of radial velocity, if any, does not change it

    def select(self, rows) -> Scan:
        """The scan restricted to some of its measurements."""
        return Scan(
            self.distance[rows], self.aoa[rows], self.aod[rows], self.amplitude[rows], self.covariance[rows],
            None if self.radial_velocity is None else self.radial_velocity[rows],
        )  # fmt: skip

    @property
    def without_doppler(self) -> Scan:
        """The scan without radial velocities."""
        if self.radial_velocity is None:
            return self
        covariance = np.ascontiguousarray(self.covariance[:, :-1, :-1])
        return Scan(self.distance, self.aoa, self.aod, self.amplitude, covariance)


@dataclass(frozen=True, slots=True, kw_only=True)
class Assumptions:
    """What a filter assumes whatever the scene (paper B, Sections IV and VI-A).

    Parameters
    ----------
    types : likelihood forms of the feature types, e.g. :data:`PAPER` or :data:`AOD_FOR_VA`
    type_switch : total probability to leave a type in one step (off-diagonal mass of a row of [Q])
    survival : p_s
    birth_rate : μ_n, mean number of new features per step
    position_walk : σ_y per step and axis [m]; must be far below the motion of an incidence point per step
    amplitude_walk : relative standard deviation of the amplitude's random walk per step
    reacquisition : weight of a uniform amplitude in the likelihood, lets a blocked feature return (guard g3)
    detection_threshold, pruning_threshold : on the existence probability
    features : ``"conditional"`` keeps the correlation of the features with the agent; ``"independent"`` keeps the
        marginals only, as the paper does, and believes too much
    agent : ``"particles"`` or ``"gaussian"``, of the conditional form
    """

    types: tuple[Form, ...] = PAPER
    features: Literal["conditional", "independent"] = "conditional"
    agent: Literal["particles", "gaussian"] = "particles"
    type_switch: float = 0.01
    survival: float = 0.999
    birth_rate: float = 0.05
    position_walk: float = 1e-3
    amplitude_walk: float = 0.05
    reacquisition: float = 0.02
    detection_threshold: float = 0.5
    pruning_threshold: float = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameters(Assumptions):
    """What a filter is told about map and detector, beside its assumptions.

    Parameters
    ----------
    anchor : (3,) position of the physical anchor [m], world frame
    amplitude : statistics of the estimated amplitudes
    type_prior : prior of the types at birth; uniform if None
    volume : area [m²] or volume [m³] in which new features are uniform
    amplitude_end : u_max, new features' amplitudes are uniform in [0, u_max]
    false_alarm_rate : μ_fa per step
    distance_end : d_max [m], false alarms' distances are uniform in [0, d_max]
    return_probability : probability that a vanished line of sight returns in one step
    spatial : whether features have three unknown coordinates
    rescale_covariance : whether the scan's covariances scale with 1/u² and are re-evaluated at the filtered
        amplitude
    """

    anchor: np.ndarray
    amplitude: AmplitudeModel | ConstantDetection
    type_prior: tuple[float, ...] | None = None
    volume: float = 160.0**2
    amplitude_end: float = 200.0
    false_alarm_rate: float = 2.0
    distance_end: float = 80.0
    return_probability: float = 0.02
    rescale_covariance: bool = True
    spatial: bool = False

    def __post_init__(self):
        if not self.types or Form.LOS in self.types or len(set(self.types)) != len(self.types):
            raise FilterError(f"Parameters.types must be distinct forms among VA, PS, VA_AOD, got {self.types}")
        if self.type_prior is not None and len(self.type_prior) != len(self.types):
            raise FilterError(f"Parameters.type_prior has {len(self.type_prior)} entries for {len(self.types)} types")

    @property
    def prior(self) -> np.ndarray:
        """(T,) prior of the types at birth."""
        if self.type_prior is None:
            return np.full(len(self.types), 1 / len(self.types))
        return np.asarray(self.type_prior, float)

    @property
    def transition(self) -> np.ndarray:
        """(T, T) row-stochastic matrix [Q] of the type chain."""
        count = len(self.types)
        if count == 1:
            return np.ones((1, 1))
        off = self.type_switch / (count - 1)
        return np.full((count, count), off) + np.eye(count) * (1 - self.type_switch - off)

    def log_false_alarm(self, scan: Scan) -> np.ndarray:
        """(M,) ln [μ_fa f_fa(z_m)] over distance, both directions and amplitude (paper B, Section IV-B3)."""
        direction = 2 * np.pi if scan.tangents == 1 else 4 * np.pi
        constant = np.log(self.false_alarm_rate / self.distance_end) - 2 * np.log(direction)
        return constant + self.amplitude.log_false_alarm(scan.amplitude)


@dataclass(frozen=True, slots=True)
class Features:
    """Potential features K with T types: Gaussians per type, existence and amplitude.

    Attributes
    ----------
    label : (K,) int, number given at birth
    weight : (K, T) joint probability of existence and type; the sum over T is the existence probability
    mean : (K, T, 3), covariance : (K, T, 3, 3) of the position given the type [m]
    amplitude : (K, 2) mean and variance of the normalized amplitude
    """

    label: np.ndarray
    weight: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    amplitude: np.ndarray

    def __len__(self) -> int:
        return len(self.label)

    @property
    def existence(self) -> np.ndarray:
        """(K,) existence probabilities."""
        return self.weight.sum(axis=1)

    def select(self, rows) -> Features:
        """Some of the features."""
        return Features(
            self.label[rows], self.weight[rows], self.mean[rows], self.covariance[rows], self.amplitude[rows]
        )

    @staticmethod
    def empty(types: int) -> Features:
        """No feature."""
        return Features(
            np.zeros(0, int),
            np.zeros((0, types)),
            np.zeros((0, types, 3)),
            np.zeros((0, types, 3, 3)),
            np.zeros((0, 2)),
        )

    @staticmethod
    def join(first: Features, second: Features) -> Features:
        """Both sets, one behind the other."""
        return Features(
            *(
                np.concatenate([getattr(first, name), getattr(second, name)])
                for name in ("label", "weight", "mean", "covariance", "amplitude")
            )
        )


@dataclass(frozen=True, slots=True)
class Estimate:
    """MMSE estimates after a step, eqs. (16)–(18).

    Attributes
    ----------
    position : (3,) m, covariance : (3, 3) m², velocity : (3,) m/s
    heading : rad, circular mean; heading_deviation : rad
    bias : m
    state_covariance : (4, 4) of [x m, y m, heading rad, bias m]
    label, existence : (D,) of the declared features
    type_belief : (D, T) type probabilities given existence
    feature : (D, 3) m, position under the likeliest type; feature_covariance : (D, 3, 3)
    amplitude : (D,) mean normalized amplitudes
    """

    position: np.ndarray
    covariance: np.ndarray
    velocity: np.ndarray
    heading: float
    heading_deviation: float
    bias: float
    state_covariance: np.ndarray
    label: np.ndarray
    existence: np.ndarray
    type_belief: np.ndarray
    feature: np.ndarray
    feature_covariance: np.ndarray
    amplitude: np.ndarray


@dataclass(frozen=True, slots=True)
class Info:
    """Diagnostics of a step, carried by nobody.

    Attributes
    ----------
    estimate : the step's estimates
    effective : effective sample size of the agent's particles after the update
    stages : annealing stages used, 0 when the plain update sufficed
    association : (K + 1, M + 1) association probabilities; row 0 is the line of sight, column 0 missed
    line_of_sight : probability that the line of sight exists
    features : number of potential features carried
    """

    estimate: Estimate
    effective: float
    stages: int
    association: np.ndarray
    line_of_sight: float
    features: int
