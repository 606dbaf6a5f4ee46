"""Links of every architecture, small enough for exhaustive checks."""

from __future__ import annotations

import numpy as np
import pytest

from estimation import (
    PathTable,
    Schedule,
    SignalModel,
    comb,
    cylinder,
    digital,
    random_phase_beams,
    sweep,
    ura,
)


def small_models() -> dict[str, SignalModel]:
    """Digital, swept, hybrid, combined with a digital transmitter, and a wideband one."""
    rng = np.random.default_rng(5)
    waveform = comb(28e9, 480e3, 30)
    transmitter, receiver = cylinder(8, 2), ura(2, 3)
    beams = random_phase_beams(6, 16, rng)
    combiners = rng.standard_normal((2, 6, 3)) + 1j * rng.standard_normal((2, 6, 3))
    swept = sweep(beams, 3, 40e-6, rng=rng)
    combined = sweep(np.ones((1, 1)), 8, 40e-6, order="linear", combiners=combiners)
    return {
        "digital": SignalModel(waveform, digital(5, 100e-6), transmitter, receiver),
        "swept": SignalModel(waveform, swept, transmitter, receiver),
        "hybrid": SignalModel(waveform, sweep(beams, 3, 20e-6, combiners=combiners, rng=rng), transmitter, receiver),
        "combined": SignalModel(
            waveform,
            Schedule(combined.times, None, None, combiners, combined.combiner_index),
            transmitter,
            receiver,
        ),
        "wideband": SignalModel(comb(28e9, 13e6, 30), swept, transmitter, receiver, subbands=4),
    }


@pytest.fixture(params=["digital", "swept", "hybrid", "combined", "wideband"])
def model(request) -> SignalModel:
    """Each architecture in turn."""
    return small_models()[request.param]


@pytest.fixture
def paths() -> PathTable:
    """Three well separated paths in front of every array."""
    return PathTable(
        delay=[0.2e-6, 0.9e-6, 1.4e-6],
        aoa=[[0.3, 0.2], [-0.8, -0.3], [1.0, 0.5]],
        aod=[[2.0, 0.1], [-1.5, -0.5], [0.2, 0.7]],
        radial_velocity=[12.0, -20.0, 3.0],
        gain=[1.0, 0.5j, -0.3 + 0.2j],
    )


@pytest.fixture
def hybrid() -> SignalModel:
    """Precoders and combiners, as eq. (2) is printed."""
    return small_models()["hybrid"]
