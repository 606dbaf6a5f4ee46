"""Which settings a stage reads: those that change what it is handed. One that changes nothing is refused by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel

from dopslam.config.scenario import Scenario
from dopslam.errors import ConfigError
from dopslam.filters import FILTERS
from dopslam.pipeline import link
from dopslam.pipeline import problem as build


def handed(stage: str, scenario: Scenario, names: Sequence[str] = ()) -> Any:
    """What a stage is handed of a scenario, as something that can be compared.

    Parameters
    ----------
    stage : trace, simulate, synthesize, estimate, slam, bound, evaluate, montecarlo, experiment, dataset
    names : filters that run; default the scenario's
    """
    return _plain(_HANDED[stage](scenario, names or (scenario.filter.density,)))


def refuse_unread(
    make: Callable[[list[str]], Scenario], settings: Sequence[str], stages: Sequence[str], names: Sequence[str] = ()
) -> None:
    """Refuse settings that none of the stages reads.

    Parameters
    ----------
    make : the scenario with these settings; :func:`dopslam.config.scenario.load` with its place, for instance
    settings : ``key.path=value`` texts
    stages : that run with them, see :func:`handed`
    names : filters that run

    Raises
    ------
    ConfigError
        Naming the key, what runs, and who would read it.
    """
    settings = list(settings)
    if not settings:
        return
    full = make(settings)
    given = {stage: handed(stage, full, names) for stage in stages}
    for place, text in enumerate(settings):
        try:
            other = make(settings[:place] + settings[place + 1 :])
            alike = all(handed(stage, other, names) == given[stage] for stage in stages)
        except ConfigError:  # the others cannot be without it
            continue
        if full.to_toml() == other.to_toml():  # says what was so already
            continue
        if alike:
            key = text.partition("=")[0].strip()
            run = " and ".join(dict.fromkeys([*stages[-1:], *(names or ())]))
            raise ConfigError(
                f"--set {key}: changes nothing here ({run} does not read it){_reader(full, other, names)}"
            )


def _reader(full: Scenario, other: Scenario, names: Sequence[str]) -> str:
    def differs(stage: str, name: str) -> bool:
        return handed(stage, full, (name,)) != handed(stage, other, (name,))

    who = [name for name in FILTERS.sound() if name not in names and differs("slam", name)]
    who = who or [stage for stage in _HANDED if differs(stage, full.filter.density)]
    return f"; {', '.join(who)} would" if who else "; drop it"


def _plain(value: Any) -> Any:
    """Records, arrays and numbers as nested tuples."""
    if isinstance(value, BaseModel):
        return _plain(value.model_dump())
    if is_dataclass(value) and not isinstance(value, type):
        return (type(value).__name__, *(_plain(getattr(value, f.name)) for f in fields(value)))
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if isinstance(value, dict):
        return tuple((key, _plain(entry)) for key, entry in value.items())
    if isinstance(value, list | tuple):
        return tuple(_plain(entry) for entry in value)
    return repr(value)


def _link(scenario: Scenario) -> Any:
    """The link as it is made: a key that the others overrule makes no difference to it."""
    station = scenario.base_station
    amplitude, noise = link.pilot_amplitude(scenario), link.noise_variance(scenario)
    return link.signal_model(scenario), amplitude, noise, station.position, station.yaw_deg


def _hardware(scenario: Scenario) -> Any:
    made = link.impairments(scenario)
    return made and (made, scenario.source.traced.impairments.seed)


def _told(scenario: Scenario, names: Sequence[str]) -> Any:
    noise = scenario.source.kind == "traced" and scenario.source.traced.added_noise == "model"
    added = build.measurement_std(scenario) if noise else None
    filters = [build.chosen_filter(scenario, name) for name in names]
    return build.problem(scenario), filters, added


def _trace(scenario: Scenario, names: Sequence[str]) -> Any:
    scene = scenario.scene
    made = scene if scene.generator else (scene.file, scene.builtin, scene.materials)
    parts = (made, scenario.trace, scenario.scatter_point, scenario.track, scenario.base_station.position)
    return parts, scenario.receiver.height, scenario.radio.carrier_frequency


_HANDED: dict[str, Callable[[Scenario, Sequence[str]], Any]] = {
    "trace": _trace,
    "simulate": lambda s, _: (build.situation(s), build.model_landmarks(s), s.track),
    "synthesize": lambda s, _: (_link(s), _hardware(s)),
    "estimate": lambda s, _: (_link(s), s.estimator, _hardware(s)),
    "slam": lambda s, names: _told(s, names),
    "bound": lambda s, names: (_told(s, names)[0], _link(s), s.filter.intensity_sr),
    "evaluate": lambda s, _: (s.evaluation, s.filter.report_existence, s.filter.density, _link(s), s.name, s.title),
    "experiment": lambda s, _: (
        s.experiment,
        s.belief,
        s.filter.particles,
        s.track,
        s.radio,
        s.source.model,
        s.scatter_point,
    ),
    "dataset": lambda s, names: (s.dataset, _trace(s, names), _link(s), s.estimator, _hardware(s)),
    "montecarlo": lambda s, names: (build.situation(s), _told(s, names)[:2], s.evaluation, s.filter.report_existence),
}
