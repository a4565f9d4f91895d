"""Minima on kinks: solved on smooth pieces, certified on both sides, and equal to those of smooth reformulations."""

from __future__ import annotations

import casadi as ca
import numpy as np
import piqp
import pytest

from dynamics.contact import Exact
from dynamics.systems import ParameterTable, signals, time_stepping
from ocp import Feedback, Problem, Scaling, roll_out, solve
from ocp.judge.kinks import certify_at_kinks
from ocp.problem.policy import OpenLoop
from ocp.programs.solver import Point
from ocp.routes.homotopy import Homotopy
from ocp.routes.pieces import NearbySolvers, PieceBranches
from ocp.routes.rollouts import pack_rollout
from ocp.routes.session import Session
from ocp.transcription import Direct

H, N = 0.1, 8
START = (1.0, 0.5)


def cart(stage_cost, end=lambda x: ca.SX(0), start=START, steps=N, length=1.0) -> Problem:
    """Return a problem of a cart with a wall behind it, with lengths in units of ``length`` metres."""
    system = time_stepping(
        "cart",
        states=signals("x [m]; v [m/s]"),
        inputs=signals("u [N s]"),
        contacts=signals("wall [N s]"),
        h=H,
        mass=1.0,
        impulse=lambda q, v, u: u,
        distance=lambda q: q,
        parameters=ParameterTable([]),
    )
    x, u = system.x / length, system.u / length
    scaling = Scaling(impulse=length, gap=length, x=length, u=length)
    x0 = length * ca.SX(list(start))
    return Problem(
        "cart",
        system,
        steps,
        stage_cost=stage_cost(u),
        terminal_cost=end(x),
        x0=x0,
        scaling=scaling,
        parameters=system.parameters,
    )


def least_fuel(weight: float, **changes) -> Problem:
    """Return the problem of least ``weight sum |u|`` that ends near x = 2 at rest."""
    return cart(lambda u: weight * ca.fabs(u), lambda x: 10 * (x[0] - 2) ** 2 + x[1] ** 2, **changes)


def least_fuel_by_quadratic_program(weight: float) -> tuple[float, np.ndarray]:
    """Return optimum and inputs of the same problem far from the wall, with ``u = a - b``, ``a, b >= 0``."""
    steps_left = N - np.arange(N)
    rows = np.sqrt([[10.0], [1.0]]) * np.array([H * steps_left, np.ones(N)])
    offset = np.sqrt([10.0, 1.0]) * (np.array([START[0] + H * N * START[1], START[1]]) - [2.0, 0.0])
    signed = np.hstack([rows, -rows])
    solver = piqp.DenseSolver()
    solver.settings.eps_abs = solver.settings.eps_rel = 1e-12
    count = 2 * N
    solver.setup(2 * signed.T @ signed, 2 * signed.T @ offset + weight, None, None, None, None, None, np.zeros(count))
    solver.solve()
    z = solver.result.x
    return float(np.sum((signed @ z + offset) ** 2) + weight * z.sum()), z[:N] - z[N:]


@pytest.mark.cheap_cases("1.0-1.0")
@pytest.mark.parametrize("length", [1.0, 1e3])
@pytest.mark.parametrize("weight", [0.1, 1.0, 8.0])
def test_least_fuel_is_that_of_a_quadratic_program(weight, length):
    optimum, u = least_fuel_by_quadratic_program(weight)
    solution = solve(least_fuel(weight, length=length), contact="exact", effort="quick")
    assert solution.success
    np.testing.assert_allclose(solution.cost, optimum, rtol=1e-6)
    np.testing.assert_allclose(solution.arrays["u"][0, :, 0] / length, u, atol=2e-3)


@pytest.mark.costly
@pytest.mark.parametrize(
    "changes", [{"method": "single-shooting"}, {"method": "multiple-shooting"}, {"policy": Feedback()}]
)
def test_every_method_and_policy_ends_there(changes):
    solution = solve(least_fuel(1.0), contact="exact", effort="quick", **changes)
    assert solution.success
    np.testing.assert_allclose(solution.cost, least_fuel_by_quadratic_program(1.0)[0], rtol=1e-6)


@pytest.mark.costly_cases("0.3")
@pytest.mark.parametrize("weight", [0.3, 3.0])
def test_no_small_change_of_inputs_costs_less_where_the_wall_is_hit(weight):
    problem = least_fuel(weight, start=(0.1, -3.0))
    solution = solve(problem, contact="exact", effort="quick")
    assert solution.success and solution.audit.active_steps > 0
    u, rng = solution.arrays["u"][0], np.random.default_rng(0)
    for size in (1e-3, 1e-2):
        for _ in range(50):
            changed = u + size * rng.normal(size=u.shape) * (rng.random(u.shape) < 0.3)
            assert roll_out(problem, changed[None], {}).cost > solution.cost - 1e-7 * solution.cost


KINKED = {
    "convex, flat enough": (lambda u: 0.5 * u + ca.fabs(u), "B"),
    "convex, too steep": (lambda u: 1.5 * u + ca.fabs(u), "not"),
    "convex, too steep the other way": (lambda u: ca.fabs(u) - 1.5 * u, "not"),
    "concave": (lambda u: -ca.fabs(u) + u**2, "not"),
    "maximum": (lambda u: ca.fmax(u, 2 * u) - 1.5 * u, "B"),
    "maximum, too steep": (lambda u: ca.fmax(u, 2 * u) - 2.5 * u, "not"),
    "one-sided": (lambda u: ca.fmax(0, u) - 0.5 * ca.fmax(0, -u) + u**2, "not"),
    "two kinks at one point": (lambda u: ca.fabs(u) + ca.fmin(u, 0) - 0.9 * u, "B"),
    "two kinks at one point, too steep": (lambda u: ca.fabs(u) + ca.fmin(u, 0) + 0.9 * u, "not"),
}


def session_of(problem: Problem) -> Session:
    """Return the session of a problem under the exact law."""
    return Session(problem, Exact(), Direct(), OpenLoop())


@pytest.mark.one_case_in(2)
@pytest.mark.parametrize("name", KINKED)
def test_the_certificate_sees_both_sides(name):
    """At u = 0 the one-sided slopes of the cost decide, which are those of a function of one number."""
    cost, expected = KINKED[name]
    problem = cart(cost, steps=1)
    session = session_of(problem)
    point = pack_rollout(session.nlp_of("none"), roll_out(problem, np.zeros((1, 1, 1)), session.values), None)
    u = ca.SX.sym("u")
    value = ca.Function("cost", [u], [cost(u)])
    is_minimum = all(float(value(change)) >= float(value(0)) for change in (1e-6, -1e-6))
    assert (expected == "B") == is_minimum
    assert certify_at_kinks(session.pieces, point, session.values).stationarity == expected


def test_a_branch_without_derivative_is_solved_on_a_piece():
    problem = least_fuel(1.0)
    session = session_of(problem)
    follower = Homotopy(session.nlp_of, session.solver, session.values)
    start = Point(pack_rollout(session.nlp_of("none"), roll_out(problem, np.zeros((1, N, 1)), {}), None))
    solver, result = NearbySolvers(follower).solve(start, 100)
    assert isinstance(solver, PieceBranches) and result is not None
    assert follower.prefers_pieces and solver.is_stationary(result)
    outcome = solver.result_of_problem(result)
    assert outcome.nlp is session.nlp_of("none") and outcome.result.point.lam_g.size == outcome.nlp.m
    np.testing.assert_allclose(outcome.result.f, least_fuel_by_quadratic_program(1.0)[0], rtol=1e-6)


def test_smooth_problems_have_no_pieces():
    problem = cart(lambda u: u**2, lambda x: (x[0] - 2) ** 2)
    session = session_of(problem)
    solution = solve(problem, contact="exact", effort="quick")
    margins, changes = session.nlp_of("none").kink_margins(np.zeros(session.nlp_of("none").n), session.values)
    assert solution.success and margins.size == changes.size == 0
