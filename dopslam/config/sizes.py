"""Whether what a scenario's numbers ask for together can exist and fits in memory."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from dopslam.config.arrays import LARGEST_ARRAY, elements

if TYPE_CHECKING:
    from dopslam.config.sections import Sections

LARGEST_SNAPSHOT = 50_000_000  # samples, 0.4 GB
LARGEST_DOPPLER = 4000  # resolution widths; a search of 850 takes 8 s a snapshot


def refuse(scenario: Sections) -> None:
    """Raise ValueError, which names the keys and the limit, for what cannot be."""
    radio, station = scenario.radio, elements(scenario.base_station.array)
    digital = radio.beams.kind == "digital"
    sent = {"elements of base_station.array": station} if digital else {"radio.beams.beams": radio.beams.beams}
    factors = {
        "radio.subcarriers": radio.subcarriers, **sent,
        "radio.beams.sweeps": radio.beams.sweeps,
        **({} if radio.stagger is None else {"symbols of radio.stagger": len(radio.shifts)}),
        "elements of receiver.array": elements(scenario.receiver.array),
    }  # fmt: skip
    samples = math.prod(factors.values())
    if samples > LARGEST_SNAPSHOT or station > LARGEST_ARRAY:
        said = " × ".join(f"{name} = {value}" for name, value in factors.items())
        raise ValueError(
            f"{said} is {samples:.3g} samples a snapshot, with {station} elements of base_station.array; at most "
            f"{LARGEST_SNAPSHOT:.0e} and {LARGEST_ARRAY} fit in memory"
        )
    if not digital and radio.beams.beams * station > LARGEST_SNAPSHOT:
        raise ValueError(
            f"radio.beams.beams = {radio.beams.beams} beams of {station} elements are more than {LARGEST_SNAPSHOT:.0e} "
            "weights; they do not fit in memory"
        )
    spanned = radio.subcarriers * radio.comb if radio.pilots is None else radio.pilots[-1] - radio.pilots[0]
    band = spanned * radio.subcarrier_spacing
    if band > radio.carrier_frequency:
        raise ValueError(
            f"radio.subcarriers × radio.comb × radio.subcarrier_spacing is a band of {band:.3g} Hz, more than "
            f"radio.carrier_frequency = {radio.carrier_frequency:g} Hz"
        )
    duration = (1 if digital else radio.beams.beams) * radio.beams.sweeps * len(radio.shifts) * radio.symbol_period
    speed = scenario.estimator.max_radial_velocity
    widths = 2 * speed * duration * radio.carrier_frequency / 299_792_458.0
    if widths > LARGEST_DOPPLER:
        raise ValueError(
            f"estimator.max_radial_velocity = {speed:g} m/s both ways is {widths:.3g} times what {duration:.3g} s of "
            f"symbols resolve; at most {LARGEST_DOPPLER} are searched"
        )
