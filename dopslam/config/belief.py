"""The optional sections ``[experiment]`` and ``[belief]`` of a scenario: paper B's synthetic experiment (Section VI-B)
and what its belief-propagation filter assumes.

Anchor, virtual anchors, scatterers, carrier, bandwidth and nominal track are those of the scenario's other sections.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from dopslam.config.types import (
    Chance,
    Decibel,
    Deviation,
    Frozen,
    Index,
    NonNegative,
    Positive,
    Probability,
    Share,
)

Amounts = Annotated[tuple[Positive, ...], Field(min_length=2, max_length=1000)]
FalseAlarms = Annotated[float, Field(ge=1e-9, le=1e4)]


class ExperimentConfig(Frozen):
    """What is drawn: amplitudes that fall with the path length, Fisher variances, Rician detection, false alarms."""

    amplitudes: Amounts  # normalized: line of sight, VAs, scatterers
    reference_distances: Amounts  # m, where a path has that amplitude
    rx_aperture_wavelengths: Positive = 0.90  # root of the squared array aperture D²
    tx_aperture_wavelengths: Positive = 2.30
    samples: Positive = 1024.0 * 128 * 64  # N_s behind the amplitudes
    threshold_db: Decibel = 9.0  # detection SNR γ²
    false_alarms: FalseAlarms = 2.0  # mean per step
    distance_end: Positive = 80.0  # m, of false alarms
    spurious: Annotated[float, Field(ge=0, le=1e4)] = 0.0  # further false alarms per step, as strong as paths
    spurious_end: Positive = 15.0  # their largest amplitude
    blocked: tuple[Index, Index] | None = None  # steps [first, last) without line of sight
    heading_noise_deg: Deviation = 0.3  # of the walk, per step
    speed_noise: Deviation = 0.005  # m/s per step
    climb_noise: Deviation = 0.0  # m/s per step
    spatial: bool = False  # elevations measured, features in three dimensions

    @model_validator(mode="after")
    def _consistent(self):
        if len(self.amplitudes) != len(self.reference_distances):
            raise ValueError(
                f"amplitudes has {len(self.amplitudes)} entries, reference_distances {len(self.reference_distances)}: "
                "give one of each per path, the line of sight first"
            )
        if self.blocked is not None and self.blocked[0] > self.blocked[1]:
            raise ValueError(f"blocked = {list(self.blocked)}: the first step comes after the last")
        return self


class BeliefConfig(Frozen):
    """What the belief-propagation filter assumes (paper B, Sections IV and VI-A).

    ``start``, ``engine``, ``backend``, ``speed_increment`` and ``skip`` belong to the synthetic experiment; on a scene's
    detections the filter is Rao-Blackwellized and starts and moves as ``[track]`` says, like the other filters.
    """

    # single_bounce: VAs with and without AOD, and scatterers. None: paper in the synthetic experiment, else single_bounce.
    types: Literal["paper", "aod_for_va", "single_bounce", "va_only", "ps_only"] | None = None
    # conditional: features given the agent, correlation kept, with Doppler; independent: the paper's marginals
    features: Literal["conditional", "independent"] = "conditional"
    agent: Literal["particles", "gaussian"] = "particles"  # of the conditional form
    start: Literal["informed", "uniform"] = "informed"  # by the first line of sight, or not
    engine: Literal["rao_blackwellized", "stacked"] = "rao_blackwellized"
    backend: Literal["drjit", "numba", "numpy"] = "drjit"  # of the stacked engine
    speed_increment: Deviation = 0.02  # m/s per step and axis
    survival: Chance = 0.999
    birth_rate: FalseAlarms = 0.05  # new features per step
    type_switch: Share = 0.01
    position_walk: Deviation = 1e-3  # m per step and axis
    amplitude_walk: NonNegative = 0.05  # relative, per step
    reacquisition: Share = 0.02  # weight of a uniform amplitude: lets features return
    false_alarm_tail: Share | None = None  # None: 0.1, without spurious peaks 0
    detection_threshold: Probability = 0.5
    pruning_threshold: Probability = 1e-3
    skip: Index | None = None  # first steps left out of the RMSE; None: 20 for the uniform start, else 0
