"""No key of a scenario does nothing: each changes what some stage is handed, and is refused by name where it does not."""

import types
import typing

import pytest
from pydantic import BaseModel

from dopslam.config.scenario import Scenario, load, override, parse
from dopslam.errors import ConfigError
from dopslam.filters import FILTERS, MOTIONS
from dopslam.pipeline.reads import _HANDED, handed, refuse_unread

NO_VALUE = {"name", "title"}  # said in reports
BASE = {
    "ring_road": load("ring_road", ["source.model.virtual_anchors=[[200.0, 0.0, 40.0]]"]),
    "pedestrian": load("pedestrian"),
}


def leaves(model, before=()):
    """Paths of all keys whose values are no tables."""
    for name, field in model.model_fields.items():
        inner = [a for a in (field.annotation, *typing.get_args(field.annotation)) if isinstance(a, type)]
        tables = [a for a in inner if issubclass(a, BaseModel)]
        if tables and not isinstance(field.annotation, types.GenericAlias):
            yield from leaves(tables[0], (*before, name))
        else:
            yield (*before, name), field


def others(scenario, path, field):
    """Settings that give a key another value, valid or not."""
    value = scenario
    for part in path:
        value = getattr(value, part, None)
    choices = typing.get_args(field.annotation)
    if isinstance(value, bool):
        tried = [not value]
    elif isinstance(value, int | float):
        tried = [value * 2, value / 2, value + 1, value - 1, value * 0.9, value + 0.25]
        tried = [int(v) for v in tried] if isinstance(value, int) else tried
    elif isinstance(value, str):
        tried = [c for c in choices if isinstance(c, str)] or [*FILTERS, *MOTIONS, "sage", "other", "concrete"]
    elif isinstance(value, tuple) and value and isinstance(value[0], int | float):
        tried = [[*value[:-1], value[-1] * 1.5 + 0.5], [v * 1.5 for v in value], [*value[:-1], int(value[-1]) + 1]]
    else:
        tried = [c for c in choices if isinstance(c, str)] + [
            1,
            0.5,
            2,
            "other",
            [1, 2],
            [1.0, 2.0],
            [[1.0, 2.0, 3.0]],
            True,
        ]
    return [f"{'.'.join(path)}={str(v).lower() if isinstance(v, bool) else repr(v)}" for v in tried if v != value]


GIVEN = {
    "radio.beams.kind": "digital",
    "scene.materials": '{concrete="metal"}',
    "scene.options": "{height=[3.0, 3.1]}",
    "radio.pilots": str(list(range(-799, 801, 4))),
    "track.waypoints": "[[70.0, 0.0], [70.0, 50.0]]",
    "scatter_point": '[{name="a", position=[1.0, 2.0, 3.0], rcs=1.0}]',
    "estimator.options": "{refine=1}",
    "filter.options": "{joint={associations=3}}",
    "filter.motion_options": "{speed=3.0}",
    "belief.types": "va_only",
}
"""Values of keys that no rule guesses."""


def changed(scenario, path, field):
    """The setting and the scenario with another value of a key, or None if none of the guesses is valid."""
    key = ".".join(path)
    for setting in [f"{key}={GIVEN[key]}"] if key in GIVEN else others(scenario, path, field):
        try:
            other = override(scenario, [setting])
        except ConfigError:
            continue
        if other.to_toml() != scenario.to_toml():
            return setting, other
    return None


NAMES = tuple(FILTERS)
UNUSUAL = ["filter.motion=unknown", "source.traced.added_noise=model"]
CASES = [
    BASE["ring_road"],
    override(BASE["ring_road"], ["source.kind=model"]),
    override(BASE["ring_road"], [*UNUSUAL, "source.traced.impairments.gain_db=0.5"]),
    override(BASE["ring_road"], ["filter.motion=walk", "filter.clock=drift"]),
    BASE["pedestrian"],
    override(BASE["pedestrian"], ["belief.engine=stacked"]),
    parse('name = "room"\n[scene]\ngenerator = "room"\nseed = 3\n[radio]\nbandwidth = 2e8'),
]
KEYS = {".".join(path): (path, field) for path, field in leaves(Scenario)}


@pytest.mark.parametrize("key", [k for k in KEYS if k not in NO_VALUE])
def test_a_key_changes_what_some_stage_is_handed(key):
    guessed = False
    for scenario in CASES:
        found = changed(scenario, *KEYS[key])
        if found is not None:
            guessed = True
            if any(handed(stage, scenario, NAMES) != handed(stage, found[1], NAMES) for stage in _HANDED):
                return
    if not guessed:
        pytest.skip("no other value of this key goes with these scenarios")
    pytest.fail(f"{key} is read by nothing")


@pytest.mark.parametrize("name", FILTERS)
def test_an_option_of_another_filter_is_refused_by_name(name):
    scenario = BASE["ring_road"]
    for key, (path, field) in KEYS.items():
        found = changed(scenario, path, field) if path[0] == "filter" and path[-1] != "options" else None
        if found is None:
            continue
        setting, other = found
        if handed("slam", scenario, (name,)) == handed("slam", other, (name,)):
            with pytest.raises(ConfigError, match=key.replace(".", r"\.") + ".*does not read it"):
                refuse_unread(lambda chosen: override(scenario, chosen), [setting], ("slam",), (name,))
        else:
            refuse_unread(lambda chosen: override(scenario, chosen), [setting], ("slam",), (name,))


def test_the_message_says_who_would_read_it(call, capsys):
    assert call("run", "ring_road", "--source", "model", "--filter", "joint", "--set", "filter.lag=9") == 2
    assert "filter.lag" in (said := capsys.readouterr().err) and "smoother, lagged would" in said
    assert call("montecarlo", "ring_road", "--filter", "joint", "--set", "belief.birth_rate=0.1") == 2
    assert "bp would" in capsys.readouterr().err


def test_what_says_nothing_new_is_accepted():
    refuse_unread(lambda chosen: load("ring_road", chosen), ["filter.lag=5"], ("slam",), ("joint",))


@pytest.mark.parametrize(
    ("before", "setting"),
    [
        ([], "radio.bandwidth=190e6"),  # the pilots say it
        ([], "scene.seed=5"),  # of a generator, and this is a file
        ([f"radio.pilots={GIVEN['radio.pilots']}"], "radio.comb=5"),
        (["radio.beams.kind=digital"], "radio.beams.beams=7"),
        (["radio.beams.kind=digital"], "radio.beams.seed=7"),
    ],
)
def test_a_key_that_others_overrule_is_refused(before, setting):
    stages = ("trace", "estimate", "bound", "evaluate", "slam")
    with pytest.raises(ConfigError, match=f"{setting.partition('=')[0]}: changes nothing here"):
        refuse_unread(lambda chosen: override(BASE["ring_road"], [*before, *chosen]), [setting], stages, ("joint",))


def test_a_key_that_another_one_needs_is_accepted():
    """Left out alone it leaves a scenario that cannot be."""
    both = ["radio.beams.kind=antenna", "radio.beams.beams=32"]
    refuse_unread(lambda chosen: load("ring_road", chosen), both, ("estimate",))
    with pytest.raises(ConfigError, match="as many antenna beams as elements"):
        refuse_unread(lambda chosen: load("ring_road", chosen), both[:1], ("estimate",))
