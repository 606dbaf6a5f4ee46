"""Scenarios of generated scenes: what ``[scene] generator`` makes stands under what the person wrote."""

from __future__ import annotations

from typing import Any

from dopslam.errors import ConfigError

WHOLE = {"array", "beams", "options"}  # tables that are taken from one side, never mixed


def filled(tree: dict) -> dict:
    """The tree of a scenario with the keys its generator makes where it does not say them itself.

    Raises
    ------
    ConfigError
        For a kind or option that does not exist.
    """
    scene = tree.get("scene")
    if not isinstance(scene, dict) or not isinstance(scene.get("generator"), str):
        return tree
    kind, seed = scene["generator"], scene.get("seed", 0)
    if not isinstance(seed, int) or seed < 0:
        raise ConfigError(f"scene.seed = {seed!r}: give a whole number from 0")
    made = dict(generated(kind, seed, scene.get("options"), tree).keys)
    track = tree.get("track")
    if isinstance(track, dict) and (track.get("file") or track.get("waypoints")):
        # A drive of one's own says the rest itself; through places without times it keeps the kind's speed.
        kept = ("period",) if timed(track) else ("speed", "period")
        made["track"] = {key: made["track"][key] for key in kept}
    return under(tree, {"name": f"{kind}_{seed}", **made})


def timed(track: dict) -> bool:
    """Whether a drive of one's own says when it is where, and with it how fast it goes."""
    points = track.get("waypoints")
    return not (isinstance(points, list) and points and isinstance(points[0], list) and len(points[0]) == 2)


def generated(kind: str, seed: int, options: Any, tree: dict):
    """The scene, its materials chosen for the carrier that the tree of a scenario names, if it does."""
    from dopslam.scenes.generators import generate  # needs NumPy, which --help does without

    radio = tree.get("radio")
    carrier = radio.get("carrier_frequency") if isinstance(radio, dict) else None
    known = float(carrier) if isinstance(carrier, int | float) and carrier > 0 else None
    return generate(kind, seed, options if isinstance(options, dict) else None, known)


def under(given: Any, made: Any) -> Any:
    """What is given, completed by what is made."""
    if not isinstance(given, dict) or not isinstance(made, dict):
        return given
    mixed = {
        key: under(given[key], value) if key in given and key not in WHOLE else value for key, value in made.items()
    }
    return mixed | {key: value for key, value in given.items() if key not in made or key in WHOLE}
