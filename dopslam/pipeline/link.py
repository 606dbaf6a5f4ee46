"""Where the scenario meets the signal: arrays, waveform, link budget, and traced paths as the estimator's parameters.

The receiver measures geometric delay plus clock bias. Gains are in √W per pilot: ``a·√(P/pilots)·e^{−j2πf_cτ}``; the
noise
variance is the thermal noise of one subcarrier, k·T·Δf·F.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dopslam.config.arrays import ArrayConfig, CustomArray, CylinderArray, PlanarArray
from dopslam.config.scenario import Scenario
from dopslam.errors import ConfigError
from dopslam.records import SPEED_OF_LIGHT, Paths, Track
from estimation import (
    Array,
    CosinePattern,
    DipolePattern,
    Impairments,
    PathTable,
    SignalModel,
    Waveform,
    antenna_switching,
    comb,
    cylinder,
    dft_beams,
    digital,
    estimators,
    outward,
    random_phase_beams,
    staggered,
    sweep,
    ura,
)

BOLTZMANN = 1.380649e-23  # J/K


def build_array(config: ArrayConfig) -> Array:
    """Array in its own frame, positions in wavelengths, from its description."""
    match config:
        case CylinderArray():
            bare = cylinder(config.columns, config.rings, spacing=config.spacing_wavelengths)
            patch = outward(bare.positions)
        case PlanarArray():
            bare = ura(config.rows, config.columns, config.spacing_wavelengths)
            patch = CosinePattern()
        case CustomArray():
            return Array(np.asarray(config.positions_wavelengths))
    patterns = {"isotropic": None, "cosine": patch, "dipole": DipolePattern()}
    return replace(bare, pattern=patterns[config.pattern])


def signal_model(scenario: Scenario) -> SignalModel:
    """The model that both synthesis and estimation use: eq. (2), paper A, with swept beams and a digital receiver; or,
    digital at both ends, the channel between all elements, ``H = sum g a_R(aoa) a_T(aod)^T ...``."""
    radio = scenario.radio
    spacing = radio.subcarrier_spacing
    transmitter = build_array(scenario.base_station.array)
    rng = np.random.default_rng(radio.beams.seed)
    if radio.beams.kind == "digital":
        schedule = digital(radio.beams.sweeps, radio.symbol_period)
        # Eq. (2) has a_T^H; the phases of a wave that leaves an element are those of the element opposite, conjugated.
        transmitter = replace(transmitter, positions=-transmitter.positions)
    else:
        schedule = sweep(
            _codebook(scenario, transmitter.elements, rng),
            radio.beams.sweeps,
            radio.symbol_period,
            order=radio.beams.order,
            rng=rng,
            stagger=None if radio.stagger is None else staggered(spacing, radio.comb, radio.shifts),
        )
    pilots = radio.pilots
    return SignalModel(
        waveform=comb(radio.carrier_frequency, spacing, radio.subcarriers, radio.comb)
        if pilots is None
        else Waveform(radio.carrier_frequency, spacing * np.array(pilots, float)),
        schedule=schedule,
        transmitter=transmitter,
        receiver=build_array(scenario.receiver.array),
        subbands=radio.subbands,
    )


def _codebook(scenario: Scenario, elements: int, rng: np.random.Generator) -> np.ndarray:
    beams, array = scenario.radio.beams, scenario.base_station.array
    if beams.kind == "random_phase":
        return random_phase_beams(beams.beams, elements, rng)
    if beams.beams != elements:
        raise ConfigError(
            f"radio.beams.beams = {beams.beams}: there are as many {beams.kind} beams as elements of the base station, "
            f"{elements}"
        )
    if beams.kind == "antenna":
        return antenna_switching(elements)
    if not isinstance(array, PlanarArray):
        raise ConfigError(
            'radio.beams.kind = "dft" needs base_station.array.kind = "planar"; use "random_phase" or "antenna"'
        )
    return dft_beams(array.rows, array.columns)


def estimator(scenario: Scenario, model: SignalModel, threshold: float | None = None):
    """The scenario's channel estimator; without ``threshold`` it is calibrated on noise for the false-alarm rate.

    Raises
    ------
    estimation.ModelError
        If this kind cannot work with these arrays, pilots and beams.
    """
    config = scenario.estimator
    return estimators.make(
        config.kind,
        model,
        config.options,
        false_alarm_rate=config.false_alarm_rate,
        max_speed=config.max_radial_velocity,
        max_paths=config.max_paths,
        dense_multipath=config.dense_multipath,
        threshold=threshold,
    )


def impairments(scenario: Scenario) -> Impairments | None:
    """What the hardware does to the signal, or None if it is as the model has it."""
    said = scenario.source.traced.impairments.model_dump(exclude={"seed", "position_wavelengths"})
    made = Impairments(position=scenario.source.traced.impairments.position_wavelengths, **said)
    return None if made == Impairments() else made


def noise_variance(scenario: Scenario) -> float:
    """Thermal noise of one subcarrier at the receiver [W]."""
    traced = scenario.source.traced
    return BOLTZMANN * traced.temperature * scenario.radio.subcarrier_spacing * 10 ** (traced.noise_figure_db / 10)


def pilot_amplitude(scenario: Scenario) -> float:
    """Transmitted amplitude of one pilot [√W]: the power is shared by all pilots."""
    watts = 1e-3 * 10 ** (scenario.source.traced.transmit_power_dbm / 10)
    return float(np.sqrt(watts / scenario.radio.subcarriers))


def path_table(scenario: Scenario, track: Track, paths: Paths, step: int) -> PathTable:
    """Traced paths of one step as the parameters of eq. (2): frames turned, clock bias and link budget applied.

    Returns
    -------
    PathTable
        In the order of ``paths.rows(step)``; AOA in the receiver's frame, AOD in the base station's.
    """
    rows = paths.rows(step)
    yaw = np.deg2rad(scenario.base_station.yaw_deg)
    carrier = scenario.radio.carrier_frequency
    return PathTable(
        delay=paths.tau[rows] + track.bias[step] / SPEED_OF_LIGHT,
        aoa=np.column_stack([_wrap(paths.phi_r[rows] - track.heading[step]), np.pi / 2 - paths.theta_r[rows]]),
        aod=np.column_stack([_wrap(paths.phi_t[rows] - yaw), np.pi / 2 - paths.theta_t[rows]]),
        radial_velocity=paths.doppler[rows] * SPEED_OF_LIGHT / carrier,
        gain=paths.a[rows] * pilot_amplitude(scenario) * np.exp(-2j * np.pi * carrier * paths.tau[rows]),
    )


def _wrap(angle: np.ndarray) -> np.ndarray:
    return (angle + np.pi) % (2 * np.pi) - np.pi
