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
from typing import Any

import tomli_w
from pydantic import PrivateAttr, ValidationError, model_validator

from dopslam.config import sizes
from dopslam.config.driven import driven
from dopslam.config.fitted import fitted
from dopslam.config.generated import filled
from dopslam.config.measured import Shown, completed
from dopslam.config.sections import Sections
from dopslam.config.sentences import sentence
from dopslam.errors import ConfigError

WITHOUT_SCENE = (
    "; where nobody traces, for detections of one's own, a base station is enough: dopslam import TABLE --scene PATH"
)


class Scenario(Sections):
    """A whole scenario: scene, radio, motion, detection source, estimator and filter."""

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


def load(where: str | Path, overrides: tuple[str, ...] | list[str] = (), shown: Shown | None = None) -> Scenario:
    """Read and validate a scenario.

    Parameters
    ----------
    where : folder, ``scenario.toml`` or the name of a shipped scene
    overrides : ``key.path=value`` texts, values in TOML syntax (a bare word is a string)
    shown : what measurements show, which then need no scene, no arrays, no start and no speed

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
    return parse(text, overrides, source=str(path), folder=path.resolve().parent, shown=shown)


def parse(
    text: str, overrides=(), source: str = "scenario", folder: Path | None = None, shown: Shown | None = None
) -> Scenario:
    """Validate TOML text; see :func:`load`."""
    try:
        tree = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{source}: not valid TOML: {error}") from error
    for override in overrides:
        _apply(tree, override)
    tree, drive = driven(filled(tree), folder)
    if shown is not None:
        tree, free = completed(tree, shown)
        shown = shown if free else None
    try:
        given = Scenario.model_validate(tree)
        derived = fitted(given, drive, shown)
        full = {k: getattr(given, k).model_copy(update=v) for k, v in derived.items()}
        scenario = Scenario.model_validate(given.model_copy(update=full).model_dump()) if full else given
    except ValidationError as error:
        hint = "" if "scene" in tree or "base_station" not in tree else WITHOUT_SCENE
        raise ConfigError(f"{source}: {sentence(error, Scenario)}{hint}") from error
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
