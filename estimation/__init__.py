"""Open parametric channel estimation: joint delay, AOA, AOD, Doppler and complex amplitude of an unknown number
of paths.

Usable alone: this package knows nothing of ray tracing or SLAM. A minimal run::

    import numpy as np
    from estimation import Nomp, PathTable, SignalModel, comb, cylinder, random_phase_beams, sweep, synthesize

    rng = np.random.default_rng(1)
    model = SignalModel(comb(28e9, 120e3, pilots=400, step=4),
                        sweep(random_phase_beams(16, 32, rng), sweeps=8, period=35.68e-6, rng=rng),
                        transmitter=cylinder(16, 2), receiver=cylinder(8, 2))
    paths = PathTable(delay=[1.2e-6], aoa=[[0.3, 0.5]], aod=[[-2.8, -0.5]], radial_velocity=[12.0], gain=[0.05j])
    detections = Nomp(model).run(synthesize(model, paths, noise_variance=1.0, rng=rng))

Nothing is imported before it is used.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .ambiguities import Ambiguity, ScheduleWarning, ambiguity, check_schedule
    from .detections import Detections, Flag
    from .errors import EstimationError, ModelError, SignalError
    from .estimators.detect import detection_probability
    from .estimators.dmc import exponential_profile, pilot_covariance
    from .estimators.esprit import Esprit
    from .estimators.grids import View
    from .estimators.nomp import Nomp
    from .estimators.sage import Sage
    from .fisher import crb, fisher_information, snr
    from .signal.arrays import Array, Manifold, Pattern, cylinder, ula, ura
    from .signal.directions import angles_of, unit_vectors
    from .signal.impairments import Impairments, WeightedPattern
    from .signal.model import SignalModel
    from .signal.noise import white_noise
    from .signal.nr import prs, srs, staggered
    from .signal.paths import PARAMETERS, PathTable
    from .signal.patterns import CosinePattern, DipolePattern, EadfArray, outward
    from .signal.schedule import (
        Schedule,
        antenna_switching,
        dft_beams,
        digital,
        random_phase_beams,
        simultaneous,
        sweep,
    )
    from .signal.synthesis import synthesize
    from .signal.waveform import SPEED_OF_LIGHT, Waveform, comb

_HOMES = {
    "ambiguities": "Ambiguity ScheduleWarning ambiguity check_schedule",
    "detections": "Detections Flag",
    "errors": "EstimationError ModelError SignalError",
    "estimators.detect": "detection_probability",
    "estimators.dmc": "exponential_profile pilot_covariance",
    "estimators.esprit": "Esprit",
    "estimators.grids": "View",
    "estimators.nomp": "Nomp",
    "estimators.sage": "Sage",
    "fisher": "crb fisher_information snr",
    "signal.arrays": "Array Manifold Pattern cylinder ula ura",
    "signal.directions": "angles_of unit_vectors",
    "signal.impairments": "Impairments WeightedPattern",
    "signal.model": "SignalModel",
    "signal.noise": "white_noise",
    "signal.paths": "PARAMETERS PathTable",
    "signal.patterns": "CosinePattern DipolePattern EadfArray outward",
    "signal.nr": "prs srs staggered",
    "signal.schedule": "Schedule antenna_switching dft_beams digital random_phase_beams sweep simultaneous",
    "signal.synthesis": "synthesize",
    "signal.waveform": "SPEED_OF_LIGHT Waveform comb",
}
_HOME = {name: module for module, names in _HOMES.items() for name in names.split()}

__all__ = [
    "PARAMETERS",
    "SPEED_OF_LIGHT",
    "Ambiguity",
    "Array",
    "CosinePattern",
    "Detections",
    "DipolePattern",
    "EadfArray",
    "Esprit",
    "EstimationError",
    "Flag",
    "Impairments",
    "Manifold",
    "ModelError",
    "Nomp",
    "PathTable",
    "Pattern",
    "Sage",
    "Schedule",
    "ScheduleWarning",
    "SignalError",
    "SignalModel",
    "View",
    "Waveform",
    "WeightedPattern",
    "ambiguity",
    "angles_of",
    "antenna_switching",
    "check_schedule",
    "comb",
    "crb",
    "cylinder",
    "detection_probability",
    "dft_beams",
    "digital",
    "exponential_profile",
    "fisher_information",
    "outward",
    "pilot_covariance",
    "prs",
    "random_phase_beams",
    "simultaneous",
    "snr",
    "srs",
    "staggered",
    "sweep",
    "synthesize",
    "ula",
    "unit_vectors",
    "ura",
    "white_noise",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"estimation.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
