"""Batched functions: shapes, names, reproducible bits, and messages on bad input."""

from __future__ import annotations

import warnings

import casadi as ca
import numpy as np
import pytest

from dynamics.batch import BatchFunction, BatchWarning
from dynamics.contact.affine_step import lcp_solver
from tests.unit.dynamics.batch.backends import BACKENDS, FAST


@pytest.fixture(scope="module")
def graph() -> ca.Function:
    x, p = ca.SX.sym("x", 11), ca.SX.sym("p", 2)
    y = ca.vertcat(ca.sin(x) * p[0], ca.sum1(x) ** 2, ca.if_else(x[0] > p[1], x[1], x[2]))
    return ca.Function("graph", [x, p], [y, ca.dot(x, x)], ["x", "p"], ["y", "norm"])


@pytest.fixture(scope="module")
def samples() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    return rng.standard_normal((1003, 11)), rng.standard_normal((1003, 2))


@pytest.mark.parametrize("backend", BACKENDS)
def test_agrees_with_one_call_for_each_sample(backend, graph, samples):
    y, norm = BatchFunction(graph, backend=backend)(*samples)
    assert y.shape == (1003, 13)
    assert norm.shape == (1003, 1)
    for i in (0, 7, 500, 1002):
        wanted = graph(samples[0][i], samples[1][i])
        np.testing.assert_allclose(y[i], np.array(wanted[0])[:, 0], rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(norm[i], float(wanted[1]), rtol=1e-12)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("n", [0, 1, 2, 7, 8, 9, 64, 65])
def test_any_number_of_samples(backend, n, graph, samples):
    f = BatchFunction(graph, backend=backend)
    x, p = samples
    y, _ = f(x[:n], p[0])
    whole, _ = f(x, p[0])
    np.testing.assert_array_equal(y, whole[:n])


@pytest.mark.parametrize("backend", BACKENDS)
def test_shared_inputs_broadcast(backend, graph, samples):
    f = BatchFunction(graph, backend=backend)
    x, p = samples
    np.testing.assert_array_equal(f(x, p[0])[0], f(x, np.tile(p[0], (len(x), 1)))[0])
    assert f(x[0], p[0])[0].shape == (1, 13)


def test_names_and_positions_give_the_same(graph, samples):
    f = BatchFunction(graph)
    named = f(p=samples[1], x=samples[0])
    assert list(named) == ["y", "norm"]
    np.testing.assert_array_equal(named["y"], f(*samples)[0])


@pytest.mark.parametrize("backend", FAST)
def test_threads_and_blocks_do_not_change_a_bit(backend, graph):
    rng = np.random.default_rng(2)
    x, p = rng.standard_normal((5001, 11)), rng.standard_normal((5001, 2))
    answers = [
        BatchFunction(graph, backend=backend, threads=threads, block=block)(x, p)
        for threads in (1, 2)
        for block in (8, 64)
    ]
    for answer in answers[1:]:
        for one, other in zip(answers[0], answer, strict=True):
            np.testing.assert_array_equal(one, other)


@pytest.mark.costly
def test_long_graphs_are_cut_and_agree():
    x = ca.SX.sym("x", 4)
    y, kept = x, []
    for k in range(240):
        y = ca.sin(ca.vertcat(y[1:], y[0])) + 0.3 * y * ca.cos(x) + ca.if_else(x > k / 100, y, -x)
        if k % 40 == 0:
            kept.append(y)
    f = ca.Function("long", [x], [y, ca.vertcat(*kept)])
    assert f.n_instructions() > 2000
    at = np.random.default_rng(3).standard_normal((50, 4))
    wanted, got = BatchFunction(f, backend="numpy")(at), BatchFunction(f, backend="c")(at)
    # The map is chaotic: early values agree to rounding, late ones only with themselves.
    np.testing.assert_allclose(got[1][:, :4], wanted[1][:, :4], rtol=1e-12)
    np.testing.assert_array_equal(got[0], BatchFunction(f, backend="c", threads=2)(at)[0])


@pytest.mark.parametrize("backend", FAST)
def test_inputs_larger_than_a_stack(backend):
    x = ca.SX.sym("x", 100_000)
    f = BatchFunction(ca.Function("wide", [x], [x[0] + 2 * x[99_999]]), backend=backend)
    at = np.random.default_rng(5).standard_normal((17, 100_000))
    np.testing.assert_allclose(f(at)[:, 0], at[:, 0] + 2 * at[:, -1], rtol=1e-15)


def test_sparse_inputs_and_outputs_are_rows_of_nonzeros():
    A = ca.SX.sym("A", ca.Sparsity.lower(3))
    f = ca.Function("f", [A], [A @ A, ca.SX(2, 2)])
    rows = np.random.default_rng(4).standard_normal((20, 6))
    answers = [BatchFunction(f, backend=backend)(rows) for backend in BACKENDS]
    assert answers[0][0].shape == (20, 6)
    assert answers[0][1].shape == (20, 0)
    for answer in answers:
        np.testing.assert_allclose(answer[0], answers[-1][0], rtol=1e-13)


@pytest.mark.parametrize("backend", BACKENDS)
def test_non_finite_samples_are_counted_and_named(backend, graph, samples):
    x, p = samples[0].copy(), samples[1]
    x[17, 3], x[400, 0], x[1002, 1] = np.nan, np.inf, np.nan
    f = BatchFunction(graph, backend=backend)
    with pytest.warns(BatchWarning, match="3 non-finite samples, at index 17, 400, 1002"):
        f(x, p)
    assert f.nonfinite.count == 3
    np.testing.assert_array_equal(f.nonfinite.indices, [17, 400, 1002])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        f(*samples)
    assert not f.nonfinite


def test_out_arrays_are_written_to(graph, samples):
    f = BatchFunction(graph)
    out = [np.empty((1003, 13)), np.empty((1003, 1))]
    y, norm = f(*samples, out=out)
    assert y is out[0]
    assert norm is out[1]
    with pytest.raises(ValueError, match=r"C-contiguous float64 array of shape \(1003, 13\)"):
        f(*samples, out=[np.empty((1003, 12)), norm])
    with pytest.raises(ValueError, match=r"2 outputs.*holds 1 arrays"):
        f(*samples, out=[y])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.zeros((5, 10)), np.zeros(2)), r"'x' of 'graph' has 10 along axis 1, expected 11"),
        ((np.zeros(10), np.zeros(2)), r"'x' of 'graph' has 10 along axis 0, expected 11"),
        ((np.zeros((11, 5)), np.zeros(2)), "samples come first, so transpose it"),
        ((np.zeros((2, 5, 11)), np.zeros(2)), "has 3 axes; expected"),
        ((np.zeros((5, 11)), np.zeros((4, 2))), r"disagree along axis 0.*'x' has 5, 'p' has 4"),
        ((np.zeros((5, 11), dtype=complex), np.zeros(2)), "must hold real numbers, not complex"),
        ((np.full((5, 11), "a"), np.zeros(2)), "must hold real numbers"),
    ],
)
def test_wrong_shapes_say_which_axis_and_what_was_expected(arguments, message, graph):
    with pytest.raises(ValueError, match=message):
        BatchFunction(graph, backend="numpy")(*arguments)


def test_one_value_a_sample_must_be_a_column():
    x = ca.SX.sym("x")
    f = BatchFunction(ca.Function("f", [x], [x]), backend="numpy")
    with pytest.raises(ValueError, match=r"write a\[:, None\] for one value a sample"):
        f(np.zeros(5))
    assert f(3.0).shape == (1, 1)


def test_wrong_names_and_counts_are_listed(graph, samples):
    f = BatchFunction(graph, backend="numpy")
    with pytest.raises(TypeError, match="has inputs x, p; unknown: q; missing: p"):
        f(x=samples[0], q=samples[1])
    with pytest.raises(TypeError, match=r"takes 2 inputs \(x, p\), but 1 were given"):
        f(samples[0])
    with pytest.raises(TypeError, match="by position or by name, not both"):
        f(samples[0], p=samples[1])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"threads": 0}, "threads must be a whole number >= 1, got 0"),
        ({"threads": 1.5}, "threads must be"),
        ({"block": 0}, "block must be a whole number >= 1, got 0"),
        ({"backend": "fortran"}, "unknown backend 'fortran'.*choose one of auto, c, numpy,"),
    ],
)
def test_wrong_options_are_explained(options, message, graph):
    with pytest.raises(ValueError, match=message):
        BatchFunction(graph, **options)


@pytest.mark.costly
def test_auto_interprets_what_compilers_choke_on():
    """A path solver of two contacts unrolls to over 1e5 operations, which take minutes to compile."""
    F, mu = np.array([[2.0, 0.5], [0.3, 1.0]]), np.array([1e-3, 1e-3])
    solver = lcp_solver(2)
    batch = BatchFunction(solver)
    assert batch.backend == "numpy"
    z = np.random.default_rng(0).normal(size=(8, 2))
    lam, gap, error = batch(z, F.T.ravel(), mu)
    np.testing.assert_allclose(lam * gap, 1e-3, rtol=1e-8)
    np.testing.assert_allclose(z + lam @ F.T, gap, atol=1e-10)
    assert error.max() <= 1e-10
