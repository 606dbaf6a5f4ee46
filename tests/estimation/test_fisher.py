"""Fisher information: closed forms of an isolated path, and numerical differentiation of the whole
likelihood.
"""

from __future__ import annotations

import numpy as np
import pytest

from estimation import (
    SPEED_OF_LIGHT,
    CosinePattern,
    Detections,
    EstimationError,
    PathTable,
    SignalModel,
    comb,
    crb,
    cylinder,
    digital,
    fisher_information,
    random_phase_beams,
    snr,
    sweep,
    ula,
    ura,
)
from estimation.evaluate import associate


def test_isolated_path_has_the_textbook_bounds():
    model = SignalModel(comb(28e9, 6.25e6, 64), digital(16, 125e-6), ura(8, 8), ura(4, 4))
    path = PathTable([80e-9], [[0.0, 0.0]], [[0.0, 0.0]], [5.0], [0.1])
    variance = 3.0
    rho = snr(model, path, variance)[0]
    assert rho == pytest.approx(0.01 * np.prod(model.shape) / variance)
    std = np.sqrt(np.diag(crb(model, path, variance)[0]))
    beta = np.sqrt(np.mean(model.waveform.frequencies**2))
    assert std[0] == pytest.approx(1 / (np.sqrt(8 * np.pi**2) * beta * np.sqrt(rho)), rel=1e-9)
    rms_time = 125e-6 * np.sqrt((16**2 - 1) / 12)
    assert std[5] == pytest.approx(
        model.waveform.wavelength / (np.sqrt(8 * np.pi**2) * rms_time * np.sqrt(rho)), rel=1e-9
    )
    for column, array in ((1, model.receiver), (3, model.transmitter)):
        for offset, axis in ((0, 1), (1, 2)):
            aperture = np.sqrt(np.mean(array.positions[:, axis] ** 2))
            assert std[column + offset] == pytest.approx(
                1 / (np.sqrt(8 * np.pi**2) * aperture * np.sqrt(rho)), rel=1e-9
            )


def test_information_is_the_curvature_of_the_likelihood(model, paths):
    """Schur complement over numerically differentiated signatures and gains, in dense linear algebra."""
    from estimation import synthesize

    scale = np.array([1e-12, 1e-5, 1e-5, 1e-5, 1e-5, 1e-3])

    def signal(step, gain):
        moved = paths.geometry.moved(step)
        # Double precision: path by path through the mode vectors, whose correctness other tests pin.
        total = 0
        for band, modes in zip(model.bands, model.evaluate(moved), strict=True):
            product = modes[0][:, 0]
            for mode in modes[1:]:
                product = (product[:, :, None] * mode[:, 0][:, None]).reshape(len(gain), -1)
            total = np.append(total, gain @ product) if band is not model.bands[0] else gain @ product
        return total

    count = len(paths)
    columns = []
    for p in range(count):
        for a in range(6):
            step = np.zeros((count, 6))
            step[p, a] = scale[a]
            columns.append((signal(step, paths.gain) - signal(-step, paths.gain)) / (2 * scale[a]))
    zero = np.zeros((count, 6))
    for p in range(count):
        unit = np.zeros(count, complex)
        unit[p] = 1.0
        columns += [signal(zero, unit), 1j * signal(zero, unit)]
    jacobian = np.array(columns).T
    norm = np.linalg.norm(jacobian, axis=0)
    full = 2 / 0.5 * np.real((jacobian / norm).conj().T @ (jacobian / norm))
    nuisance = 6 * count
    schur = full[:nuisance, :nuisance] - full[:nuisance, nuisance:] @ np.linalg.solve(
        full[nuisance:, nuisance:], full[nuisance:, :nuisance]
    )
    got = fisher_information(model, paths, 0.5) / np.outer(norm[:nuisance], norm[:nuisance])
    assert np.abs(got - schur).max() < 1e-5 * np.abs(schur).max()
    assert synthesize(model, paths).shape == model.shape


def test_a_linear_array_leaves_elevation_unobserved():
    model = SignalModel(comb(28e9, 6.25e6, 16), digital(4, 125e-6), ula(4), ula(4))
    path = PathTable([80e-9], [[0.2, 0.0]], [[0.1, 0.0]], [5.0], [0.1])
    assert model.active.tolist() == [True, True, False, True, False, True]
    bound = crb(model, path, 1.0)[0]
    assert np.isinf(bound[2, 2]) and np.isinf(bound[4, 4])
    assert np.isfinite(bound[np.ix_([0, 1, 3, 5], [0, 1, 3, 5])]).all()


def test_delay_bound_in_meters_at_400_megahertz():
    model = SignalModel(comb(28e9, 6.25e6, 64), digital(16, 125e-6), ura(8, 8), ura(4, 4))
    path = PathTable([80e-9], [[0.0, 0.0]], [[0.0, 0.0]], [5.0], [np.sqrt(1e3 / np.prod(model.shape))])
    # 30 dB: 0.39 bins / sqrt(rho) = 0.92 cm (trial figure 0.92 cm).
    assert SPEED_OF_LIGHT * np.sqrt(crb(model, path, 1.0)[0, 0, 0]) == pytest.approx(0.0092, rel=0.02)


def test_bad_variance_is_named(model, paths):
    with pytest.raises(EstimationError, match="positive"):
        crb(model, paths, 0.0)


def test_paths_that_tell_nothing_are_matched_with_nothing():
    """Behind a panel of cosine elements; even where most paths are, the others are found again."""
    rng = np.random.default_rng(4)
    panel = ura(2, 4, pattern=CosinePattern())
    model = SignalModel(
        comb(28e9, 120e3, 60, 8), sweep(random_phase_beams(8, 8, rng), 4, 4e-5, rng=rng), panel, cylinder(8, 2)
    )
    aod = np.array([[0.2, 0.1], [3.0, 0.1], [2.8, -0.2], [-0.4, 0.3], [3.1, 0.0]])  # three of five behind
    paths = PathTable(
        delay=np.array([0.2, 0.3, 0.4, 0.5, 0.6]) * 1e-6, aoa=[[0.1 * i, 0.2] for i in range(5)], aod=aod,
        radial_velocity=np.arange(5.0), gain=np.ones(5),
    )  # fmt: skip
    ahead = [0, 3]
    chosen = {n: getattr(paths, n)[ahead] for n in ("delay", "aoa", "aod", "radial_velocity", "gain")}
    seen = Detections.of(PathTable(**chosen), crb(model, paths, 1.0)[ahead], snr=snr(model, paths, 1.0)[ahead])
    match = associate(model, seen, paths, 1.0)
    assert sorted(match.truth.tolist()) == ahead and match.false == 0
    assert match.detected.tolist() == [True, False, False, True, False]
