"""Functions that jump are distinguished from those with kinks, and the verdict reports them."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from dynamics.systems import ParameterTable, signals, time_stepping
from ocp import mpcc, solve
from ocp.judge import jumps
from ocp.judge.jumps import Domain, jump_findings, jumping_operations
from ocp.problem.problem import Constraint, Problem
from problems import get, names
from tests.findings import codes, numbers
from tests.named import named

X = ca.SX.sym("x", 2)
A, B = X[0], X[1]
SIZES = np.array([1.0, 30.0])
JUMPS = {
    "floor": ca.floor(A),
    "ceil": B * ca.ceil(3 * A),
    "sign": ca.sign(A - B),
    "<": ca.if_else(A > 0.1, A, A + 1e-3),
    "<=": (A >= B) * 1.0,
    "fmod": ca.fmod(A, 2),
    "remainder": ca.remainder(B, 2),
    "copysign": ca.copysign(3, A),
    "==": ca.if_else(A == 0, 1, 0),
    "!=": ca.if_else(B != 0.25, 1, 0),
    "atan2": ca.atan2(ca.sin(A), ca.cos(A)),
    "x/|x|": A / ca.fabs(A),
    "division": ca.fabs(A) / A,
}
MORE_JUMPS = {
    "cut at the origin": ("atan2", ca.atan2(0 * A, A - 0.3)),
    "steps of a root": ("x/|x|", B / ca.sqrt(B**2)),
    "an arc tangent of a pole": ("division", ca.atan(1 / A)),
    "inside a norm": ("sign", ca.sqrt(1 + (A + ca.sign(B)) ** 2)),
}
KINKS = {
    "fabs": ca.fabs(A),
    "fmax": ca.fmax(A, B),
    "huber": ca.if_else(ca.fabs(A) < 1, A**2 / 2, ca.fabs(A) - 0.5),
    "sign": A * ca.sign(A),
    "hinge": ca.if_else(A > B, A - B, 0) ** 2,
    "smooth": ca.tanh(A * B),
    "saw": ca.fabs(A - 2 * ca.floor(A / 2 + 0.5)),
    "root": ca.sqrt(A**2),
    "angle": ca.cos(ca.atan2(A, B)),
    "half an angle": ca.cos(ca.atan2(A, B) / 2),
    "pole": 1 / A + 1 / B**2,
    "wave": ca.fabs(ca.fmod(ca.fabs(A), 2) - 1),
    "even": ca.copysign(A, B) ** 2,
    "sinc": ca.sin(A) / A,
    "rounded": A / ca.sqrt(A**2 + 1e-12),
    "point": ca.if_else(A == 0, 1, ca.sin(A) / A),
    "quotient": ca.sin(A - 0.4) / (A - 0.4),
}


def test_values_that_are_infinite_at_a_pole_raise_no_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert jumping_operations(ca.exp((1 / A) ** 2), X, Domain(SIZES)) == []


def test_only_expressions_with_such_operations_are_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    """One expression divides and one calls a function; the graph of a third, which does neither, is not walked."""
    walked: list[str] = []

    def counted(expression: ca.SX) -> Iterator[ca.SX]:
        walked.append(str(expression))
        return nodes(expression)

    nodes, p = jumps._nodes, ca.MX.sym("p")
    monkeypatch.setattr(jumps, "_nodes", counted)
    table = ca.interpolant("table", "linear", [[-1.0, 0.0, 1.0]], [1.0, 0.0, 1.0])
    called = ca.Function("called", [p], [table(p)], {"never_inline": True})(A)
    findings = jumps.jump_findings_of({"f": A * B, "g": ca.fabs(A) / A, "h": called}, X, Domain(SIZES))
    assert walked == [str(ca.fabs(A) / A), str(called)]
    assert [finding.code for finding in findings] == ["problem-jumps", "functions-not-inspected"]


@pytest.mark.parametrize("operation", JUMPS)
def test_what_jumps_is_named(operation):
    assert operation in jumping_operations(ca.SX(JUMPS[operation]), X, Domain(SIZES))


@pytest.mark.parametrize("kind", MORE_JUMPS)
def test_branch_cuts_and_quotients_are_named(kind):
    operation, expression = MORE_JUMPS[kind]
    assert jumping_operations(expression, X, Domain(SIZES)) == [operation]


@pytest.mark.parametrize("kind", KINKS)
def test_what_is_continuous_does_not_jump(kind):
    assert jumping_operations(KINKS[kind], X, Domain(SIZES)) == []


@pytest.mark.parametrize("operation", JUMPS)
def test_what_bounds_keep_away_does_not_jump(operation):
    """Within these bounds there is no switch and no branch cut."""
    inside = Domain(SIZES, np.array([0.15, 0.31]), np.array([0.3, 0.9]))
    assert jumping_operations(ca.SX(JUMPS[operation]), X, inside) == []


@pytest.mark.costly_cases("push-cube", "reorient")
@pytest.mark.parametrize("name", names())
def test_no_named_problem_jumps(name):
    assert jump_findings(named(name)) == ()


def sentences(problem: Problem) -> str:
    return "".join(finding.sentence for finding in jump_findings(problem))


def cart(push=lambda q, u: u, wall=lambda q: q, **changes) -> Problem:
    """Return a problem of a cart that approaches a wall, with ``changes`` of its costs and constraints."""
    system = time_stepping(
        "cart",
        states=signals("x [m]; v [m/s]"),
        inputs=signals("u [N s]"),
        contacts=signals("wall [N s]"),
        h=0.1,
        mass=1.0,
        impulse=lambda q, v, u: push(q, u),
        distance=wall,
        parameters=ParameterTable([]),
    )
    x, v = system.x[0], system.x[1]
    plain = Problem(
        "cart",
        system,
        N=5,
        stage_cost=0.1 * system.u**2,
        terminal_cost=10 * v**2 + x**2,
        x0=ca.SX([1.0, -3.0]),
        parameters=system.parameters,
        u_lower=-0.1,
        u_upper=0.1,
    )
    return replace(plain, **{name: of(system.x, system.u) for name, of in changes.items()})


@pytest.mark.parametrize(
    ("problem", "place"),
    [
        (cart(push=lambda q, u: u + 0.3 * (q > 0.5)), "< in dynamics"),
        (cart(push=lambda q, u: u + (q - 0.4) / ca.fabs(q - 0.4)), "x/|x| in dynamics"),
        (cart(push=lambda q, u: u + 0.2 * ca.sign(u)), "sign in dynamics"),
        (cart(wall=lambda q: q + 0.2 * (q < 0.4)), "< in gaps"),
        (cart(terminal_cost=lambda x, u: ca.atan2(0 * x[0], x[0] - 0.3)), "atan2 in terminal_cost"),
        (cart(stage_cost=lambda x, u: u**2 + ca.fmod(x[0], 0.5)), "fmod in stage_cost"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_jumps_of_every_part_of_a_problem_are_named(problem, place):
    assert place in sentences(problem)


@pytest.mark.parametrize(
    "problem",
    [
        cart(),
        cart(stage_cost=lambda x, u: u**2 * (1 + (x[0] < -0.5))),
        cart(push=lambda q, u: u + ca.sign(u - 0.2)),
        cart(path=lambda x, u: [Constraint("near", x[0], 0, 2)], stage_cost=lambda x, u: u**2 + ca.floor(x[0] / 3)),
    ],
    ids=["plain", "behind the wall", "beyond the input", "beyond a constraint"],
)
def test_jumps_out_of_reach_are_not_named(problem):
    """On a plan distances are not negative, and inputs stay within their bounds."""
    assert jump_findings(problem) == ()


def test_the_verdict_of_a_cost_that_jumps_is_amber():
    """A rounded term in the cost is flat almost everywhere, so that the certificate remains valid."""
    plain = get("push-1d", N=3)
    stairs = plain.stage_cost + 1e-6 * ca.floor(plain.system.x[0])
    found = solve(replace(plain, stage_cost=stairs))
    assert found.success
    assert "problem-jumps" in codes(found)
    assert found.grade == "certified"
    smooth = solve(plain)
    assert "problem-jumps" not in codes(smooth) and smooth.grade == "survives"


def test_constraints_count_and_parameters_do_not():
    plain = get("push-1d", N=3)
    limited = replace(plain, path=[Constraint("stairs", ca.ceil(plain.system.x[0]), -5, 5)])
    assert "(ceil in stairs)" in sentences(limited)
    rounded = plain.stage_cost + ca.floor(plain.parameters.vector[0])
    assert jump_findings(replace(plain, stage_cost=rounded)) == ()


def test_costs_on_impulses_are_inspected():
    """A surcharge above an impulse jumps if it is constant, and has a kink if it grows from zero."""
    plain = get("push-1d", N=3)
    lam = plain.system.lam[0]
    surcharge = ca.if_else(lam > 0.5, lam + 1, lam)
    assert "(< in stage_cost)" in sentences(replace(plain, stage_cost=surcharge))
    hinge = ca.if_else(lam > 0.5, lam - 0.5, 0)
    assert jump_findings(replace(plain, stage_cost=hinge)) == ()


def test_functions_without_a_graph_are_reported():
    """An external function may jump between two points at which it is evaluated."""
    plain = get("push-1d", N=3)
    z = ca.SX.sym("z")
    table = ca.Function("table", [z], [z**2], {"never_inline": True})
    found = solve(replace(plain, stage_cost=plain.stage_cost + 1e-6 * table(plain.system.x[0])))
    assert found.success and found.grade == "certified"
    assert numbers(found, "functions-not-inspected") == {"functions": "table in stage_cost"}


def test_jumps_of_a_complementarity_problem_are_named():
    x = ca.SX.sym("x", 2)
    cost = ca.sumsqr(x - 1) + 0.5 * ca.sign(x[0] - 0.5)
    stairs = mpcc.solve(mpcc.MPCC(x, cost, x[0], x[1], lbx=0, ubx=2), x0=[0.8, 0.1])
    assert "The problem jumps (sign in f)" in stairs.verdict
    smooth = mpcc.solve(mpcc.MPCC(x, ca.sumsqr(x - 1), x[0], x[1], lbx=0, ubx=2))
    assert "jumps" not in smooth.verdict
