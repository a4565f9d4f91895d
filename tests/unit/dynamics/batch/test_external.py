"""C code of a long CasADi function, split into many short functions, returns the same numbers."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.batch.engines import c_source
from dynamics.batch.engines.c_external import external_source
from dynamics.batch.engines.compiler import load_library


def long_function(rounds: int) -> ca.Function:
    """Return a function that transforms a vector ``rounds`` times, with a maximum and a condition each time."""
    x, p = ca.SX.sym("x", 6), ca.SX.sym("p", 2)
    value = x
    for k in range(rounds):
        value = ca.sin(value + p[0]) * x[k % 6] + ca.fmax(value, p[1]) / (2 + value**2)
        value = ca.if_else(value > 0.5, value - 0.5, ca.vertcat(value[1:], value[0]))
    return ca.Function("turned", [x, p], [value, ca.sumsqr(value)])


def test_a_long_function_is_cut_and_gives_the_same() -> None:
    f = long_function(40)
    assert f.n_instructions() > c_source.WHOLE
    text = external_source(f)
    assert text.count("kernel_part") > 3
    g = ca.external("turned", load_library(text)._name)
    assert [g.size_in(k) for k in range(2)] == [(6, 1), (2, 1)]
    rng = np.random.default_rng(0)
    for _ in range(20):
        x, p = rng.standard_normal(6), rng.standard_normal(2)
        for one, two in zip(f(x, p), g(x, p), strict=True):
            assert np.array_equal(np.array(one), np.array(two))


def test_outputs_that_nobody_asks_and_inputs_that_are_zero() -> None:
    f = long_function(30)
    g = ca.external("turned", load_library(external_source(f))._name)
    x = ca.MX.sym("x", 6)
    alone = [ca.Function("alone", [x], [each(x, ca.MX(2, 1))[1]]) for each in (f, g)]
    at = np.linspace(-1, 1, 6)
    assert float(alone[0](at)) == float(alone[1](at))


def test_a_short_function_is_as_casadi_writes_it() -> None:
    f = long_function(2)
    generator = ca.CodeGenerator("turned")
    generator.add(f)
    assert external_source(f) == generator.dump()
