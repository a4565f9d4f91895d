"""Carts beyond their limits: the controller's input equals that of a quadratic program written here.

The program has the true state, no bound at its first node, and a slack for each later bound.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dynamics.systems import Parameter, ParameterTable, signals, time_stepping
from ocp.mpc import Controller, Disturbance, simulate
from ocp.problem.problem import Constraint, Problem, Scaling

H, N, GOAL, V_MAX, U_MAX = 0.05, 12, 2.0, 1.0, 4.0


def cart(kind: str = "bound", weight: float = 1.0) -> Problem:
    """Return a problem of a cart with a speed limit, a bound or a path constraint in millionths of its unit.

    ``kind`` ``two`` has a limit of the position too, ``far`` a wall at 1e8 m.
    """
    parameters = ParameterTable([Parameter("h", H, "s")])
    wall = 1e8 if kind == "far" else 30.0
    system = time_stepping(
        "cart",
        states=signals("x [m]; v [m/s]"),
        inputs=signals("u [N]"),
        contacts=signals("wall [N s]"),
        h=parameters.vector[0],
        mass=1.0,
        impulse=lambda q, v, u: parameters.vector[0] * u,
        distance=lambda q: wall - q,
        parameters=parameters,
    )
    x, v = system.x[0], system.x[1]
    v_max = ca.inf if kind == "path" else V_MAX
    x_max = 0.6 if kind == "two" else ca.inf
    x_lower, x_upper = ca.SX([-ca.inf, -v_max]), ca.SX([x_max, v_max])
    speed = Constraint("speed", 1e-6 * system.x_next[1], -1e-6 * V_MAX, 1e-6 * V_MAX)
    return Problem(
        "cart",
        system,
        N,
        parameters=parameters,
        x0=ca.SX.zeros(2),
        stage_cost=weight * H * ((x - GOAL) ** 2 + 0.1 * v**2 + 0.01 * system.u**2),
        terminal_cost=weight * (10 * (x - GOAL) ** 2 + v**2),
        u_lower=-U_MAX,
        u_upper=U_MAX,
        x_lower=x_lower,
        x_upper=x_upper,
        path=[speed] if kind == "path" else [],
        scaling=Scaling(impulse=1, gap=0.1, u=U_MAX),
    )


def by_hand(start: np.ndarray, x_max: float = np.inf) -> float:
    """Return the first input of the quadratic program, whose slacks have a penalty of 1e5."""
    program: Any = ca.Opti("conic")
    X, U, S = program.variable(2, N + 1), program.variable(1, N), program.variable(2, N)
    cost: Any = 10 * (X[0, N] - GOAL) ** 2 + X[1, N] ** 2 + 1e5 * ca.sum1(ca.vec(S))
    program.subject_to(X[:, 0] == start)
    program.subject_to(ca.vec(S) >= 0)
    program.subject_to(program.bounded(-U_MAX, U, U_MAX))
    for k in range(N):
        cost += H * ((X[0, k] - GOAL) ** 2 + 0.1 * X[1, k] ** 2 + 0.01 * U[k] ** 2)
        program.subject_to(X[1, k + 1] == X[1, k] + H * U[k])
        program.subject_to(X[0, k + 1] == X[0, k] + H * X[1, k + 1])
        program.subject_to(X[1, k + 1] - V_MAX <= S[1, k])
        program.subject_to(-V_MAX - X[1, k + 1] <= S[1, k])
        if np.isfinite(x_max):
            program.subject_to(X[0, k + 1] - x_max <= S[0, k])
    program.minimize(cost)
    quiet = {f"print_{what}": False for what in ("iter", "header", "time", "info")}
    program.solver("qrqp", quiet)
    return float(program.solve().value(U)[0])


@cache
def controller(kind: str, phase: str, weight: float = 1.0) -> Controller:
    return Controller(cart(kind, weight), phase=phase)


STARTS = ([0.5, 0.5], [0.5, 0.95], [0.5, 1.5], [0.5, 30.0], [0.5, -1.3], [1.9, 1.5])


@pytest.mark.cheap_cases("bound-qpcc")
@pytest.mark.parametrize("phase", ["qpcc", "qp", "full"])
@pytest.mark.parametrize("kind", ["bound", "path", "far"])
def test_a_cart_beyond_its_speed_limit_brakes(kind: str, phase: str) -> None:
    asked = controller(kind, phase)
    for start in STARTS:
        asked.reset()
        command = asked.step(np.array(start), u_before=np.zeros(1))
        assert command.u[0] == pytest.approx(by_hand(np.array(start)), abs=1e-4), start
        assert command.plan is not None
        assert command.plan.x[0].tolist() == start
        assert ("violates" in command.note) == (abs(start[1]) > V_MAX + H * U_MAX), start


@pytest.mark.costly
@pytest.mark.parametrize("weight", [1e-6, 1e6])
def test_the_penalty_is_exact_in_any_unit_of_the_cost(weight: float) -> None:
    asked = controller("bound", "qpcc", weight)
    for start in STARTS:
        asked.reset()
        command = asked.step(np.array(start), u_before=np.zeros(1))
        assert command.u[0] == pytest.approx(by_hand(np.array(start)), abs=1e-4), start


@pytest.mark.costly_cases("full")
@pytest.mark.parametrize("phase", ["qpcc", "full"])
def test_a_limit_that_cannot_be_met_loosens_no_other(phase: str) -> None:
    """With the position limited to 0.6 m, only the speed violates its limit at 0.3 m and 1.5 m/s."""
    asked = controller("two", phase)
    for start in ([0.3, 1.5], [0.1, 1.6], [0.55, 2.0], [0.9, 0.0]):
        asked.reset()
        command = asked.step(np.array(start), u_before=np.zeros(1))
        assert command.u[0] == pytest.approx(by_hand(np.array(start), 0.6), abs=1e-4), start


@pytest.mark.costly_cases("relaxed")
@pytest.mark.parametrize("phase", ["qpcc", "relaxed", "policy"])
def test_what_the_plant_violates_is_in_the_verdict(phase: str) -> None:
    pushed = simulate(controller("bound", phase), 20, disturbance=Disturbance(pushes={8: np.array([0.0, 1.5])}))
    (broken,) = pushed.verdict.violated
    assert (broken.name, broken.violation.step) == ("bound on v", 8)
    after = float(pushed.data["x"][0, 9, 1])
    assert broken.violation.amount == pytest.approx(after - V_MAX, rel=1e-9)
    assert pushed.verdict.status == "failed"
    assert f"The plant violates bound on v by up to {after - V_MAX:.3g}" in str(pushed.verdict)
