"""Monte Carlo studies and bound tables of a scenario: from config keys and options to the library's
records.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dopslam.config.scenario import Scenario
from dopslam.errors import ConfigError
from dopslam.evaluate.bounds import Bound, doppler_contribution, situation_bound
from dopslam.pipeline import problem as build
from dopslam.simulate.world import FixedNoise, Situation, unknown_motion
from dopslam.studies.montecarlo import Study


def world(scenario: Scenario, prior: str, doppler_std: float | None) -> Situation:
    """The model source of a scenario; speed and turn rate are in the state if they are in the
    filter's.
    """
    if not scenario.source.model.virtual_anchors and not scenario.scatter_point:
        raise ConfigError(
            f"{scenario.name}: the model source has no landmark; list source.model.virtual_anchors or [[scatter_point]]"
        )
    situation = build.situation(scenario, prior)
    noise = situation.noise
    if doppler_std is not None and isinstance(noise, FixedNoise):
        situation = replace(situation, noise=replace(noise, std=np.array([*noise.std[:5], doppler_std])))
    if build.motion(scenario).dimension > situation.motion.dimension:
        f = scenario.filter
        situation = unknown_motion(situation, f.speed_std, f.turn_rate_std, f.speed_walk, f.turn_rate_walk)
    return situation


def study(
    scenario: Scenario,
    filter_name: str = "joint",
    prior: str = "std",
    doppler: bool = True,
    doppler_std: float | None = None,
) -> Study:
    """A Monte Carlo study of one filter on detections drawn from the model.

    Parameters
    ----------
    scenario : Scenario
    filter_name : of :data:`dopslam.filters.FILTERS`
    prior : 'std' or 'var', the reading of `track.start_std`
    doppler : whether the filter uses Doppler
    doppler_std : its standard deviation [m/s], default the scenario's
    """
    situation = world(scenario, prior, doppler_std)
    return Study(
        situation=situation,
        chosen=build.chosen_filter(scenario, filter_name, doppler),
        problem=build.told(situation, scenario),
        cutoff=scenario.evaluation.gospa_cutoff,
        order=scenario.evaluation.gospa_order,
        report=scenario.filter.report_existence,
    )


def nominal_bound(
    scenario: Scenario,
    prior: str = "std",
    doppler: bool = True,
    doppler_std: float | None = None,
    visibility: float | None = None,
    weight_by_probability: bool = False,
) -> Bound:
    """Bound on the nominal track with p_D = 1 (or information weighted by p_D)."""
    return situation_bound(
        world(scenario, prior, doppler_std),
        doppler=doppler,
        visibility=visibility,
        weight_by_probability=weight_by_probability,
    )


def bound_table(bound: Bound, names: NDArray[np.str_]) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the CSV: `step,peb_m,heb_rad,ceb_m,leb_<landmark>_m`, empty until a landmark is
    seen.
    """
    landmarks = np.arange(1, bound.landmark.shape[1])
    columns = [f"leb_{str(names[i]).replace(' ', '_')}_m" for i in landmarks]
    header, rows = ["step", "peb_m", "heb_rad", "ceb_m", *columns], []
    for k in range(len(bound.peb)):
        errors = ["" if np.isnan(value) else f"{value:.9g}" for value in bound.leb[k, landmarks]]
        rows.append([str(k + 1), f"{bound.peb[k]:.9g}", f"{bound.heb[k]:.9g}", f"{bound.ceb[k]:.9g}", *errors])
    return header, rows


def contribution_table(
    scenario: Scenario, prior: str = "std", doppler_std: float | None = None
) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the CSV of (22)-(25): direct information of each path with and without its Doppler.

    Position and landmark columns are traces [1/m²], heading [1/rad²]; a path's Doppler adds the `doppler_` column to
    the `rest_` column of its other five rows.
    """
    situation = world(scenario, prior, doppler_std)
    names = build.model_landmarks(scenario).name
    parts = doppler_contribution(situation)
    columns = {
        "doppler_position_1_m2": parts.position,
        "rest_position_1_m2": parts.position_rest,
        "doppler_heading_1_rad2": parts.heading,
        "rest_heading_1_rad2": parts.heading_rest,
        "doppler_landmark_1_m2": parts.landmark,
        "rest_landmark_1_m2": parts.landmark_rest,
    }
    rows = [
        [str(k + 1), str(name), *(f"{value[k, i]:.9g}" for value in columns.values())]
        for k in range(situation.steps)
        for i, name in enumerate(names)
    ]
    return ["step", "landmark", *columns], rows
