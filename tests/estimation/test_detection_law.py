"""Whether a lone path is found follows the detection law, whichever way the delays are searched."""

import numpy as np
import pytest

from estimation import (
    Nomp,
    PathTable,
    Schedule,
    SignalModel,
    Waveform,
    comb,
    detection_probability,
    digital,
    random_phase_beams,
    staggered,
    sweep,
    ura,
)
from estimation import synthesize as received
from estimation.evaluate import differences
from estimation.scenarios import Draw, at_snr, draw_paths
from estimation.signal.nr import PRS


def link(kind: str) -> SignalModel:
    """Links of every search: digital, swept, with combiners and with both; delays by matrix or transform."""
    rng = np.random.default_rng(5)
    if kind == "digital, matrix":
        return SignalModel(comb(28e9, 6.25e6, 64), digital(8, 125e-6), ura(4, 4), ura(2, 4))
    if kind == "digital, transform":
        return SignalModel(comb(28e9, 3e6, 128), digital(8, 125e-6), ura(4, 4), ura(2, 4))
    if kind == "digital, no windows":
        return SignalModel(comb(28e9, 6.25e6, 20), digital(10, 125e-6), ura(4, 4), ura(2, 4))
    way = kind.split(", ")[1]
    pilots = {"no windows": 20, "matrix": 64, "transform": 200, "staggered": 40, "uneven": 64}[way]
    square = np.linalg.qr(rng.standard_normal((8, 8)) + 1j * rng.standard_normal((8, 8)))[0]
    combiners = np.moveaxis(square.reshape(8, 2, 4), 1, 0)
    waveform, stagger = comb(28e9, 400e6 / pilots, pilots), None
    if way == "staggered":
        waveform, stagger = comb(28e9, 2.5e6, pilots, 4), staggered(2.5e6, 4, PRS[4])
    elif way == "uneven":
        tones = np.sort(rng.choice(2 * pilots, pilots, replace=False)) * 400e6 / (2 * pilots)
        waveform = Waveform(28e9, tones - tones.mean())
    sweeps = 1 if way == "staggered" else 4
    if kind.startswith("combined"):
        once = sweep(np.ones((1, 1)), sweeps + 2, 40e-6, order="linear", combiners=combiners, stagger=stagger)
        schedule = Schedule(once.times, None, None, once.combiners, once.combiner_index, once.offsets)
    elif kind.startswith("hybrid"):
        schedule = sweep(random_phase_beams(16, 16, rng), sweeps, 20e-6, combiners=combiners, rng=rng, stagger=stagger)
    else:
        schedule = sweep(random_phase_beams(16, 16, rng), 2 * sweeps, 35.68e-6, rng=rng, stagger=stagger)
    return SignalModel(waveform, schedule, ura(4, 4), ura(2, 4))


KINDS = (
    "digital, matrix",
    "digital, transform",
    "digital, no windows",
    "swept, matrix",
    "swept, transform",
    "swept, no windows",
    "hybrid, matrix",
    "hybrid, transform",
    "combined, matrix",
    "combined, transform",
    "swept, staggered",
    "hybrid, staggered",
    "combined, staggered",
    "swept, uneven",
    "combined, uneven",
)


def shares(kind: str, decibel: float, count: int) -> tuple[float, float]:
    """Share of found paths and the law's, over ``count`` snapshots with one path each."""
    model = link(kind)
    estimator = Nomp(model, max_paths=3, max_speed=25.0)
    found, law = 0, 0.0
    for seed in range(count):
        rng = np.random.default_rng((seed, round(10 * decibel)))
        drawn = draw_paths(model, rng, Draw(paths=1, delays=(20e-9, min(0.9 * model.max_delay, 390e-9))))
        path = at_snr(
            model,
            PathTable(drawn.delay, drawn.aoa, drawn.aod, drawn.radial_velocity, drawn.gain),
            [10 ** (decibel / 10)],
        )
        got = estimator.run(received(model, path, 1.0, rng), noise_variance=1.0)
        near = np.abs(differences(got.vector, path.vector, model.max_delay)[:, 0]) < 2 / model.waveform.bandwidth
        found += bool(near.any())
        law += float(detection_probability(10 ** (decibel / 10), estimator.threshold))
    return found / count, law / count


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("decibel", [20.0])
def test_a_strong_lone_path_is_always_found(kind, decibel):
    found, law = shares(kind, decibel, 6)
    assert law > 0.995 and found == 1.0


@pytest.mark.mc
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("decibel", [14.0, 15.0, 17.0, 20.0, 25.0])
def test_weak_paths_follow_the_law(kind, decibel):
    count = 150
    found, law = shares(kind, decibel, count)
    assert found > law - 0.02 - 2.6 * np.sqrt(max(law * (1 - law), 0.01) / count)
