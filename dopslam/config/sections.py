"""The tables of ``scenario.toml``, each a frozen record, and all of them together as they are given."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from dopslam.config.arrays import ArrayConfig
from dopslam.config.belief import BeliefConfig, ExperimentConfig
from dopslam.config.drives import DatasetConfig
from dopslam.config.track import TrackConfig
from dopslam.config.types import (
    Chance,
    Coordinate,
    Count,
    Decibel,
    Few,
    Frozen,
    Hertz,
    NonNegative,
    Positive,
    Probability,
    Seconds,
    Seed,
    Vector3,
)
from dopslam.errors import ConfigError
from dopslam.filters import FILTERS, MOTIONS

Pilots = Annotated[
    tuple[Annotated[int, Field(ge=-1_000_000, le=1_000_000)], ...], Field(min_length=1, max_length=100_000)
]
Stagger = Annotated[tuple[Annotated[int, Field(ge=0, le=1000)], ...], Field(min_length=1, max_length=100)]
Spread = Annotated[float, Field(ge=1e-9, le=1e6)]


class Scene(Frozen):
    """Where the geometry comes from: a Mitsuba XML beside the scenario, a scene that ships with Sionna RT, or a generator
    (:mod:`dopslam.scenes.generators`), which also makes whatever the scenario leaves out. None of them: nothing to trace."""

    file: str | None = None
    builtin: str | None = None
    generator: str | None = None  # street, plaza, room, corridor, hall
    seed: Seed = 0  # of the generator
    options: dict[str, float | tuple[float, float]] = Field(
        default_factory=dict
    )  # of the generator, or [least, largest]
    materials: dict[str, str] = Field(
        default_factory=dict
    )  # material in the file → material used, e.g. marble → concrete

    @model_validator(mode="after")
    def _one_source(self):
        if sum(v is not None for v in (self.file, self.builtin, self.generator)) > 1:
            raise ValueError("give exactly one of scene.file, scene.builtin and scene.generator")
        return self


class BaseStation(Frozen):
    """The transmitter, known to the receiver."""

    position: Vector3
    yaw_deg: Annotated[float, Field(ge=-3600, le=3600)] = 0.0
    yaw_std_deg: Annotated[float, Field(ge=0, le=45)] = 0.0  # how well it is known; only with filter.start = "snapshot"
    array: ArrayConfig


class Receiver(Frozen):
    """The moving receiver (UE); its array turns with the heading."""

    height: Coordinate = 0.0
    array: ArrayConfig


class Beams(Frozen):
    """What the base station sends over time."""

    # digital: no beams, the base station's elements are observed separately, with the phases that waves have there
    kind: Literal["random_phase", "dft", "antenna", "digital"] = "random_phase"
    beams: Count = 16  # not if digital
    sweeps: Count = 8  # if digital: symbols
    order: Literal["permuted", "linear"] = "permuted"
    seed: Seed = 0


def _combs(signal: str) -> dict[int, tuple[int, ...]]:
    """Shifts of a positioning signal by its comb."""
    from estimation.signal.nr import PRS, SRS  # not at the top: a scenario is read without any estimator

    return {"prs": PRS, "srs": SRS}[signal]


class Radio(Frozen):
    """Waveform and beam schedule of one snapshot (paper A, eq. 2)."""

    carrier_frequency: Hertz = 28e9  # Hz
    bandwidth: Hertz | None = None  # Hz, from which the pilots follow where they are not given
    subcarriers: Count = 400  # occupied pilots
    subcarrier_spacing: Hertz = 120e3  # Hz
    comb: Count = 4  # every comb-th subcarrier carries a pilot
    pilots: Pilots | None = None  # numbers of these subcarriers from the carrier; default a regular comb
    # The comb moves from symbol to symbol while a beam is held: as a PRS or SRS of 5G does, or to these subcarriers of it
    stagger: Literal["prs", "srs"] | Stagger | None = None
    symbol_period: Seconds = 35.68e-6  # s, between the symbols used
    subbands: Count = 1  # with steering of their own: beam squint and range migration; 1 is eq. (2) as printed
    beams: Beams = Beams()

    @model_validator(mode="after")
    def _pilots_rise(self):
        if self.pilots is not None:
            if any(b <= a for a, b in pairwise(self.pilots)):
                raise ValueError("pilots must be rising numbers of subcarriers")
            if "subcarriers" in self.model_fields_set and len(self.pilots) != self.subcarriers:
                raise ValueError(f"pilots names {len(self.pilots)} subcarriers, but subcarriers = {self.subcarriers}")
        return self

    @model_validator(mode="after")
    def _stagger_fits(self):
        if self.stagger is None:
            return self
        if self.pilots is not None or self.beams.kind == "digital":
            key = "pilots" if self.pilots is not None else 'beams.kind = "digital"'
            raise ValueError(f"stagger moves a comb while a beam is held; it does not go with {key}")
        if isinstance(self.stagger, str) and self.comb not in _combs(self.stagger):
            combs = ", ".join(map(str, _combs(self.stagger)))
            raise ValueError(f'stagger = "{self.stagger}" needs comb = {combs}; it is {self.comb}')
        if not isinstance(self.stagger, str) and max(self.stagger) >= self.comb:
            raise ValueError(f"stagger names subcarrier {max(self.stagger)} of a comb of {self.comb}; the first is 0")
        return self

    @property
    def shifts(self) -> tuple[int, ...]:
        """Subcarriers at which the comb starts, one for each symbol that a beam is held for."""
        if isinstance(self.stagger, str):
            return _combs(self.stagger)[self.comb]
        return (0,) if self.stagger is None else self.stagger

    @model_validator(mode="after")
    def _one_bandwidth(self):
        pilots = {"subcarriers", "subcarrier_spacing", "comb"}
        spanned = self.subcarriers * self.subcarrier_spacing * self.comb
        if self.bandwidth and pilots <= self.model_fields_set and not 0.8 < spanned / self.bandwidth < 1.25:
            raise ValueError(
                f"bandwidth = {self.bandwidth:g} Hz, but {self.subcarriers} pilots, each {self.comb}th of a spacing of "
                f"{self.subcarrier_spacing:g} Hz, span {spanned:.4g} Hz; give the one or the others"
            )
        return self


class ScatterPoint(Frozen):
    """A small object, as a point with a constant radar cross-section."""

    name: str
    position: Vector3
    rcs: Positive = 100.0  # m²


class Trace(Frozen):
    """Settings of the ray tracer."""

    max_depth: Annotated[int, Field(ge=1, le=5)] = 1
    samples: Annotated[int, Field(ge=1000, le=10_000_000)] = 200_000  # rays launched
    seed: Seed = 1


class SourceModel(Frozen):
    """Detections drawn from the measurement model, as in paper A, Section V."""

    range_std: Spread = 0.1  # m
    angle_std: Spread = 0.05  # rad
    doppler_std: Spread = 0.1  # m/s
    detection_probability: Chance = 0.9
    sp_range: Positive | None = 50.0  # m, a scatter point is visible within; None: everywhere
    clutter_rate: Annotated[float, Field(ge=0, le=1000)] = 1.0  # false detections per scan
    clutter_range: Positive = 300.0  # m, clutter delays lie within [bias, bias + this]
    virtual_anchors: tuple[Vector3, ...] = ()  # m; without a trace the walls have to be named by their VAs


class Hardware(Frozen):
    """What real hardware does to the synthesized signal, and the estimator is not told; 0 switches each off."""

    position_wavelengths: Annotated[float, Field(ge=0, le=1)] = 0.0  # root mean square, of elements along each axis
    gain_db: Annotated[float, Field(ge=0, le=20)] = 0.0  # root mean square, of elements
    phase_deg: Annotated[float, Field(ge=0, le=180)] = 0.0  # likewise
    phase_noise_deg: Annotated[float, Field(ge=0, le=180)] = 0.0  # of a common phase, new in every symbol
    phase_walk_deg: Annotated[float, Field(ge=0, le=180)] = 0.0  # of its steps from symbol to symbol
    frequency_offset: Annotated[float, Field(ge=-1e9, le=1e9)] = 0.0  # Hz; adds λ times itself to radial velocities
    iq_gain_db: Annotated[float, Field(ge=-20, le=20)] = 0.0  # of the receiver's two branches
    iq_phase_deg: Annotated[float, Field(ge=-90, le=90)] = 0.0  # likewise
    bits: Annotated[int, Field(ge=0, le=24)] = 0  # of the converters; 0: none
    seed: Seed = 0  # of the errors of the elements, the same in every snapshot


class SourceTraced(Frozen):
    """Detections estimated from the synthesized signal of a traced scene."""

    transmit_power_dbm: Decibel = 0.0  # over all pilots together
    noise_figure_db: Annotated[float, Field(ge=-50, le=200)] = 7.0
    temperature: Annotated[float, Field(ge=1e-3, le=1e6)] = 290.0  # K
    added_noise: Literal["none", "model"] = "none"  # "model": blur the detections by the R of [source.model]
    impairments: Hardware = Hardware()


class Source(Frozen):
    """Where detections come from."""

    kind: Literal["traced", "model"] = "traced"
    model: SourceModel = SourceModel()
    traced: SourceTraced = SourceTraced()


class Estimator(Frozen):
    """Channel estimator of a snapshot."""

    kind: str = "nomp"  # a name of estimation.estimators.ESTIMATORS, or an own "module:Class" or "file.py:Class"
    options: dict[str, Any] = Field(default={})  # further options of this kind, by the names of its signature
    false_alarm_rate: Annotated[float, Field(ge=1e-12, lt=1)] = 0.01  # expected false paths per snapshot
    max_radial_velocity: Annotated[float, Field(ge=1e-3, le=1e5)] = 25.0  # m/s, searched on both sides of zero
    max_paths: Few = 30
    dense_multipath: bool = False  # estimate the dense part's delay profile and whiten with it

    @field_validator("kind")
    @classmethod
    def _known_kind(cls, kind: str) -> str:
        from estimation.errors import ModelError  # not at the top: a scenario is read without any estimator
        from estimation.estimators import ESTIMATORS

        try:
            return ESTIMATORS.checked(kind)
        except ModelError as error:
            raise ValueError(str(error)) from None


class Filter(Frozen):
    """EK-PMB filter (paper A, Section IV); defaults are the conventions of its reference figures."""

    density: str = "joint"  # a name of dopslam.filters.FILTERS, or an own "module:Class" or "file.py:Class"
    options: dict[str, Any] = Field(default_factory=dict)  # of a filter of one's own
    start: Literal["prior", "snapshot"] = "prior"  # snapshot: found from the scans alone, track.start is not told
    restart: bool = True  # a filter that has lost its receiver, by its own history, is started anew from the scans
    particles: Count = 1000  # of belief propagation
    associations: Few = 10  # γ best data associations per step
    iterations: Few = 3  # of the update; 1 is the plain EKF
    survival: Chance = 1.0
    intensity_va: Positive = 1e-7  # m⁻³, undetected virtual anchors
    intensity_sp: Positive = 4e-6  # m⁻³, undetected scatter points
    intensity_sr: NonNegative | None = None  # m⁻³, second reflections; default a hundredth of intensity_va, 0: none
    hide: Annotated[float, Field(ge=0, lt=1)] = (
        0.05  # P(out of sight at the next step) of a landmark in sight; 0: never
    )
    reappear: Probability = 0.1  # P(back at the next step) of one just out of sight; falls with the time out of sight
    gate: Positive = 40.0  # squared Mahalanobis distance
    prune_existence: Probability = 1e-3
    report_existence: Probability = 0.5
    linearization: Literal["extended", "cubature"] = "extended"
    reweight: bool | None = None  # weight associations by the evidence of the joint update; default: not in `marginal`
    hypotheses: Few = 20  # of the mixture: global hypotheses kept between steps
    lag: Few = 5  # steps that the smoother revisits
    birth_va: NonNegative = 0.0  # m⁻³ per step, added to the intensity of undetected virtual anchors
    birth_sp: NonNegative = 0.0
    thinning: bool = False  # reduce the undetected intensity inside the field of view after every scan
    # Speed and turn rate known, or in the state; walk: neither, positions and headings wander from scan to scan.
    motion: str = "known"  # a name of dopslam.filters.MOTIONS, or an own "module:Class" or "file.py:Class"
    motion_options: dict[str, Any] = Field(default_factory=dict)  # of a motion model of one's own
    # free: the clock bias is drawn anew at every scan; drift: its rate is off, too, and a state of its own
    clock: Literal["walk", "free", "drift"] = "walk"
    clock_drift_std: Spread = 30.0  # m/s, initial, of a drift; 1 ppm is 300 m/s
    clock_drift_walk: Spread = 0.01  # m/s per step
    position_walk: Spread | None = None  # m per step of a walk; default what the speed covers in a period
    heading_walk: Spread = 0.5  # rad per step of a walk
    speed_std: Spread = 2.0  # m/s, initial, when unknown
    turn_rate_std: Spread = 0.03  # rad/s
    speed_walk: Spread = 0.1  # m/s per step
    turn_rate_walk: Spread = 0.002  # rad/s per step

    @field_validator("density", "motion")
    @classmethod
    def _known_name(cls, name: str, info: ValidationInfo) -> str:
        try:
            return (FILTERS if info.field_name == "density" else MOTIONS).checked(name)
        except ConfigError as error:
            raise ValueError(str(error)) from None


class Evaluation(Frozen):
    """How a map is judged."""

    gospa_cutoff: Positive = 20.0  # m
    gospa_order: Annotated[float, Field(ge=1, le=10)] = 2.0
    found_radius: Positive = 3.0  # m


class Sections(Frozen):
    """The tables by their names."""

    name: str
    title: str = ""
    scene: Scene
    base_station: BaseStation
    receiver: Receiver
    radio: Radio = Radio()
    track: TrackConfig
    scatter_point: tuple[ScatterPoint, ...] = ()
    trace: Trace = Trace()
    source: Source = Source()
    estimator: Estimator = Estimator()
    filter: Filter = Filter()
    evaluation: Evaluation = Evaluation()
    experiment: ExperimentConfig | None = None
    belief: BeliefConfig = BeliefConfig()
    dataset: DatasetConfig | None = None
