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
from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, ValidationError, model_validator

from dopslam.config.belief import BeliefConfig, ExperimentConfig
from dopslam.config.drives import DatasetConfig
from dopslam.errors import ConfigError

Vector3 = tuple[float, float, float]
Vector4 = tuple[float, float, float, float]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Probability = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]
# Of the elements: the same all round, a patch (cosine about its own outward direction), or a dipole along z.
Pattern = Literal["isotropic", "cosine", "dipole"]


class _Frozen(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Scene(_Frozen):
    """Where the geometry comes from: a Mitsuba XML beside the scenario or a scene that ships with Sionna RT."""

    file: str | None = None
    builtin: str | None = None
    materials: dict[str, str] = Field(
        default_factory=dict
    )  # material in the file → material used, e.g. marble → concrete

    @model_validator(mode="after")
    def _one_source(self):
        if (self.file is None) == (self.builtin is None):
            raise ValueError("give exactly one of scene.file and scene.builtin")
        return self


class CylinderArray(_Frozen):
    """Stacked rings of vertical elements; sees all azimuths without ambiguity."""

    kind: Literal["cylinder"] = "cylinder"
    columns: Count
    rings: Count
    spacing_wavelengths: Positive = 0.5  # along the ring (chord) and between the rings
    pattern: Pattern = "isotropic"


class PlanarArray(_Frozen):
    """Uniform rectangular array in its y–z plane, boresight +x."""

    kind: Literal["planar"] = "planar"
    columns: Count
    rows: Count
    spacing_wavelengths: Positive = 0.5
    pattern: Pattern = "isotropic"


class CustomArray(_Frozen):
    """Arbitrary element positions in wavelengths, in the array's frame."""

    kind: Literal["custom"] = "custom"
    positions_wavelengths: tuple[Vector3, ...] = Field(min_length=1)


ArrayConfig = Annotated[CylinderArray | PlanarArray | CustomArray, Field(discriminator="kind")]


class BaseStation(_Frozen):
    """The transmitter, known to the receiver."""

    position: Vector3
    yaw_deg: float = 0.0
    array: ArrayConfig


class Receiver(_Frozen):
    """The moving receiver (UE); its array turns with the heading."""

    height: float = 0.0
    array: ArrayConfig


class Beams(_Frozen):
    """What the base station sends over time."""

    kind: Literal["random_phase", "dft", "antenna"] = "random_phase"
    beams: Count = 16
    sweeps: Count = 8
    order: Literal["permuted", "linear"] = "permuted"
    seed: int = 0


class Radio(_Frozen):
    """Waveform and beam schedule of one snapshot (paper A, eq. 2)."""

    carrier_frequency: Positive = 28e9  # Hz
    subcarriers: Count = 400  # occupied pilots
    subcarrier_spacing: Positive = 120e3  # Hz
    comb: Count = 4  # every comb-th subcarrier carries a pilot
    symbol_period: Positive = 35.68e-6  # s, between the symbols used
    subbands: Count = 1  # with steering of their own: beam squint and range migration; 1 is eq. (2) as printed
    beams: Beams = Beams()


class TrackConfig(_Frozen):
    """Coordinated turn of paper A, eq. (1); a turn rate of zero is a straight line."""

    speed: NonNegative  # m/s
    turn_rate: float = 0.0  # rad/s
    period: Positive = 0.5  # s
    steps: Count = 40
    start: Vector4  # x m, y m, heading rad, clock bias m: mean of the receiver's initial knowledge
    start_std: tuple[NonNegative, NonNegative, NonNegative, NonNegative] = (0.3, 0.3, 0.0052, 0.3)
    process_std: tuple[NonNegative, NonNegative, NonNegative, NonNegative] = (0.2, 0.2, 0.001, 0.2)  # per step
    random: bool = True  # draw start and process noise; False: exactly the nominal track


class ScatterPoint(_Frozen):
    """A small object, as a point with a constant radar cross-section."""

    name: str
    position: Vector3
    rcs: Positive = 100.0  # m²


class Trace(_Frozen):
    """Settings of the ray tracer."""

    max_depth: Annotated[int, Field(ge=1, le=5)] = 1
    samples: Annotated[int, Field(ge=1000)] = 200_000  # rays launched
    seed: int = 1


class SourceModel(_Frozen):
    """Detections drawn from the measurement model, as in paper A, Section V."""

    range_std: Positive = 0.1  # m
    angle_std: Positive = 0.05  # rad
    doppler_std: Positive = 0.1  # m/s
    detection_probability: Annotated[float, Field(gt=0, le=1)] = 0.9
    sp_range: Positive | None = 50.0  # m, a scatter point is visible within; None: everywhere
    clutter_rate: NonNegative = 1.0  # false detections per scan
    clutter_range: Positive = 300.0  # m, clutter delays lie within [bias, bias + this]
    virtual_anchors: tuple[Vector3, ...] = ()  # m; without a trace the walls have to be named by their VAs


class SourceTraced(_Frozen):
    """Detections estimated from the synthesized signal of a traced scene."""

    transmit_power_dbm: float = 0.0  # over all pilots together
    noise_figure_db: float = 7.0
    temperature: Positive = 290.0  # K
    added_noise: Literal["none", "model"] = "none"  # "model": blur the detections by the R of [source.model]


class Source(_Frozen):
    """Where detections come from."""

    kind: Literal["traced", "model"] = "traced"
    model: SourceModel = SourceModel()
    traced: SourceTraced = SourceTraced()


class Estimator(_Frozen):
    """Channel estimator of a snapshot."""

    kind: Literal["nomp", "sage", "esprit"] = "nomp"
    false_alarm_rate: Annotated[float, Field(gt=0, lt=1)] = 0.01  # expected false paths per snapshot
    max_radial_velocity: Positive = 25.0  # m/s, searched on both sides of zero
    max_paths: Count = 30
    dense_multipath: bool = False  # estimate the dense part's delay profile and whiten with it


class Filter(_Frozen):
    """EK-PMB filter (paper A, Section IV); defaults are the conventions of its reference figures."""

    density: Literal["joint", "marginal", "bp"] = "joint"  # bp: belief propagation of paper B, without Doppler
    particles: Count = 1000  # of belief propagation
    associations: Count = 10  # γ best data associations per step
    iterations: Count = 3  # of the update; 1 is the plain EKF
    survival: Annotated[float, Field(gt=0, le=1)] = 1.0
    intensity_va: Positive = 1e-7  # m⁻³, undetected virtual anchors
    intensity_sp: Positive = 4e-6  # m⁻³, undetected scatter points
    gate: Positive = 40.0  # squared Mahalanobis distance
    prune_existence: Probability = 1e-3
    report_existence: Probability = 0.5
    linearization: Literal["extended", "cubature"] = "extended"
    reweight: bool = False  # weight associations by the evidence of the joint update
    hypotheses: Count = 1  # global hypotheses kept between steps: 1 is the PMB, more the PMBM
    lag: Count = 5  # steps that the smoother revisits
    birth_va: NonNegative = 0.0  # m⁻³ per step, added to the intensity of undetected virtual anchors
    birth_sp: NonNegative = 0.0
    thinning: bool = False  # reduce the undetected intensity inside the field of view after every scan
    motion: Literal["known", "unknown"] = "known"  # speed and turn rate: known, or in the state
    speed_std: Positive = 2.0  # m/s, initial, when unknown
    turn_rate_std: Positive = 0.03  # rad/s
    speed_walk: Positive = 0.1  # m/s per step
    turn_rate_walk: Positive = 0.002  # rad/s per step


class Evaluation(_Frozen):
    """How a map is judged."""

    gospa_cutoff: Positive = 20.0  # m
    gospa_order: Annotated[float, Field(ge=1)] = 2.0
    found_radius: Positive = 3.0  # m


class Scenario(_Frozen):
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

    @model_validator(mode="after")
    def _distinct_points(self):
        names = [p.name for p in self.scatter_point]
        if len(set(names)) < len(names):
            raise ValueError("scatter_point names must differ from one another")
        return self

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
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{source}: not valid TOML: {error}") from error
    for override in overrides:
        _apply(tree, override)
    try:
        scenario = Scenario.model_validate(tree)
    except ValidationError as error:
        raise ConfigError(f"{source}: {_sentence(error)}") from error
    scenario._folder = folder
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
    except tomllib.TOMLDecodeError:
        node[last] = value.strip()


def _fields_at(loc: tuple) -> list[str]:
    """Names of the keys allowed beside the last part of an error's location."""
    model: Any = Scenario
    for part in loc[:-1]:
        if isinstance(model, type) and issubclass(model, BaseModel) and part in model.model_fields:
            model = _inner_model(model.model_fields[part].annotation, loc)
    return list(model.model_fields) if isinstance(model, type) and issubclass(model, BaseModel) else []


def _inner_model(annotation: Any, loc: tuple) -> Any:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    candidates = [m for arg in getattr(annotation, "__args__", ()) if (m := _inner_model(arg, loc)) is not None]
    tagged = [m for m in candidates if "kind" in m.model_fields and m.model_fields["kind"].default in loc]
    return (tagged or candidates or [None])[0]


_TAGS = {"cylinder", "planar", "custom", "motion", "line", "circle", "drive"}  # of unions


def _sentence(error: ValidationError) -> str:
    first = error.errors()[0]
    loc = tuple(first["loc"])
    key = ".".join(str(part) for part in loc if part not in _TAGS)
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    if first["type"] == "extra_forbidden":
        allowed = _fields_at(loc)
        near = difflib.get_close_matches(str(loc[-1]), allowed, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]!r}?" if near else f"known keys here: {', '.join(allowed)}"
        return f"unknown key {key!r}; {hint}{more}"
    if first["type"] == "missing":
        return f"key {key!r} is missing{more}"
    message = first["msg"].removeprefix("Value error, ")
    return f"{key or 'scenario'} = {first['input']!r}: {message}{more}" if key else f"{message}{more}"
