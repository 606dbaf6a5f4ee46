"""``scenario.toml`` → frozen, validated models.

One scene folder holds ``scene.xml`` (geometry, materials) and ``scenario.toml`` (everything else). Any key can be
overridden with ``--set key.path=value``. Keys carry a unit suffix (``_deg``, ``_db``, ``_dbm``) only where they are
not SI;
angles without a suffix are radians.
"""

from __future__ import annotations

import difflib
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from pydantic import Field, PrivateAttr, ValidationError, field_validator, model_validator

from dopslam.config import sizes
from dopslam.config.arrays import ArrayConfig
from dopslam.config.belief import BeliefConfig, ExperimentConfig
from dopslam.config.driven import driven
from dopslam.config.drives import DatasetConfig
from dopslam.config.fitted import fitted
from dopslam.config.generated import filled
from dopslam.config.sentences import sentence
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
from dopslam.filters import FILTERS

Spread = Annotated[float, Field(ge=1e-9, le=1e6)]


class Scene(Frozen):
    """Where the geometry comes from: a Mitsuba XML beside the scenario, a scene that ships with Sionna RT, or a generator
    (:mod:`dopslam.generators`), which also makes whatever the scenario leaves out."""

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
        if sum(v is not None for v in (self.file, self.builtin, self.generator)) != 1:
            raise ValueError("give exactly one of scene.file, scene.builtin and scene.generator")
        return self


class BaseStation(Frozen):
    """The transmitter, known to the receiver."""

    position: Vector3
    yaw_deg: Annotated[float, Field(ge=-3600, le=3600)] = 0.0
    array: ArrayConfig


class Receiver(Frozen):
    """The moving receiver (UE); its array turns with the heading."""

    height: Coordinate = 0.0
    array: ArrayConfig


class Beams(Frozen):
    """What the base station sends over time."""

    kind: Literal["random_phase", "dft", "antenna"] = "random_phase"
    beams: Count = 16
    sweeps: Count = 8
    order: Literal["permuted", "linear"] = "permuted"
    seed: Seed = 0


class Radio(Frozen):
    """Waveform and beam schedule of one snapshot (paper A, eq. 2)."""

    carrier_frequency: Hertz = 28e9  # Hz
    bandwidth: Hertz | None = None  # Hz, from which the pilots follow where they are not given
    subcarriers: Count = 400  # occupied pilots
    subcarrier_spacing: Hertz = 120e3  # Hz
    comb: Count = 4  # every comb-th subcarrier carries a pilot
    symbol_period: Seconds = 35.68e-6  # s, between the symbols used
    subbands: Count = 1  # with steering of their own: beam squint and range migration; 1 is eq. (2) as printed
    beams: Beams = Beams()

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


class SourceTraced(Frozen):
    """Detections estimated from the synthesized signal of a traced scene."""

    transmit_power_dbm: Decibel = 0.0  # over all pilots together
    noise_figure_db: Annotated[float, Field(ge=-50, le=200)] = 7.0
    temperature: Annotated[float, Field(ge=1e-3, le=1e6)] = 290.0  # K
    added_noise: Literal["none", "model"] = "none"  # "model": blur the detections by the R of [source.model]


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
    reweight: bool = False  # weight associations by the evidence of the joint update
    hypotheses: Few = 20  # of the mixture: global hypotheses kept between steps
    lag: Few = 5  # steps that the smoother revisits
    birth_va: NonNegative = 0.0  # m⁻³ per step, added to the intensity of undetected virtual anchors
    birth_sp: NonNegative = 0.0
    thinning: bool = False  # reduce the undetected intensity inside the field of view after every scan
    # Speed and turn rate known, or in the state; walk: neither, positions and headings wander from scan to scan.
    motion: Literal["known", "unknown", "walk"] = "known"
    clock: Literal["walk", "free"] = "walk"  # free: the clock bias is drawn anew at every scan
    position_walk: Spread | None = None  # m per step of a walk; default what the speed covers in a period
    heading_walk: Spread = 0.5  # rad per step of a walk
    speed_std: Spread = 2.0  # m/s, initial, when unknown
    turn_rate_std: Spread = 0.03  # rad/s
    speed_walk: Spread = 0.1  # m/s per step
    turn_rate_walk: Spread = 0.002  # rad/s per step

    @field_validator("density")
    @classmethod
    def _known_density(cls, name: str) -> str:
        try:
            return FILTERS.checked(name)
        except ConfigError as error:
            raise ValueError(str(error)) from None


class Evaluation(Frozen):
    """How a map is judged."""

    gospa_cutoff: Positive = 20.0  # m
    gospa_order: Annotated[float, Field(ge=1, le=10)] = 2.0
    found_radius: Positive = 3.0  # m


class Scenario(Frozen):
    """A whole scenario: scene, radio, motion, detection source, estimator and filter."""

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
    _folder: Path | None = PrivateAttr(default=None)
    _derived: dict[str, dict] = PrivateAttr(default_factory=dict)  # section → key → value that nobody gave

    @model_validator(mode="after")
    def _distinct_points(self):
        names = [p.name for p in self.scatter_point]
        if len(set(names)) < len(names):
            raise ValueError("scatter_point names must differ from one another")
        return self

    @model_validator(mode="after")
    def _can_be(self):
        sizes.refuse(self)
        return self

    @property
    def derived(self) -> dict[str, dict]:
        """Section → key → value of what was not given and follows from the rest (:mod:`dopslam.config.fitted`)."""
        return self._derived

    @property
    def scene_file(self) -> Path | None:
        """Path of ``scene.xml``, or None for a scene that ships with Sionna RT."""
        if self.scene.file is None:
            return None
        path = Path(self.scene.file)
        return path if path.is_absolute() or self._folder is None else self._folder / path

    def to_toml(self) -> str:
        """The effective configuration as TOML text that :func:`load` reads back."""
        return tomli_w.dumps(self.model_dump(mode="json", exclude_none=True))


def shipped_scenes() -> dict[str, Path]:
    """Name → folder of the scenes that come with the package."""
    here = Path(__file__).resolve().parents[1]
    root = here / "_scenes" if (here / "_scenes").is_dir() else here.parent / "scenes"
    return {p.parent.name: p.parent for p in sorted(root.glob("*/scenario.toml"))}


def find_scenario(where: str | Path) -> Path:
    """The ``scenario.toml`` meant by a folder, a file, or the name of a shipped scene."""
    path = Path(where)
    for candidate in (path, path / "scenario.toml"):
        if candidate.is_file():
            return candidate
    shipped = shipped_scenes()
    if path.name in shipped:
        return shipped[path.name] / "scenario.toml"
    near = difflib.get_close_matches(path.name, shipped, n=1)
    hint = f"did you mean {near[0]!r}?" if near else f"shipped scenes: {', '.join(shipped)}"
    raise ConfigError(f"no scenario at {str(where)!r}: expected a folder with scenario.toml; {hint}")


def load(where: str | Path, overrides: tuple[str, ...] | list[str] = ()) -> Scenario:
    """Read and validate a scenario.

    Parameters
    ----------
    where : folder, ``scenario.toml`` or the name of a shipped scene
    overrides : ``key.path=value`` texts, values in TOML syntax (a bare word is a string)

    Raises
    ------
    ConfigError
        Naming the file, the key with its path, the value, and for a misspelt key the nearest right one.
    """
    path = find_scenario(where)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read as UTF-8 text ({error})") from error
    return parse(text, overrides, source=str(path), folder=path.resolve().parent)


def parse(text: str, overrides=(), source: str = "scenario", folder: Path | None = None) -> Scenario:
    """Validate TOML text; see :func:`load`."""
    try:
        tree = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{source}: not valid TOML: {error}") from error
    for override in overrides:
        _apply(tree, override)
    tree, drive = driven(filled(tree), folder)
    try:
        given = Scenario.model_validate(tree)
        derived = fitted(given, drive)
        full = {k: getattr(given, k).model_copy(update=v) for k, v in derived.items()}
        scenario = Scenario.model_validate(given.model_copy(update=full).model_dump()) if full else given
    except ValidationError as error:
        raise ConfigError(f"{source}: {sentence(error, Scenario)}") from error
    scenario._folder, scenario._derived = folder, derived
    return scenario


def override(scenario: Scenario, overrides) -> Scenario:
    """A copy of a scenario with ``key.path=value`` applied."""
    return parse(scenario.to_toml(), overrides, source=scenario.name, folder=scenario._folder)


def _apply(tree: dict, text: str) -> None:
    key, sign, value = text.partition("=")
    if not sign or not key.strip():
        raise ConfigError(f"--set {text!r}: expected key.path=value, for instance trace.max_depth=2")
    *parents, last = key.strip().split(".")
    node: Any = tree
    for part in parents:
        node = node.setdefault(part, {}) if isinstance(node, dict) else None
        if not isinstance(node, dict):
            raise ConfigError(f"--set {text!r}: {part!r} is not a table")
    try:
        node[last] = tomllib.loads(f"value = {value.strip()}")["value"]
    except (ValueError, RecursionError):
        node[last] = value.strip()
