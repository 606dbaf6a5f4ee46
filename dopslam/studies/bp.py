"""Paper B's synthetic experiment as a scenario says it: from config keys to a :class:`~dopslam.studies.bp_cases.Case`."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np

from dopslam.config.scenario import Scenario
from dopslam.errors import ConfigError
from dopslam.models.amplitude import AmplitudeModel, Radio, flat_rms_bandwidth
from dopslam.pipeline.problem import assumptions
from dopslam.records import SPEED_OF_LIGHT
from dopslam.slam.belief.experiment import Experiment
from dopslam.slam.belief.records import Form, Parameters
from dopslam.studies.bp_cases import Case

_CONVERGENCE = 20  # steps that a uniform start is given before its errors count


def experiment_of(scenario: Scenario) -> Experiment:
    """The experiment of ``[experiment]`` with the scenario's anchor, features, radio and nominal track.

    Raises
    ------
    ConfigError
        Without ``[experiment]``, or if its amplitudes are not one per path.
    """
    config, track, radio = scenario.experiment, scenario.track, scenario.radio
    if config is None:
        raise ConfigError(
            f"{scenario.name}: no [experiment] to draw amplitudes from; use --source model, or a scenario like pedestrian"
        )
    anchors, points = scenario.source.model.virtual_anchors, [p.position for p in scenario.scatter_point]
    if len(config.amplitudes) != 1 + len(anchors) + len(points):
        raise ConfigError(
            f"{scenario.name}: experiment.amplitudes has {len(config.amplitudes)} entries for the line of sight, "
            f"{len(anchors)} of source.model.virtual_anchors and {len(points)} [[scatter_point]]; give one per path"
        )
    wavelength = SPEED_OF_LIGHT / radio.carrier_frequency
    band = radio.subcarriers * radio.comb * radio.subcarrier_spacing
    return Experiment(
        anchor=np.array(scenario.base_station.position),
        features=np.array([*anchors, *points]),
        forms=(Form.VA_AOD,) * len(anchors) + (Form.PS,) * len(points),
        amplitudes=config.amplitudes,
        distances=config.reference_distances,
        radio=Radio(
            radio.carrier_frequency,
            flat_rms_bandwidth(band),
            config.rx_aperture_wavelengths * wavelength,
            config.tx_aperture_wavelengths * wavelength,
        ),
        detector=AmplitudeModel(float(10 ** (config.threshold_db / 20)), config.samples),
        false_alarm_rate=config.false_alarms,
        distance_end=config.distance_end,
        spurious_rate=config.spurious,
        spurious_end=config.spurious_end,
        steps=track.steps,
        interval=track.period,
        start=np.array([track.start[0], track.start[1], scenario.receiver.height]),
        heading=track.start[2],
        speed=track.speed,
        heading_noise=float(np.deg2rad(config.heading_noise_deg)),
        speed_noise=config.speed_noise,
        climb_noise=config.climb_noise,
        blocked=config.blocked,
        spatial=config.spatial,
    )


def parameters_of(scenario: Scenario, experiment: Experiment) -> Parameters:
    """The filter's parameters: matched to the experiment, the rest from ``[belief]``."""
    belief, matched = scenario.belief, experiment.parameters
    amplitude = matched.amplitude
    if belief.false_alarm_tail is not None:
        amplitude = replace(amplitude, tail_weight=belief.false_alarm_tail)
    return replace(
        matched,
        amplitude=amplitude,
        **asdict(assumptions(belief, "paper")),
    )


def case_of(scenario: Scenario) -> Case:
    """The study that a scenario describes; see :func:`experiment_of` for its errors."""
    experiment, belief = experiment_of(scenario), scenario.belief
    if belief.engine == "stacked" and experiment.spatial:
        raise ConfigError(f"{scenario.name}: belief.engine = 'stacked' is planar; set experiment.spatial = false")
    informed = belief.start == "informed"
    skip = belief.skip if belief.skip is not None else (0 if informed else _CONVERGENCE)
    if skip >= experiment.steps:
        raise ConfigError(f"{scenario.name}: belief.skip = {skip} leaves none of the {experiment.steps} steps to score")
    parameters = parameters_of(scenario, experiment)
    return Case(
        experiment,
        parameters.types,
        scenario.filter.particles,
        informed,
        skip,
        belief.engine,
        belief.backend,
        belief.speed_increment,
        parameters,
    )
