"""Right solutions in unusual units, with large weights, constants under roots, and distant starts."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynamics.systems import ParameterTable, signals, time_stepping
from ocp import mpcc, solve
from ocp.judge.certificate import certify
from ocp.mpcc.programs import programs_of
from ocp.problem.problem import Problem
from ocp.programs.program import PENALTY, RELAXATION
from ocp.programs.solver import Status

NO_PARAMETERS = ParameterTable()
NOTHING = {PENALTY: 0.0, RELAXATION: 0.0}
X = ca.SX.sym("x", 3)
A, B, C = X[0], X[1], X[2]


def mass_and_wall(length=1.0, mass=1.0, time=1.0, effort=None, **more) -> Problem:
    """Return a problem of a mass that flies at a wall, with ``length``, ``mass``, ``time`` units per m, kg, s."""
    impulse = mass * length / time
    system = time_stepping(
        "wall",
        states=signals("x [m]; v [m/s]"),
        inputs=signals("u [N s]"),
        contacts=signals("wall [N s]"),
        h=0.1 * time,
        mass=mass,
        impulse=lambda q, v, u: u,
        distance=lambda q: q,
        parameters=NO_PARAMETERS,
    )
    x, v, u = system.x[0] / length, system.x[1] * time / length, system.u / impulse
    stage, terminal = (effort or (lambda x, v, u: (0.1 * u**2, 10 * (x - 0.2) ** 2 + 10 * v**2)))(x, v, u)
    return Problem(
        "wall",
        system,
        20,
        stage,
        terminal,
        ca.SX([length, -3.0 * length / time]),
        NO_PARAMETERS,
        u_lower=-0.1 * impulse,
        u_upper=0.1 * impulse,
        **more,
    )


@pytest.mark.cheap_cases("units2-multiple-shooting")
@pytest.mark.parametrize("method", ["multiple-shooting", "single-shooting"])
@pytest.mark.parametrize(
    "units",
    [
        {"length": 1e9},
        {"length": 1e9, "mass": 1e3, "time": 1e6},
        {"length": 1e-3, "mass": 1e-3},
    ],
)
def test_residuals_by_shooting_are_in_the_units_of_the_problem(method, units):
    found = solve(mass_and_wall(**units), method=method, effort="quick")
    assert found.success and found.cost == pytest.approx(0.0014202549551617521, rel=1e-4)


def certificate(cost: ca.SX, at: list[float], lower=(-np.inf, -np.inf, -np.inf)):
    """Return the certificate of a point of ``min cost`` with ``0 <= A ⟂ B >= 0``."""
    program = programs_of(mpcc.MPCC(X, cost, A, B, lbx=lower), np.zeros(0), np.array(at))("none")
    point = program.extended(np.array(at))
    return certify(program, point, program.parameter_vector(NOTHING), program.bounds(NOTHING))


STIFF = {
    "free": (lambda weight: weight * (C - 1) ** 2, 1.0),
    "price at its bound": (lambda weight: weight * C, 0.0),
    "square pressed on its bound": (lambda weight: weight * (C + 1) ** 2, 0.0),
}


@pytest.mark.one_case_in(3)
@pytest.mark.parametrize("weight", [1e2, 1e6, 1e8, 1e10])
@pytest.mark.parametrize("kind", STIFF)
def test_a_stiff_variable_hides_no_descent(kind, weight):
    """The minimum is at B = 3 for any weight on C."""
    stiff, at = STIFF[kind]
    cost = (A - 2) ** 2 + (B - 3) ** 2 + stiff(weight)
    lower = (-np.inf, -np.inf, -np.inf if kind == "free" else 0.0)
    assert not certificate(cost, [0, 2.5, at], lower).certified
    assert not certificate(cost, [0, 2.9, at], lower).certified
    assert certificate(cost, [0, 3, at], lower).certified


@pytest.mark.one_case_in(3)
@pytest.mark.parametrize("weight", [1e4, 1e8, 1e10])
@pytest.mark.parametrize("kind", ["price at its bound", "square pressed on its bound"])
def test_the_answer_beside_a_stiff_variable_is_certified(kind, weight):
    cost = (A - 2) ** 2 + (B - 3) ** 2 + STIFF[kind][0](weight)
    found = mpcc.solve(mpcc.MPCC(X, cost, A, B, lbx=[-np.inf, -np.inf, 0]), x0=[0.1, 0.1, 2])
    assert found.success
    assert min(abs(found.x[1] - 3), abs(found.x[0] - 2)) < 2e-3
    assert found.x[2] < 1e-12


@pytest.mark.one_case_in(4)
@pytest.mark.parametrize("start", [0.1, 1e3, 1e6, 1e9])
def test_a_start_far_away_decides_no_tolerance(start):
    cost = (A - 2) ** 2 + (B - 3) ** 2 + (C - 1) ** 2
    found = mpcc.solve(mpcc.MPCC(X, cost, A, B), x0=start)
    assert found.success and found.f == pytest.approx(4, abs=1e-4)


@pytest.mark.parametrize(("large", "small"), [(1e9, 1e-9), (1e-9, 1e9), (1e12, 1e-12)])
def test_variables_of_any_two_sizes(large, small):
    """The size of C, whose gradient is zero at the start, follows from its curvature."""
    cost = (A / large - 2) ** 2 + (B / small - 3) ** 2 + (C / small - A / large) ** 2
    found = mpcc.solve(mpcc.MPCC(X, cost, A, B))
    assert found.success and found.f == pytest.approx(4, abs=1e-4)


def idle_input(cost, unit=1.0, weight=1.0) -> Problem:
    """Return a problem of a cart with an input w that only the cost depends on."""
    system = time_stepping(
        "cart",
        states=signals("x [m]; v [m/s]"),
        inputs=signals("u [N s]; w [N s]"),
        contacts=signals("far [N s]"),
        distance=lambda q: q + 1e3 * unit,
        h=0.1,
        mass=1.0,
        impulse=lambda q, v, u: u[0] + 0 * u[1],
        parameters=NO_PARAMETERS,
    )
    x, v, u, w = *ca.vertsplit(system.x / unit), *ca.vertsplit(system.u / unit)
    ends = weight * (u**2 + cost(w)), weight * ((x - 0.5) ** 2 + v**2)
    return Problem("cart", system, 5, *ends, ca.SX([0.2 * unit, 0]), NO_PARAMETERS)


NOT_ATTAINED = {
    "atan": ca.atan,
    "tanh": lambda w: -ca.tanh(w),
    "algebraic": lambda w: -w / ca.sqrt(1 + w**2),
    "exponential": lambda w: ca.exp(-w),
    "softplus": lambda w: ca.log(1 + ca.exp(-w)),
}


@pytest.mark.cheap_cases("softplus")
@pytest.mark.parametrize("kind", NOT_ATTAINED)
def test_a_value_that_no_point_attains_beside_an_input_that_has_a_minimum(kind):
    assert solve(idle_input(NOT_ATTAINED[kind])).status is Status.UNBOUNDED


def test_an_input_that_moves_nothing_has_the_size_that_its_cost_gives():
    assert solve(idle_input(NOT_ATTAINED["exponential"], 1e-3, 1e-6)).status is Status.UNBOUNDED


def test_iterates_that_run_away_uphill_are_no_fault_of_the_problem():
    """The norm |w - 1| has a minimum, which an interior point may miss."""
    assert solve(idle_input(lambda w: ca.fabs(w - 1))).status is not Status.UNBOUNDED


HIDDEN = {
    "root": lambda c: ca.sqrt(400 + 40 * c),
    "square": lambda c: (10 + c / 20) ** 2,
    "exponential": lambda c: 1e3 * ca.exp(1e-3 * c),
    "sum": lambda c: c + 20,
}


@pytest.mark.costly
@pytest.mark.parametrize("kind", HIDDEN)
def test_a_constant_under_a_root_or_a_square_changes_no_survival(kind):
    """The replay costs three times as much as the plan, without the constant, and does not survive."""
    hide = HIDDEN[kind]

    def costs(x, v, u):
        return hide(0.1 * u**2 + 0.01 * x**2), hide(10 * (x - 0.2) ** 2 + 10 * v**2)

    assert solve(mass_and_wall(effort=costs), contact="randomized").referee.survives is False
