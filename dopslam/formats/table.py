"""Detections that somebody else measured or simulated, as a dataset that ``dopslam slam`` runs on.

A table (CSV with a header, or a MATLAB file of equally long vectors) holds one row per detected path. Commas, tabs, or
semicolons with decimal commas; a cell that is empty or NaN was not measured in that row, and a row without any
measurement is a snapshot that found nothing. A small TOML file says what its columns mean::

    [columns]                  # ours = "name in the table"; any subset, but time or step, and delay or an angle
    time = "t"                 # or step, counted from 0 (from 1: [offsets] step = 1)
    delay = "toa"
    aoa_azimuth = "phi"        # and aoa_elevation, aod_azimuth, aod_elevation
    doppler = "fd"             # or radial_velocity
    power = "p"                # or snr
    delay_std = "toa_sigma"    # …_std columns in the unit of their quantity

    [units]                    # default: s, rad, Hz, m/s, linear
    time = "ms"                # s ms us ns min
    delay = "ns"               # s ms us ns ps m
    aoa_azimuth = "deg"        # rad deg
    doppler = "kHz"            # Hz kHz; radial_velocity: m/s km/h
    power = "dB"               # linear dB dBm

    [conventions]              # defaults first
    elevation = "horizon"      # or "zenith": angles from the vertical; aoa_elevation, aod_elevation for one of them
    azimuth = "counterclockwise"   # or "clockwise"
    aoa_frame = "receiver"     # or "world": not turned with the heading; needs the true headings
    aod_frame = "base_station" # or "world"
    doppler = "approaching"    # or "receding": which sign is positive
    uplink = false             # true: the table calls AOA what is measured at the base station

    [offsets]                  # subtracted from the table's values, in the table's unit
    delay = 12.5

    [std]                      # in the table's unit, where there is no …_std column
    delay = 0.3

    [assumed]                  # what to put where a quantity is missing, in rad, s or m/s
                               # (with [std] it counts as measured)
    aoa_elevation = 0.0

    noise_floor_db = -90.0     # with power: what is subtracted to get the SNR
    delay_modulo = 2083.3      # in the unit of delay, if delays are known modulo this only (inverse of the pilots' spacing)

A quantity that is neither measured nor assumed gets a variance so wide that it tells nothing, and the volume over
which false
paths spread is widened alike, so that no hypothesis gains by it.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dopslam.config.scenario import Scenario
from dopslam.errors import DatasetError
from dopslam.formats.columns import read_table
from dopslam.formats.contract import Opened
from dopslam.formats.possible import QUANTITIES, refuse_impossible, refuse_strengths
from dopslam.formats.times import period_of, snapshots
from dopslam.models import unmeasured
from dopslam.records import SPEED_OF_LIGHT, DetectionSeries, Track

WIDTHS = (None, 2 * np.pi, np.pi, 2 * np.pi, np.pi, None)  # of what is searched; None: from the scenario or the data
UNITS = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "delay": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "ps": 1e-12, "m": 1 / SPEED_OF_LIGHT},
    "angle": {"rad": 1.0, "deg": np.pi / 180},
    "doppler": {"Hz": 1.0, "kHz": 1e3},
    "radial_velocity": {"m/s": 1.0, "km/h": 1 / 3.6},
    "power": {"linear": 1.0, "dB": 1.0, "dBm": 1.0},
    "snr": {"linear": 1.0, "dB": 1.0},
}
CONVENTIONS: dict[str, tuple] = {
    "elevation": ("horizon", "zenith"),
    "aoa_elevation": ("horizon", "zenith"),
    "aod_elevation": ("horizon", "zenith"),
    "azimuth": ("counterclockwise", "clockwise"),
    "aoa_frame": ("receiver", "world"),
    "aod_frame": ("base_station", "world"),
    "doppler": ("approaching", "receding"),
    "uplink": (False, True),
}


@dataclass(frozen=True)
class Mapping:
    """A validated TOML mapping; see the module's text for the keys."""

    columns: dict[str, str]
    units: dict[str, str]
    conventions: dict[str, Any]
    offsets: dict[str, float]
    std: dict[str, float]
    assumed: dict[str, float]
    noise_floor_db: float | None = None
    delay_modulo: float | None = None


def read_mapping(path: str | Path) -> Mapping:
    """Read and validate a mapping.

    Raises
    ------
    DatasetError
        Naming the key, its value, and what is allowed.
    """
    try:
        tree = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise DatasetError(f"{path}: not a readable TOML mapping ({error})") from error
    measured = [*QUANTITIES, "doppler", "power", "snr"]
    allowed = {
        "columns": ["time", "step", *measured, *(f"{name}_std" for name in measured[:7])],
        "units": ["time", *measured], "conventions": list(CONVENTIONS), "offsets": ["time", "step", *measured],
        "std": measured[:7],
        "assumed": list(QUANTITIES),
    }  # fmt: skip
    for section, content in tree.items():
        if section in ("noise_floor_db", "delay_modulo"):
            continue
        if section not in allowed or not isinstance(content, dict):
            raise DatasetError(f"{path}: unknown section [{section}]; known are {', '.join(allowed)}")
        for key, value in content.items():
            if key not in allowed[section]:
                raise DatasetError(f"{path}: unknown key {section}.{key}; known are {', '.join(allowed[section])}")
            kind = {"columns": str, "units": str, "conventions": str | bool}.get(section, float | int)
            if not isinstance(value, kind) or (section in ("offsets", "std", "assumed") and isinstance(value, bool)):
                raise DatasetError(f"{path}: {section}.{key} = {value!r} is of the wrong type")
    for name, unit in tree.get("units", {}).items():
        if unit not in _units(name):
            raise DatasetError(f"{path}: units.{name} = {unit!r}; known are {', '.join(_units(name))}")
    for name, value in tree.get("conventions", {}).items():
        if value not in CONVENTIONS[name]:
            raise DatasetError(f"{path}: conventions.{name} = {value!r}; choose one of {CONVENTIONS[name]}")
    for name, value in tree.get("std", {}).items():
        if not 0 < value < np.inf:
            raise DatasetError(f"{path}: std.{name} = {value!r}; give a positive number")
    floor = tree.get("noise_floor_db")
    number = isinstance(floor, int | float) and not isinstance(floor, bool)
    if floor is not None and not (number and np.isfinite(floor)):
        raise DatasetError(f"{path}: noise_floor_db = {floor!r}; give a number in dB")
    modulo = tree.get("delay_modulo")
    if modulo is not None and not (isinstance(modulo, int | float) and 0 < modulo < np.inf):
        raise DatasetError(f"{path}: delay_modulo = {modulo!r}; give a positive number in the unit of delay")
    columns = tree.get("columns", {})
    if "power" in columns and floor is None:
        raise DatasetError(
            f"{path}: [columns] has power; without noise_floor_db = … (dB) it says nothing about the SNR"
        )
    if not {"time", "step"} & set(columns) or not (set(QUANTITIES) | {"doppler"}) & set(columns):
        raise DatasetError(f"{path}: [columns] needs time or step, and at least one of {', '.join(QUANTITIES)}")
    return Mapping(
        columns, *(tree.get(s, {}) for s in ("units", "conventions", "offsets", "std", "assumed")),
        noise_floor_db=floor, delay_modulo=modulo,
    )  # fmt: skip


def _delay_unit(mapping: Mapping) -> float:
    return UNITS["delay"][mapping.units.get("delay", "s")]


def _units(name: str) -> dict[str, float]:
    return UNITS["angle"] if name.startswith("ao") else UNITS[name]


def columns_of(path: str | Path, mapping: Mapping) -> dict[str, np.ndarray]:
    """Columns of a table by our names, in its units; time in seconds, steps counted from 0; NaN where a quantity was not
    measured."""
    able = [ours for ours in mapping.columns if ours.removesuffix("_std") in (*QUANTITIES, "doppler")]
    table = read_table(path, list(mapping.columns.values()), frozenset(mapping.columns[ours] for ours in able))
    get = {ours: table[theirs] for ours, theirs in mapping.columns.items()}
    for name in {"time", "step"} & set(get):
        scale = UNITS["time"][mapping.units.get("time", "s")] if name == "time" else 1.0
        get[name] = (get[name] - mapping.offsets.get(name, 0.0)) * scale
    return get


def detections(
    path: str | Path,
    mapping: Mapping,
    scenario: Scenario,
    steps: int | None = None,
    truth: Track | None = None,
    table: dict[str, np.ndarray] | None = None,
) -> DetectionSeries:
    """A foreign table as detections.

    Parameters
    ----------
    path : CSV or MATLAB file
    mapping : what its columns mean
    scenario : its carrier and BS yaw are used where needed
    steps : number of snapshots; default up to the last detection
    truth : true track; its times are the snapshots', and AOAs in the world frame need its headings
    table : the file's columns where they have been read already, as :func:`columns_of` gives them
    """
    get = columns_of(path, mapping) if table is None else table
    step, time = snapshots(path, get, truth)
    count = steps if steps is not None else int(step.max(initial=-1)) + 1 if time is None else len(time)
    outside = (step < 0) | (step >= count)
    if outside.any():
        raise DatasetError(
            f"{path}: {int(outside.sum())} rows lie outside the track's {count} steps, the first in data row "
            f"{int(np.argmax(outside)) + 1}; give the track of the same drive"
        )
    order = np.argsort(step, kind="stable")
    order = order[_tells(get)[order]]
    get, step = {name: column[order] for name, column in get.items()}, step[order]
    z, std = _measured(path, get, mapping, scenario)
    if mapping.conventions.get("uplink", False):
        z[:, [1, 2, 3, 4]], std[:, [1, 2, 3, 4]] = z[:, [3, 4, 1, 2]], std[:, [3, 4, 1, 2]]
    if mapping.conventions.get("aoa_frame") == "world":
        if truth is None:
            raise DatasetError(f"{path}: conventions.aoa_frame = 'world' needs the true headings; give --track")
        z[:, 1] -= truth.heading[step]
    if mapping.conventions.get("aod_frame") == "world":
        z[:, 3] -= np.deg2rad(scenario.base_station.yaw_deg)
    refuse_impossible(path, z, std, order)
    missing = np.isnan(std)
    widths = np.array([w if w else d for w, d in zip(WIDTHS, _widths(z, scenario), strict=True)])
    std = np.where(missing, unmeasured.deviation(widths), std)
    z[:, [1, 3]] = (z[:, [1, 3]] + np.pi) % (2 * np.pi) - np.pi
    metres = widths * [SPEED_OF_LIGHT, 1, 1, 1, 1, 1]  # as the filters have it
    snr = _snr(get, mapping)
    refuse_strengths(path, snr, order)
    return DetectionSeries(
        offsets=np.concatenate([[0], np.cumsum(np.bincount(step, minlength=count))]),
        delay=z[:, 0], aoa=z[:, 1:3], aod=z[:, 3:5], radial_velocity=z[:, 5],
        gain=np.sqrt(snr).astype(complex),
        covariance=std[:, :, None] ** 2 * np.eye(6),
        snr=snr,
        noise_variance=np.ones(count),
        threshold=float(snr.min(initial=np.inf)) if len(snr) else 1.0,
        false_alarm_rate=float(scenario.source.model.clutter_rate),
        search_volume=unmeasured.volume(metres, missing.mean(axis=0) if len(missing) else np.zeros(6)),
        time=time, delay_range=np.inf if mapping.delay_modulo is None else mapping.delay_modulo * _delay_unit(mapping),
    )  # fmt: skip


def _tells(get: dict[str, np.ndarray]) -> np.ndarray:
    """(N,) rows that measured anything; others say that a snapshot found nothing."""
    measured = [get[name] for name in (*QUANTITIES, "doppler") if name in get]
    return np.any(np.isfinite(measured), axis=0)


def _widths(z: np.ndarray, scenario: Scenario) -> list[float]:
    """Widths that are searched, of those quantities that have no natural one: delay [s] and radial velocity [m/s]."""
    reach = max(float(np.ptp(z[:, 0])) if len(z) else 0.0, scenario.source.model.clutter_range / SPEED_OF_LIGHT)
    speed = scenario.estimator.max_radial_velocity
    return [reach, 0, 0, 0, 0, 2 * speed]


def _measured(path, get: dict[str, np.ndarray], mapping: Mapping, scenario: Scenario) -> tuple[np.ndarray, np.ndarray]:
    """Values (N, 6) and standard deviations (N, 6) in SI units; NaN deviation where nothing is known."""
    rows = len(next(iter(get.values())))
    z, std = np.zeros((rows, 6)), np.full((rows, 6), np.nan)
    for i, name in enumerate(QUANTITIES):
        source = "doppler" if name == "radial_velocity" and "doppler" in get else name
        scale = _units(source).get(mapping.units.get(source, ""), 1.0)
        if source == "doppler":
            scale *= SPEED_OF_LIGHT / scenario.radio.carrier_frequency
        if source in get:
            z[:, i] = (get[source] - mapping.offsets.get(source, 0.0)) * scale
            there = ~np.isnan(z[:, i])
            if f"{source}_std" in get:
                std[:, i] = get[f"{source}_std"] * scale
            elif source in mapping.std:
                std[:, i] = mapping.std[source] * scale
            else:
                raise DatasetError(
                    f"{path}: how accurate is {source}? Give std.{source} or a column {source}_std in the mapping"
                )
            if not np.all(std[there, i] > 0):
                raise DatasetError(f"{path}: column {source}_std holds values that are missing or not positive")
            _turn(name, i, z, mapping)
            z[~there, i], std[~there, i] = _instead(name, z[there, i], mapping), np.nan
        elif name in mapping.assumed:
            z[:, i] = mapping.assumed[name]
            if name in mapping.std:
                std[:, i] = mapping.std[name] * scale
    return z, std


def _instead(name: str, measured: np.ndarray, mapping: Mapping) -> float:
    """What stands for a quantity in the rows that lack it: where the law is linearized, with a deviation that tells nothing."""
    usual = 0.0 if name.endswith("azimuth") or not len(measured) else float(np.median(measured))
    return mapping.assumed.get(name, usual)


def _turn(name: str, i: int, z: np.ndarray, mapping: Mapping) -> None:
    if name.endswith("elevation") and mapping.conventions.get(name, mapping.conventions.get("elevation")) == "zenith":
        z[:, i] = np.pi / 2 - z[:, i]
    if name.endswith("azimuth") and mapping.conventions.get("azimuth") == "clockwise":
        z[:, i] *= -1
    if name == "radial_velocity" and mapping.conventions.get("doppler") == "receding":
        z[:, i] *= -1


def _snr(get: dict[str, np.ndarray], mapping: Mapping) -> np.ndarray:
    """(N,) linear SNR, one where there is neither SNR nor power."""
    rows = len(next(iter(get.values())))
    for name, floor in (("snr", 0.0), ("power", mapping.noise_floor_db or 0.0)):
        if name in get:
            value = get[name] - mapping.offsets.get(name, 0.0)
            decibel = (
                value
                if mapping.units.get(name, "linear").startswith("dB")
                else 10 * np.log10(np.maximum(value, 1e-300))
            )
            return 10 ** ((decibel - floor) / 10)
    return np.ones(rows)


def knows_snr(mapping: Mapping) -> bool:
    """Whether the table tells the strength of its paths, so that the probability of detection can follow it."""
    return bool({"snr", "power"} & set(mapping.columns))


def _remarks(get: dict[str, np.ndarray]) -> tuple[str, ...]:
    """What was made of a table that somebody may not have meant."""
    tells, said = _tells(get), []
    for name in (*QUANTITIES, "doppler"):
        gone = int(np.isnan(get[name][tells]).sum()) if name in get else 0
        if gone:
            said.append(f"{name} is missing in {gone} of {tells.sum()} rows and counts there as not measured")
    if not tells.all():
        said.append(f"{int((~tells).sum())} rows without any measurement are taken as snapshots that found nothing")
    if "step" in get and get["step"].min() == 1:
        said.append("steps begin at 1: if they are counted from 1, say so in the mapping ([offsets] step = 1)")
    return tuple(said)


class ForeignTable:
    """A CSV or MATLAB table with a mapping."""

    writes, reads = False, True

    def read(self, path: Path, mapping: Path | None) -> Opened:
        """Open it."""
        if mapping is None:
            raise DatasetError(f"{path}: a table needs a mapping that says what its columns mean; give --map")
        rule = read_mapping(mapping)
        columns = columns_of(path, rule)

        def found(world: Scenario, truth: Track | None) -> DetectionSeries:
            return detections(path, rule, world, None if truth is None else truth.steps, truth, columns)

        period = None if "step" in rule.columns else period_of(columns["time"])
        return Opened(
            found, period, bool({"doppler", "radial_velocity"} & set(rule.columns)), knows_snr(rule), _remarks(columns)
        )
