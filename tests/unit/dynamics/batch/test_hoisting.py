"""Hoisting of parameters from a repeated graph gives the same values with fewer operations."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.batch.graphs.hoisting import HoistedFunctions

X, P = ca.SX.sym("x", 2), ca.SX.sym("p", 3)


def split(*results: ca.SX) -> tuple[ca.Function, ca.Function, ca.Function]:
    fn = ca.Function("f", [X, P], list(results))
    hoisted = HoistedFunctions(3)
    hoisted.add({"f": (fn, 1)})
    return fn, hoisted.derived(), hoisted.remaining()["f"]


def operations(fn: ca.Function) -> list[int]:
    leaves = {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST}
    ops = [fn.instruction_id(i) for i in range(fn.n_instructions())]
    return [op for op in ops if op not in leaves]


def agree(fn: ca.Function, derived: ca.Function, rest: ca.Function) -> None:
    rng = np.random.default_rng(0)
    for x, p in zip(rng.standard_normal((20, 2)), rng.uniform(0.5, 2.0, (20, 3)), strict=True):
        for got, wanted in zip(rest.call([x, derived(p)]), fn.call([x, p]), strict=True):
            np.testing.assert_allclose(got, wanted, rtol=1e-14, atol=1e-15)


def test_what_depends_on_parameters_alone_is_not_in_the_rest():
    made = split(X[0] + ca.exp(P[0]) / (1 + P[1] ** 2))
    agree(*made)
    assert operations(made[2]) == [ca.OP_ADD]


def test_a_chain_of_factors_is_one_product():
    made = split(2 * (X[0] * P[0] * ca.sin(P[1]) / P[2]) * 3)
    agree(*made)
    assert operations(made[2]) == [ca.OP_MUL]


def test_what_lies_within_a_chain_is_there_where_others_need_it():
    inner = X[0] * P[0]
    made = split(inner * P[1] + X[1], ca.sin(inner), inner + inner)
    agree(*made)
    assert operations(made[2]).count(ca.OP_MUL) <= 3


def test_functions_added_later_take_more_values_and_change_no_earlier_function():
    hoisted = HoistedFunctions(3)
    first, second = (ca.Function("f", [X, P], [y]) for y in (X[0] * ca.exp(P[0]), X[1] * ca.cos(P[1])))
    hoisted.add({"first": (first, 1)})
    sizes = [hoisted.derived().numel_out(0)]
    agree(first, hoisted.derived(), hoisted.remaining()["first"])
    hoisted.add({"second": (second, 1)})
    sizes.append(hoisted.derived().numel_out(0))
    assert sizes == [1, 2]
    agree(first, hoisted.derived(), hoisted.remaining()["first"])
    agree(second, hoisted.derived(), hoisted.remaining()["second"])
