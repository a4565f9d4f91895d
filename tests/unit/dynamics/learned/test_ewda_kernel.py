"""The C code of the weighted average: it compiles without warnings, and its weights and boxes are right."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest
from mpmath import mp, mpf

from dynamics.batch.arguments import BatchWarning
from dynamics.batch.engines import compiler, kernels
from dynamics.learned.ewda_kernel import NumpyMoments, bounding_boxes, chunk_rows, order_by_neighbours
from dynamics.learned.ewda_source import ewda_source
from tests.unit.dynamics.learned.ewda_reference import model_of

# Exported calls of the kernel's inner functions, for the tests.
_CALLED = """
void weights_of(const double *x, double *w, i64 n) {
  for (i64 i = 0; i + W <= n; i += W) *(VU *)(w + i) = weight(*(const VU *)(x + i));
}
"""


@pytest.mark.costly_cases("gcc -march=x86-64-shape0", "gcc -march=x86-64-v3-shape0", "gcc -march=x86-64-shape2")
@pytest.mark.parametrize("shape", [(11, 7), (1, 1), (7, 5), (2, 6)])
def test_compilers_take_the_source_and_agree_with_numpy(strict, shape):
    nz, ny = shape
    rng = np.random.default_rng(0)
    z, y = rng.standard_normal((1000, nz)), rng.standard_normal((1000, ny))
    ny_named = min(nz, ny)
    c, numpy = (model_of(z, y[:, :ny_named], 0.4, backend=name) for name in ("c", "numpy"))
    at = z[:20] + 0.3 * rng.standard_normal((20, nz))
    weights = rng.standard_normal((20, ny_named + 1))
    np.testing.assert_allclose(c.values(at), numpy.values(at), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(c.jacobians(at)[1], numpy.jacobians(at)[1], rtol=1e-11, atol=1e-11)
    bends = c.curvatures(at, weights)
    np.testing.assert_allclose(bends, numpy.curvatures(at, weights), rtol=1e-10, atol=1e-10)


def test_weights_are_exact_to_two_units_in_the_last_place(strict):
    called = compiler.load_library(ewda_source(2, 1, strict) + _CALLED).weights_of
    rng = np.random.default_rng(0)
    x = np.concatenate((-(10.0 ** rng.uniform(-12, 2.8, 4000)), -rng.uniform(0, 60, 4000)))
    edges = [0.0, -0.0, 1e-300, -0.34657359027997264, -699.9, -700.1, -1e5, -np.inf]
    x = np.append(x[x > -700], edges)
    x = np.append(x, np.zeros(-len(x) % strict.width))
    w = np.empty_like(x)
    called.restype = None
    pointers = (ctypes.c_void_p(array.ctypes.data) for array in (x, w))
    called(*pointers, ctypes.c_int64(len(x)))
    with mp.workdps(30):
        exact = [mp.exp(mpf(float(each))) if each > -700 else mpf(0) for each in x]
        error = [float(abs(mpf(float(a)) - b)) for a, b in zip(w, exact, strict=True)]
    assert (np.array(error) <= 2 * np.spacing(np.array([float(b) for b in exact]))).all()
    assert (w[x < -700] == 0).all()


def test_without_a_compiler_numpy_answers(monkeypatch):
    rng = np.random.default_rng(0)
    z, y = rng.standard_normal((50, 3)), rng.standard_normal((50, 2))
    monkeypatch.setattr(compiler, "CANDIDATES", ())
    monkeypatch.setattr(kernels, "_reported_reasons", set())
    model = model_of(z, y, 0.3)
    with pytest.warns(BatchWarning, match="runs on the numpy backend"):
        assert isinstance(model._engine, NumpyMoments)
    with pytest.raises(compiler.CompilerError, match="no C compiler found"):
        model_of(z, y, 0.3, backend="c").values(z)


@pytest.mark.parametrize("n", [1, 7, 8, 9, 100, 1003])
def test_chunks_hold_near_neighbours_each_once(n):
    points = np.random.default_rng(n).standard_normal((n, 3))
    order = order_by_neighbours(points, 8, 2)
    assert sorted(order) == list(range(n))
    rows, count = points[order], -(-n // 8)
    low, high = bounding_boxes(rows, 8, count + 2)
    kept = chunk_rows(rows, 8, 1e9)
    assert kept.shape == (count, 3, 8)
    for c in range(count):
        inside = rows[8 * c : 8 * c + 8]
        assert np.array_equal(kept[c, :, : len(inside)].T, inside)
        assert (kept[c, :, len(inside) :] == 1e9).all()
        assert np.array_equal(low[:, c], inside.min(axis=0))
        assert np.array_equal(high[:, c], inside.max(axis=0))
    assert np.array_equal(low[:, count], low[:, count - 1])
    if n > 1000:

        def extent(of: np.ndarray, chunk: int) -> float:
            low, high = bounding_boxes(points[of], chunk, -(-n // chunk))
            return float((high - low).mean())

        # 126 leaves in three dimensions: each is halved twice and more, and again down to pairs.
        assert extent(order, 8) < 0.5 * extent(np.arange(n), 8)
        alone = order_by_neighbours(points, 8, 8)
        assert extent(order, 2) < 0.9 * extent(alone, 2)
        assert {*map(frozenset, order[:1000].reshape(-1, 8))} == {*map(frozenset, alone[:1000].reshape(-1, 8))}
