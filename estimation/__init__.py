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
"""

from .ambiguity import Ambiguity, ScheduleWarning, ambiguity, check_schedule
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
from .signal.paths import PARAMETERS, PathTable
from .signal.patterns import CosinePattern, DipolePattern, EadfArray, outward
from .signal.schedule import Schedule, antenna_switching, dft_beams, digital, random_phase_beams, sweep
from .signal.synthesis import synthesize
from .signal.waveform import SPEED_OF_LIGHT, Waveform, comb

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
    "random_phase_beams",
    "snr",
    "sweep",
    "synthesize",
    "ula",
    "unit_vectors",
    "ura",
    "white_noise",
]
