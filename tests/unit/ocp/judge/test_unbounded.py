"""A problem is not solved if its cost decreases without bound, or towards a value that no point attains."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from dynamics.systems import ParameterTable, signals, time_stepping
from ocp import mpcc, solve
from ocp.judge.unbounded import describe_fall
from ocp.problem.problem import Constraint, Problem
from ocp.programs.solver import Status

WITHOUT_END = {
    "linear": lambda t: 3 - t,
    "square": lambda t: -(t**2),
    "root": lambda t: -np.sqrt(t),
    "logarithm": lambda t: -np.log(1 + t**2),
    "behind a hill": lambda t: t**2 - t**3,
}
NOT_ATTAINED = {
    "exponential": lambda t: np.exp(-t),
    "beside a constant": lambda t: 5 + np.exp(-t),
    "witch": lambda t: 1 / (1 + t**2),
    "sigmoid": lambda t: -np.tanh(t / 10),
}
ATTAINED = {
    "flat": lambda t: 7.0,
    "bowl": lambda t: (t - 3) ** 2,
    "far bowl": lambda t: 1e-6 * t**2 - t,
    "hinge": lambda t: max(0.0, 1 - t) ** 2,
    "far hinge": lambda t: max(0.0, 100 - t),
    "saturating": lambda t: 1 - np.exp(-(t**2)),
    "huber": lambda t: np.sqrt(1 + (t - 2) ** 2),
    "infeasible": lambda t: -t if t < 1e4 else np.nan,
    "wave": lambda t: np.cos(t),
}


@pytest.mark.parametrize("kind", WITHOUT_END)
def test_no_end(kind):
    assert "without bound" in describe_fall(WITHOUT_END[kind], 1.0, np.inf, 0.0)


@pytest.mark.parametrize("kind", NOT_ATTAINED)
def test_no_minimum(kind):
    assert "no point attains" in describe_fall(NOT_ATTAINED[kind], 1.0, np.inf, 0.0)


@pytest.mark.parametrize("kind", ATTAINED)
def test_a_minimum(kind):
    assert describe_fall(ATTAINED[kind], 1.0, np.inf, 0.0) == ""


def cart(cost, end=lambda x: ca.SX(0), path=(), **changes) -> Problem:
    """Return a problem of a cart that two inputs push, with a wall behind it."""
    system = time_stepping(
        "cart",
        states=signals("x [m]; v [m/s]"),
        inputs=signals("u [N s]; w [N s]"),
        contacts=signals("wall [N s]"),
        h=0.1,
        mass=1.0,
        impulse=lambda q, v, u: u[0] + u[1],
        distance=lambda q: q,
        parameters=ParameterTable([]),
    )
    u, x = system.u, system.x
    plain = Problem(
        "cart",
        system,
        N=4,
        stage_cost=cost(u[0], u[1]),
        terminal_cost=end(x[0]),
        x0=ca.SX([1.0, -3.0]),
        parameters=system.parameters,
        path=[Constraint("limit", row(u[0], u[1]), low, high) for row, low, high in path],
    )
    return replace(plain, **changes)


UNBOUNDED = {
    "linear": (cart(lambda u, w: u + w**2), "along u"),
    "square": (cart(lambda u, w: -(u**2) + w**2), "along u"),
    "logarithm": (cart(lambda u, w: -ca.log(1 + u**2) + w**2), "without bound along u"),
    "exponential": (cart(lambda u, w: ca.exp(-u) + w**2), "no point attains"),
    "witch": (cart(lambda u, w: 1 / (1 + u**2) + w**2), "no point attains"),
    "a state": (cart(lambda u, w: ca.sqrt(1 + u**2) / 1e3 + w**2, lambda x: -x), "along u"),
    "two together": (cart(lambda u, w: (u - w) ** 2 - u - w), "along u and w"),
    "one side": (cart(lambda u, w: u + w**2, u_lower=ca.SX([-ca.inf, -1]), u_upper=ca.SX([5, 1])), "along u"),
}
BOUNDED = {
    "flat": cart(lambda u, w: w**2, lambda x: (x - 0.5) ** 2),
    "huber": cart(lambda u, w: ca.sqrt(1 + u**2) + w**2, lambda x: (x - 0.5) ** 2),
    "saturating": cart(lambda u, w: 1 - ca.exp(-(u**2)) + w**2, lambda x: (x - 0.5) ** 2),
    "logarithm": cart(lambda u, w: ca.log(1 + u**2) + w**2, lambda x: (x - 0.5) ** 2),
    "far": cart(lambda u, w: 1e-6 * u**2 - u + w**2),
    "hinge": cart(lambda u, w: ca.fmax(0, 1 - u) ** 2 + w**2),
    "box": cart(lambda u, w: u + w**2, u_lower=-5, u_upper=5),
    "disc": cart(lambda u, w: -u - w, path=[(lambda u, w: u**2 + w**2, -ca.inf, 4)]),
    "strip": cart(lambda u, w: -(u**2) + w**2, path=[(lambda u, w: u, -7, 7)]),
}


@pytest.mark.costly_cases("linear", "square", "logarithm", "two together", "exponential", "a state", "one side")
@pytest.mark.parametrize("kind", UNBOUNDED)
def test_a_cost_without_a_minimum_is_not_solved(kind):
    problem, told = UNBOUNDED[kind]
    found = solve(problem, effort="quick")
    assert (found.status, found.grade) == (Status.UNBOUNDED, "failed")
    (finding,) = (finding for finding in found.findings if finding.code == "unbounded")
    assert told in finding.sentence and "stationary" not in found.verdict


@pytest.mark.cheap_cases("box")
@pytest.mark.parametrize("kind", BOUNDED)
def test_a_cost_with_a_minimum_is_solved(kind):
    assert solve(BOUNDED[kind], effort="quick").success


@pytest.mark.costly
@pytest.mark.parametrize(
    ("law", "method"),
    [
        ("barrier", "direct"),
        ("exact", "single-shooting"),
        ("adaptive", "multiple-shooting"),
    ],
)
def test_under_every_law_and_method(law, method):
    falling, resting = UNBOUNDED["witch"][0], BOUNDED["huber"]
    assert solve(falling, contact=law, method=method, effort="quick").status is Status.UNBOUNDED
    assert solve(resting, contact=law, method=method, effort="quick").success


X = ca.SX.sym("x", 4)
A, B, C, D = (X[i] for i in range(4))
RAYS = {
    "ray": (-A + B, [], 0, 0),
    "exponential": (ca.exp(-A) + B, [], 0, 0),
    "logarithm": (-ca.log(1 + C**2), [], 0, 0),
    "square": ((A - 1) ** 2 - C**2, [], 0, 0),
    "two together": ((C - 2 * D) ** 2 - C - 2 * D, [], 0, 0),
    "witch": (1 / (1 + C**2), [], 0, 0),
    "strip": ((A - 1) ** 2 - C - D, [C - D], -1, 1),
    "rows": (-C, [C - D - A], 0, ca.inf),
}
ENDS = {
    "bowl": ((C - D) ** 2 - C - D + 1e-3 * C**2, [], 0, 0),
    "flat": ((A - 1) ** 2 + B, [], 0, 0),
    "disc": (-C - D, [C**2 + D**2], -ca.inf, 4),
    "wall": (-A + 2 * C, [C - A], 0, ca.inf),
    "saturating": (1 - ca.exp(-(C**2)), [], 0, 0),
    "far": (1e-6 * (C - 1e5) ** 2, [D], 0, 0),
}


def solved(cost, rows, low, high) -> mpcc.MPCCSolution:
    """Solve the problem of a cost and rows with the pair ``0 <= A ⟂ B >= 0``."""
    rows = ca.vertcat(ca.SX(0, 1), *rows, *[ca.SX(0)] * bool(rows))
    bound = [[low, -1], [high, 1]] if rows.numel() else [[], []]
    lower = [0, 0, -np.inf, -np.inf]
    return mpcc.solve(mpcc.MPCC(X, cost, A, B, rows, lbx=lower, lbg=bound[0], ubg=bound[1]))


@pytest.mark.cheap_cases("exponential", "square")
@pytest.mark.parametrize("kind", RAYS)
def test_a_complementarity_problem_without_a_minimum_is_not_solved(kind):
    found = solved(*RAYS[kind])
    assert found.status is Status.UNBOUNDED and not found.success
    assert "decreases without bound" in found.verdict or "no point attains" in found.verdict


@pytest.mark.one_case_in(2)
@pytest.mark.parametrize("kind", ENDS)
def test_a_complementarity_problem_with_a_minimum_is_solved(kind):
    assert solved(*ENDS[kind]).success
