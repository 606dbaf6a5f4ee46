"""The search of digital links: its spectrum, and what it makes of cells that a path falls between."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimation import SignalModel, comb, cylinder, digital, synthesize, ura
from estimation.estimators.cells import Cells
from estimation.estimators.dense import DenseSearch
from estimation.estimators.detect import fitted_excess
from estimation.estimators.grids import cover
from estimation.estimators.kernels import scan, screen
from estimation.estimators.projector import Projector
from estimation.estimators.refine import joint_fit
from estimation.estimators.report import unbiased
from estimation.scenarios import FRONT, Draw, at_snr, draw_paths
from estimation.signal.algebra import gram_diagonal, project
from estimation.signal.noise import white_noise


@pytest.fixture(scope="module")
def link() -> SignalModel:
    """32 k samples."""
    return SignalModel(comb(28e9, 12.5e6, 32), digital(16, 125e-6), ura(2, 4), ura(2, 4))


@pytest.fixture(scope="module")
def search(link) -> DenseSearch:
    """Its dictionaries."""
    return DenseSearch.build(link, link.waveform.max_delay, 25.0, FRONT, FRONT)


def test_spectrum_is_the_product_of_all_dictionaries(link, search):
    rng = np.random.default_rng(0)
    signal = white_noise(link.shape, 1.0, rng)
    delay, speed, arrival, departure = (c.vectors.conj() for c in search.cells)
    expected = np.einsum("lk,vn,ar,dt,knrt->lvad", delay, speed, arrival, departure, signal, optimize=True)
    real, imag = search.filtered(Projector(link, signal, None)).matched.cells
    assert np.allclose(real + 1j * imag, expected, atol=1e-4)


def rest_of(spectrum) -> np.ndarray:
    """The spectrum less its known paths, in full."""
    real, imag = spectrum.matched.cells
    return real + 1j * imag - np.einsum("pl,pv,pa,pd->lvad", *spectrum.known, optimize=True)


def test_paths_leave_the_spectrum(link, search):
    rng = np.random.default_rng(1)
    paths = at_snr(link, draw_paths(link, rng, Draw(paths=3)), [1e4, 1e3, 100.0])
    spectrum = search.filtered(Projector(link, synthesize(link, paths), None))
    before = np.abs(rest_of(spectrum)).max()
    rest = search.without(spectrum, link.evaluate(paths.geometry), paths.gain)
    assert np.abs(rest_of(rest)).max() < 1e-5 * before
    assert np.abs(rest_of(spectrum)).max() == before


@pytest.mark.parametrize("trifle", [0.0, 1e-3])
def test_high_cells_of_what_paths_leave(link, search, trifle):
    """The compiled scan and screen against the spectrum written out."""
    rng = np.random.default_rng(7)
    paths = at_snr(link, draw_paths(link, rng, Draw(paths=3)), [1e4, 1e3, 100.0])
    signal = synthesize(link, paths, 1.0, rng)
    spectrum = search.without(search.filtered(Projector(link, signal, None)), link.evaluate(paths.geometry), paths.gain)
    rest = rest_of(spectrum)
    first, *middle, departure = spectrum.known
    index, power = np.empty(20_000, np.int64), np.empty(20_000, np.float32)
    rows = np.stack([departure.real, departure.imag])
    limits = (trifle / np.max(np.abs(departure) ** 2, axis=1)).astype(np.float32)
    equal = np.ones(len(rest), np.float32)
    floor, share = np.float32(4.0), np.float32(0.0)
    count, least = scan(spectrum.matched.cells, first, *middle, rows, limits, equal, floor, share, index, power)
    assert least == floor
    expected = np.flatnonzero(np.abs(rest.ravel()) ** 2 > floor)
    assert len(np.setxor1d(index[:count], expected)) <= 0.02 * count
    assert np.allclose(power[:count], np.abs(rest.ravel()[index[:count]]) ** 2, atol=0.3 if trifle else 1e-2)
    high = np.stack(np.unravel_index(index[:20], rest.shape))
    energy, best = np.empty(20, np.float32), np.empty((4, 20), np.int64)
    tables = [table for c in search.cells for table in (c.neighbors, c.shifts)]
    known = [np.stack([f.T.real, f.T.imag]) for f in spectrum.known]
    screen(spectrum.matched.cells, *known, high, *tables, energy, best)
    for h, cell in enumerate(high.T):
        gain = 1.0
        for axis, table in enumerate(search.cells):
            at = [np.full(table.neighbors.shape[1], c) for c in cell]
            at[axis] = table.neighbors[cell[axis]]
            points = np.abs(table.shifts[cell[axis]] @ rest[tuple(at)]) ** 2
            assert points[best[axis, h]] == pytest.approx(points.max(), rel=1e-3)
            gain *= points.max() / np.abs(rest[tuple(cell)]) ** 2
        assert energy[h] == pytest.approx(gain * np.abs(rest[tuple(cell)]) ** 2, rel=1e-2)


def test_arrays_without_symmetry_give_the_same_spectrum(link):
    """Five columns have no center of symmetry; a long comb is transformed instead of multiplied."""
    for model in (
        replace(link, transmitter=cylinder(5, 2)),
        replace(link, waveform=comb(28e9, 1e6, 160), schedule=digital(3, 125e-6)),
    ):
        search = DenseSearch.build(model, 0.5 * model.waveform.max_delay, 25.0, FRONT, FRONT)
        signal = white_noise(model.shape, 1.0, np.random.default_rng(8))
        delay, speed, arrival, departure = (c.vectors.conj() for c in search.cells)
        expected = np.einsum("lk,vn,ar,dt,knrt->lvad", delay, speed, arrival, departure, signal, optimize=True)
        real, imag = search.filtered(Projector(model, signal, None)).matched.cells
        # The transform starts its pilots at zero: a phase per delay.
        assert np.allclose(np.hypot(real, imag), np.abs(expected), atol=1e-3)


def test_candidates_stand_near_the_peak_wherever_it_lies(link, search):
    """A coarse cell keeps 0.4 of a path's energy on average and a tenth at worst; its neighborhood nearly all."""
    rng = np.random.default_rng(2)
    kept, grid = [], []
    for _ in range(40):
        path = at_snr(link, draw_paths(link, rng, Draw(paths=1)), [1e4])
        signal = synthesize(link, path)
        spectrum = search.filtered(Projector(link, signal, None))
        best = search.candidates(spectrum, search.full, 1.0).take([0])
        blocks = link.evaluate(best)
        norm = gram_diagonal(link, blocks)[0, 0, 0].real
        kept.append(np.abs(project(link, signal, blocks)[0, 0]) ** 2 / norm / 1e4)
        grid.append(np.abs(rest_of(spectrum)).max() ** 2 / 1e4)
    assert np.mean(kept) > 0.8 and np.min(kept) > 0.45
    assert np.mean(kept) > np.mean(grid) + 0.15


def test_neighbors_give_what_lies_between():
    times = np.arange(32) - 15.5
    grid = np.arange(0, 32, 0.8)
    vectors = np.exp(2j * np.pi * np.outer(grid, times) / 32)
    between = np.exp(2j * np.pi * np.outer(grid + 0.4, times) / 32)
    cells = Cells.build(vectors, between[:, None], 8)
    rng = np.random.default_rng(3)
    data = rng.standard_normal(32) + 1j * rng.standard_normal(32)
    matched = cells.vectors.conj() @ data
    inside = np.arange(8, 30)
    guess = np.einsum("cn,cn->c", cells.shifts[inside, 0], matched[cells.neighbors[inside]])
    exact = between[inside].conj() @ data / np.sqrt(32)
    assert np.abs(guess - exact).max() < 0.1 * np.linalg.norm(data) / np.sqrt(32) * 2


@pytest.mark.parametrize("retained", [0.4, 0.7])
def test_cover_covers_with_whole_registers(retained):
    rng = np.random.default_rng(4)
    cosines = rng.uniform(-0.9, 0.9, (900, 2))
    place = np.stack(np.meshgrid(np.arange(6), np.arange(6)), axis=-1).reshape(-1, 2)
    vectors = np.exp(1j * np.pi * cosines @ place.T)
    chosen = cover(vectors, retained)
    kept = np.max(np.abs(vectors @ vectors[chosen].conj().T) ** 2, axis=1) / 36**2
    assert kept.min() >= retained - 1e-6
    assert len(set(chosen)) == len(chosen) and len(chosen) % 24 == 0


def test_covariances_leave_the_noise_out_of_the_energy(link):
    """A fitted path's statistic is rho + 1 + p/2 on average: at rho = 30 information would be 13 % too large."""
    rng = np.random.default_rng(5)
    ratio, plain = [], []
    for _ in range(60):
        path = at_snr(link, draw_paths(link, rng, Draw(paths=1)), [30.0])
        data = Projector(link, synthesize(link, path, 1.0, rng), None)
        lin = joint_fit(data, path.geometry, 1.0, 1e-3)
        plain.append(lin.drop[0] / 30.0)
        energy = np.abs(unbiased(lin, lin.drop, 1.0, link.active).gain[0]) ** 2
        ratio.append(energy * lin.gram[0, 0, 0, 0].real / 30.0)
    # The standard error of a mean over 60 is 0.05.
    assert np.mean(plain) > 1.06
    assert abs(np.mean(ratio) - 1) < 0.15


def test_detected_paths_are_not_stronger_than_they_are():
    """The mean excess of detected statistics against draws from the law; correcting for it leaves no bias."""
    rng = np.random.default_rng(6)
    for rho in (20.0, 28.0, 45.0, 300.0):
        statistic = 0.5 * rng.noncentral_chisquare(8, 2 * rho, 40_000)
        detected = statistic[statistic > 26]
        excess = fitted_excess(rho, 26.0, 6)
        assert abs(detected.mean() - rho - excess) < 5 * detected.std() / np.sqrt(len(detected))
        corrected = detected - fitted_excess(np.maximum(detected - 4, 1.0), 26.0, 6)
        assert rho < 25 or abs(corrected.mean() / rho - 1) < 0.06
