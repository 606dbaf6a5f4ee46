"""The kinds of scenes there are, by name."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from dopslam.errors import ConfigError
from dopslam.scenes.generators import corridor, hall, plaza, room, street
from dopslam.scenes.generators.draft import Generated
from dopslam.scenes.generators.draw import NoRoom

GENERATORS: dict[str, tuple[Callable[..., Generated], dict]] = {
    "street": (street.street, street.OPTIONS),
    "plaza": (plaza.plaza, plaza.OPTIONS),
    "room": (room.room, room.OPTIONS),
    "corridor": (corridor.corridor, corridor.OPTIONS),
    "hall": (hall.hall, hall.OPTIONS),
}
LAYOUTS = 20  # tried before a kind with its options counts as too crowded


def generate(kind: str, seed: int, options: Mapping[str, Any] | None = None, carrier: float | None = None) -> Generated:
    """The scene of a kind, a seed and options; the same for ever.

    Parameters
    ----------
    kind : a name in :data:`GENERATORS`
    seed : of everything drawn
    options : instead of the kind's ranges, each a number or ``[least, largest]``
    carrier : Hz, of the radio it is for (materials that exist there); None: drawn as well

    Raises
    ------
    ConfigError
        For a kind or an option that does not exist, or a scene without room for a drive.

    Examples
    --------
    >>> [shape.name for shape in generate("room", 0).shapes][:3]
    ['wall_east', 'wall_north', 'wall_west']
    """
    if kind not in GENERATORS:
        near = difflib.get_close_matches(kind, GENERATORS, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(GENERATORS)}"
        raise ConfigError(f"scene.generator = {kind!r}: no such kind; {hint}")
    function, ranges = GENERATORS[kind]
    ranges = dict(ranges)
    for name, value in (options or {}).items():
        if name not in ranges:
            raise ConfigError(f"scene.options.{name}: a {kind} has no such option; it has {', '.join(ranges)}")
        low, high = (value, value) if isinstance(value, int | float) else value
        if not 0 <= low <= high <= 1e4:
            raise ConfigError(f"scene.options.{name} = {value}: give a number, or the least and the largest, up to 1e4")
        ranges[name] = (low, high)
    key = (sum(ord(c) * 131**i for i, c in enumerate(kind)) % 2**32,)  # kinds draw apart
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
    for _ in range(LAYOUTS):
        try:
            return function(rng, carrier, ranges)
        except NoRoom:
            continue
    raise ConfigError(f"{kind} {seed} has no room for a drive; choose another scene.seed, or wider scene.options")
