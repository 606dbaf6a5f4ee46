"""Folded coordinates: unitary, real for symmetric modes, and no more than another way to compute the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimation import Array, CosinePattern, PathTable, Schedule, SignalModel, comb, cylinder, digital, ura
from estimation.estimators.folding import Folding, Pairs, product, product_right
from estimation.estimators.pool import Pool
from estimation.estimators.projector import Bases, Projector
from estimation.scenarios import hybrid_link, swept_link
from estimation.signal.algebra import project


def noise(shape, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(np.complex64)


LINKS = {
    "odd": SignalModel(comb(28e9, 6.25e6, 33), digital(5, 1e-4), ura(3, 3), cylinder(4, 2)),
    "even": SignalModel(comb(28e9, 6.25e6, 32), digital(12, 1e-4), cylinder(6, 2), ura(2, 4)),
    "lopsided": SignalModel(comb(28e9, 6.25e6, 32), digital(12, 1e-4), cylinder(5, 2), ura(2, 4)),
    "shifted": SignalModel(
        replace(comb(28e9, 6.25e6, 32), frequencies=1e6 + comb(28e9, 6.25e6, 32).frequencies),
        digital(12, 1e-4),
        ura(2, 4, pattern=CosinePattern()),
        Array(ura(2, 2).positions + 0.1),
    ),
    "swept": swept_link(),
    "hybrid": hybrid_link(),
    "combined": SignalModel(
        comb(28e9, 6.25e6, 32),
        Schedule(4e-5 * np.arange(6), None, None, noise((2, 8, 3)), [0, 1] * 3),
        ura(2, 4),
        ura(2, 4),
    ),
}
PATHS = PathTable([40e-9, 90e-9], [[0.3, 0.2], [-0.6, 0.1]], [[0.1, -0.4], [0.8, 0.3]], [5.0, -11.0], [1.0, 0.2j])


@pytest.mark.parametrize("name", LINKS)
def test_planes_are_the_signal_folded_axis_by_axis(name):
    model = LINKS[name]
    folding = Folding.build(model)
    signal = noise(model.shape)
    planes = folding.planes(signal, np.empty(folding.shape, np.float32))
    expected = signal.reshape(folding.shape[1:]).astype(complex)
    for axis, pairs in enumerate(folding.axes):
        expected = np.moveaxis(pairs.fold(np.moveaxis(expected, axis, -1)), -1, axis)
    assert np.allclose(planes[0] + 1j * planes[1], expected, atol=1e-5)
    assert np.vdot(expected, expected).real == pytest.approx(np.vdot(signal, signal).real, rel=1e-5)
    rows = signal.reshape(len(signal), -1)
    assert np.allclose(folding.axes[0].unfold_rows(folding.axes[0].fold(rows.T).T), rows, atol=1e-5)


@pytest.mark.parametrize("name", LINKS)
def test_projections_do_not_notice(name):
    """Windows and planes against inner products with the signal as it is."""
    model = LINKS[name]
    signal = noise(model.shape)
    blocks = model.evaluate(PATHS.geometry)
    exact = project(model, signal, blocks)
    folded = Projector(model, signal, Bases.build(model)).inner(PATHS.geometry, blocks)
    assert np.allclose(folded, exact, atol=2e-4 * np.abs(exact).max(axis=0).clip(1e-12))


def test_symmetric_modes_are_real():
    model = LINKS["even"]
    for pairs, mode in zip(Folding.build(model).axes, model.evaluate(PATHS.geometry)[0], strict=True):
        assert pairs.real and np.allclose(pairs.fold(mode).imag, 0, atol=1e-9 * np.abs(mode).max())
        assert pairs.steering(mode).dtype == np.float32
        assert np.allclose(pairs.steering(mode), pairs.fold(mode), atol=1e-6 * np.abs(mode).max())
    assert not Folding.build(LINKS["lopsided"]).axes[3].real
    assert not Folding.build(LINKS["shifted"]).axes[0].real
    assert Folding.build(LINKS["shifted"]).axes[3].real and not Folding.build(LINKS["shifted"]).axes[2].real
    assert not Pairs.build([[0.5], [1.0]]).real and Pairs.build([[0.0]]).real


def test_products_of_planes():
    left, data, right = noise((3, 4)), noise((5, 4, 6)), noise((7, 6))
    planes = np.stack([data.real, data.imag])
    for matrix, other in ((left, right), (left.real.copy(), right.real.copy())):
        out = product(matrix, planes)
        assert np.allclose(out[0] + 1j * out[1], matrix @ data, atol=1e-5)
        assert np.array_equal(product(matrix, planes, np.empty_like(out)), out)
        out = product_right(planes, other)
        assert np.allclose(out[0] + 1j * out[1], data @ other.T, atol=1e-5)


def test_a_pool_lends_no_array_twice():
    class Owner:
        pass

    pool, one, two = Pool(), Owner(), Owner()
    first, second = pool.lend(one, (3, 4)), pool.lend(two, (3, 4))
    assert first is not second
    del one
    assert pool.lend(two, (3, 4)) is first
    assert pool.lend(two, (3, 4)) is not first
    # A copy in another process or thread starts empty.
    import pickle

    assert pickle.loads(pickle.dumps(pool))._free == {}
