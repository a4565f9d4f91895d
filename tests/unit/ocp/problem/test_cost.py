"""The constant part of a cost, which no plan can change."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from dynamics.systems import Parameter, ParameterTable, signals, time_stepping
from ocp import Solution, solve
from ocp.problem.cost_sizes import split_constant
from ocp.problem.problem import Problem, Scaling

X, P = ca.SX.sym("x", 2), ca.SX.sym("p", 2)
x, y, p, r = X[0], X[1], P[0], P[1]
SPLIT = {
    "sum": (x**2 + 3, 3),
    "difference": (5 - x**2, 5),
    "subtracted": (x**2 - p, -p),
    "negative": (-(x**2 + p), -p),
    "twice": ((x + 1) + (x + 1), 2),
    "factor": (p * (x * y + r), p * r),
    "factor on the right": ((x * y + r) * p, p * r),
    "quotient": ((x**2 + p) / r, p / r),
    "nested": (2 * (3 + p * (4 - (x - r))) + y, 2 * (3 + p * (4 + r))),
    "among others": (x + (1 + (y + (2 + x * y))), 3),
    "of parameters alone": (p**2 + ca.sin(r), p**2 + ca.sin(r)),
}
WHOLE = {
    "square": (x + 1) ** 2,
    "product": (x + 1) * (y + 1),
    "denominator": 1 / (x**2 + 1),
    "exponential": ca.exp(x + 1),
    "branch": ca.if_else(x > 0, x + 1, 1),
    "no constant": p * x + y,
}


def values(expression: ca.SX, count: int = 20) -> np.ndarray:
    points = np.random.default_rng(3).uniform(0.5, 2.0, (4, count))
    function = ca.Function("f", [X, P], [ca.SX(expression)])
    return np.array(function(points[:2], points[2:])).ravel()


@pytest.mark.parametrize("form", SPLIT)
def test_rest_and_constant_add_up_and_the_constant_is_all_there_is(form: str) -> None:
    cost, known = SPLIT[form]
    rest, constant = split_constant(cost, X)
    assert not ca.depends_on(constant, X)
    np.testing.assert_allclose(values(rest + constant), values(cost), rtol=1e-13)
    np.testing.assert_allclose(values(constant), values(known), rtol=1e-13)
    # The rest has no constant.
    assert split_constant(rest, X)[1].is_zero()


@pytest.mark.parametrize("form", WHOLE)
def test_a_cost_without_a_constant_term_is_the_same_object(form: str) -> None:
    rest, constant = split_constant(WHOLE[form], X)
    assert rest is WHOLE[form]
    assert constant.is_zero()


def test_a_sum_over_more_terms_than_are_searched_is_still_the_cost() -> None:
    cost = x**2
    for k in range(500):
        cost = cost + (k % 3) * y
    cost = cost + 7
    rest, constant = split_constant(cost, X)
    np.testing.assert_allclose(values(rest + constant), values(cost), rtol=1e-12)
    np.testing.assert_allclose(values(constant), 7)


def wagon(offset: float, weight: float = 1.0) -> Problem:
    """Return a problem of a wagon that the brake alone cannot stop before a buffer, with ``offset`` in its cost."""
    table = ParameterTable([Parameter("h", 0.1, "s"), Parameter("offset", offset, "1")])
    system = time_stepping(
        "wagon",
        states=signals("x [m]; v [m/s]"),
        inputs=signals("J [N s]"),
        contacts=signals("buffer [N s]"),
        h=table["h"],
        mass=2.0,
        impulse=lambda q, v, u: u,
        distance=lambda q: q,
        parameters=table,
    )
    off, v = system.x[0] - 0.3, system.x[1]
    end = 4 * off**2 + 4 * v**2 + table["offset"]
    return Problem(
        "wagon",
        system,
        10,
        weight * (0.2 * system.u**2 + table["offset"] / 10),
        end,
        ca.SX([0.8, -2.0]),
        table,
        u_lower=-0.3,
        u_upper=0.3,
        scaling=Scaling(impulse=2.0, gap=0.1),
    )


def words(found: Solution) -> list[str]:
    """Return the verdict without its first line, which contains costs."""
    return [found.status.label, found.grade, *found.verdict.splitlines()[1:]]


@pytest.mark.one_case_in(3)
@pytest.mark.cheap_cases("1e-09-exact", "-20.0-exact", "1000.0-exact")
@pytest.mark.parametrize("law", ["exact", "barrier"])
@pytest.mark.parametrize("offset", [1e-9, -20.0, 1e3, 1e9, -1e9])
def test_an_offset_of_the_cost_changes_no_bit_of_the_plan(law: str, offset: float) -> None:
    plain, moved = (solve(wagon(value), contact=law, effort="quick") for value in (0.0, offset))
    assert np.array_equal(plain.data["u"].values, moved.data["u"].values)
    assert words(plain) == words(moved)
    assert moved.referee.survives == plain.referee.survives
    assert moved.certificate.tolerance == plain.certificate.tolerance
    # Ten stage costs add up to one offset, and the terminal cost has another.
    assert moved.cost - 2 * offset == pytest.approx(plain.cost, abs=1e-6 + 1e-14 * abs(offset))


def test_an_offset_that_only_the_end_has_is_none_either() -> None:
    plain = wagon(0.0)
    moved = replace(plain, terminal_cost=plain.terminal_cost - 1e6)
    assert np.array_equal(
        solve(plain, effort="quick").data["u"].values,
        solve(moved, effort="quick").data["u"].values,
    )
