"""Filters on free drives with unknown speed and turn rate, default keys: track error beside the bound of that motion model.

The drive is a file of a scenario, so that everything a filter is told is derived as for a user's own
(:mod:`dopslam.config.fitted`); detections are drawn with covariances that follow the SNR of each landmark.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from dopslam.config.scenario import parse
from dopslam.errors import DopslamError
from dopslam.evaluate.bounds import detection_mask, situation_bound
from dopslam.evaluate.metrics import nees, state_errors
from dopslam.pipeline import stages
from dopslam.pipeline.problem import chosen_filter, problem
from dopslam.simulate.drives import KINDS, drive, surroundings
from dopslam.simulate.world import Situation, SnrNoise, draw_scans
from dopslam.slam.filter import run
from estimation.statistics import bootstrap, share

STEPS, PERIOD, HEIGHT = 60, 0.2, 1.5
UNIT_STD = np.array([0.3, 0.05, 0.05, 0.05, 0.05, 0.5])  # m, rad ×4, m/s at ρ = 1
CLUTTER = 0.05  # false detections a scan
LARGEST_RATIO, LARGEST_NEES = 1.5, 8.0


def judged(kind: str, seed: int, name: str = "joint", settings=()) -> dict:
    """One drive: position RMSE, its bound, NEES; or why there is none."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(list(KINDS).index(kind),)))
    rows = drive(KINDS[kind], STEPS, PERIOD, rng)
    what, where, strength = surroundings(KINDS[kind], rows[:, 1:], HEIGHT, rng)
    result: dict = {"kind": kind, "seed": seed}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "drive.csv"
        np.savetxt(file, rows, delimiter=",", header="time,x,y", comments="")
        scenario = parse(_text(file, where[0]), settings)
        track = stages.draw_track(scenario, seed)
    told = problem(scenario)
    states, _ = told.motion.truth(track)
    mean = told.mean + np.sqrt(np.diag(told.covariance)) * rng.standard_normal(len(told.mean))
    noise = SnrNoise(UNIT_STD * rng.uniform(0.5, 2.0), strength)
    world = Situation(
        where[0], what.astype(np.int64), where, told.motion, mean, told.covariance, STEPS, noise,
        clutter_count=CLUTTER, doppler_limit=told.doppler_limit, height=HEIGHT,
    )  # fmt: skip
    scans = draw_scans(world, states, rng, rng)
    try:
        history, _ = run(replace(told, mean=mean), scans, chosen_filter(scenario, name), seed)
    except DopslamError as error:
        return result | {"error": str(error)}
    assert scans.label is not None
    bound = situation_bound(world, states, detected=detection_mask(scans.label, scans.offsets, len(what)))
    error = state_errors(history.mean, states)
    return result | {
        "rmse": float(np.sqrt(np.mean(np.sum(error[:, :2] ** 2, axis=1)))),
        "bound": float(np.sqrt(np.mean(bound.peb**2))),
        "nees": float(np.mean(nees(error[:, :4], history.covariance[:, :4, :4]))),
    }


def _text(file: Path, station: np.ndarray) -> str:
    """A scenario that says no more than a person must."""
    return f"""
name = "drive"
[scene]
file = "none.xml"
[base_station]
position = {station.tolist()}
array = {{ kind = "cylinder", columns = 8, rings = 2 }}
[receiver]
height = {HEIGHT}
array = {{ kind = "cylinder", columns = 8, rings = 2 }}
[track]
file = "{file.as_posix()}"
period = {PERIOD}
"""


def passes(result: dict) -> bool:
    """Whether track and covariance are what they should be."""
    return (
        "error" not in result and result["rmse"] <= LARGEST_RATIO * result["bound"] and result["nees"] <= LARGEST_NEES
    )


def summarize(results: list[dict]) -> dict:
    """Share of drives that pass, and over those with a result the root mean square of RMSE over bound and the mean NEES,
    each with its 95 % interval."""
    done = [r for r in results if "error" not in r]
    squares = np.array([(r["rmse"] / r["bound"]) ** 2 for r in done])
    values = np.array([r["nees"] for r in done])
    return {
        "drives": len(results),
        "without_result": len(results) - len(done),
        "passing": share(sum(map(passes, results)), len(results)),
        "rmse_over_bound": float(np.sqrt(squares.mean())),
        "rmse_over_bound_interval": bootstrap(squares, lambda v: float(np.sqrt(np.mean(v)))),
        "nees": float(values.mean()),
        "nees_interval": bootstrap(values),
    }
