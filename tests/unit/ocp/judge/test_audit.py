"""The audit finds planted errors: it reports residuals and constraints at the right place and by name."""

from __future__ import annotations

import functools
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Barrier, Exact
from dynamics.systems import Parameter, ParameterTable, signals, time_stepping
from ocp import (
    Constraint,
    Direct,
    MultipleShooting,
    OpenLoop,
    Problem,
    SingleShooting,
    Status,
    solve,
)
from ocp.judge.audit import audit_result, task_gradient, worst_constraints
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import roll_out
from ocp.programs.solver import Point
from ocp.routes.homotopy import RouteResult
from ocp.routes.session import Session
from ocp.solve.judging import judge_outcome
from ocp.transcription.nlp import trajectories
from problems import get
from tests.findings import codes


@functools.cache
def solved(law: str = "exact") -> tuple[Session, RouteResult]:
    closing = Exact() if law == "exact" else Barrier(mu=1e-3)
    session = Session(get("push-1d"), closing, Direct(), OpenLoop())
    return session, session.solve()


def planted(block: str, index: tuple[int, ...], amount: float, law: str = "exact"):
    """Return audit, plan and status of a solved problem after one entry of its solution is moved by ``amount``."""
    session, outcome = solved(law)
    nlp, result = outcome.nlp, outcome.result
    x = result.point.x.copy()
    x[nlp.variables[block].index[index]] += amount
    moved = replace(result, point=Point(x, result.point.lam_x, result.point.lam_g))
    values = session.values
    p, bounds = nlp.parameter_vector(values), nlp.bounds(values)
    plan = trajectories(nlp, moved, p)
    found, _, _ = audit_result(nlp, moved, plan, Evaluation(nlp.problem, values), p, bounds)
    return found, plan, judge_outcome(session, replace(outcome, result=moved), seed=0).status


@pytest.mark.costly
def test_nothing_planted_nothing_found() -> None:
    for law in ("exact", "barrier"):
        found, _, status = planted("x", (0, 0, 0), 0.0, law)
        assert status is Status.SOLVED
        assert found.dynamics_residual < 1e-8
        assert found.law_residual < 1e-7


@pytest.mark.parametrize("node", [1, 5, 20])
def test_a_moved_state_shows_in_the_dynamics_of_its_steps(node: int) -> None:
    found, plan, status = planted("x", (0, node - 1, 0), 1e-3)
    off = np.abs(plan.residual).max(axis=(0, 2))
    expected = {node - 1, node} & set(range(20))
    assert set(np.flatnonzero(off > 1e-7)) == expected
    assert found.dynamics_residual == pytest.approx(1e-3 * 1.0 / 0.1, rel=1e-6)  # M/h dq_u
    assert status is Status.INEXACT
    worst = found.worst[0]
    assert (worst.name, worst.component) == ("dynamics", "qu")
    assert worst.step in expected
    assert worst.amount == pytest.approx(found.dynamics_residual, rel=1e-6)


def test_a_moved_multiplier_shows_as_complementarity() -> None:
    _, outcome = solved()
    open_step = int(np.argmax(outcome.nlp.variables.unpack(outcome.result.point.x)["gap"][0, :, 0]))
    found, plan, status = planted("lam", (0, open_step, 0), 0.1)
    gap = float(plan.gap[0, open_step, 0])
    assert gap > 1e-4
    assert found.complementarity == pytest.approx(0.1 * gap, rel=1e-6)
    assert found.complementarity_min == pytest.approx(min(0.1, gap), rel=1e-6)
    assert status is Status.INEXACT


def test_a_moved_multiplier_shows_as_the_laws_residual() -> None:
    found, _, status = planted("lam", (0, 3, 0), 1e-3, "barrier")
    assert found.law_residual > 1e-7
    assert status is Status.INEXACT


def test_an_input_beyond_its_bound_is_named() -> None:
    session, outcome = solved()
    found, _, _ = planted("u", (0, 7, 0), 5.0)
    u = outcome.nlp.variables.unpack(outcome.result.point.x)["u"][0, 7, 0] + 5.0
    bound = next(v for v in found.worst if v.name == "bound on u")
    assert (bound.component, bound.scenario, bound.step) == ("u", 0, 7)
    assert bound.amount == pytest.approx(u - session.values["u_max"])
    assert found.constraint_violation >= bound.amount


def test_the_worst_constraint_is_the_planted_one() -> None:
    """Scenario, step and component are right for a path and for a terminal constraint."""
    problem = get("push-disc", N=6, scenarios=3)
    x = problem.system.x
    problem = replace(
        problem,
        path=(Constraint("fence", ca.vertcat(x[0], x[3]), -10.0, 10.0),),
        terminal=(Constraint("end", x[1], -10.0, 10.0),),
    )
    session = Session(problem, Barrier(mu=1e-2), Direct(), OpenLoop())
    nlp = session.nlp_of("product")
    x_full = session.first_point(nlp).x
    bounds = nlp.bounds(session.values)
    for name, index, component in (("path", (2, 4, 1), "fence[1]"), ("terminal", (1, 0, 0), "end")):
        g = np.clip(np.zeros(nlp.m), bounds["lbg"], bounds["ubg"])
        g[nlp.constraints[name].index[index]] = 12.5
        worst = worst_constraints(nlp, x_full, g, bounds)
        assert (worst[0].name, worst[0].component) == (name, component)
        assert (worst[0].scenario, worst[0].step) == index[:2]
        assert worst[0].amount == pytest.approx(2.5)
        assert len(worst) == 1


def test_at_most_five_violations_and_the_worst_first() -> None:
    _, outcome = solved()
    nlp = outcome.nlp
    bounds = nlp.bounds(solved()[0].values)
    g = np.clip(np.zeros(nlp.m), bounds["lbg"], bounds["ubg"])
    rows = nlp.constraints["dynamics"].index[0, :9, 0]
    g[rows] = np.arange(1, 10)
    worst = worst_constraints(nlp, outcome.result.point.x, g, bounds)
    assert [v.amount for v in worst] == [9, 8, 7, 6, 5]
    assert [v.step for v in worst] == [8, 7, 6, 5, 4]


# --- penetration -----------------------------------------------------------------------------


def ring(N: int = 5) -> Problem:
    """Return a problem of a point thrown along a ring from inside, which the linearised gap lets leave the ring."""
    p = ParameterTable([Parameter("R", 1.0, "m"), Parameter("h", 0.1, "s")])
    system = time_stepping(
        "ring",
        states=signals("x [m]; y [m]; vx [m/s]; vy [m/s]"),
        inputs=signals("ux [N s]; uy [N s]"),
        contacts=signals("ring [N s]"),
        h=p["h"],
        mass=ca.SX.eye(2),
        impulse=lambda q, v, u: u,
        distance=lambda q: p["R"] - ca.norm_2(q),
        linearised=True,
        parameters=p,
    )
    effort = ca.sumsqr(system.u)
    return Problem("ring", system, N, effort, ca.SX(0), ca.SX([1.0, 0, 0, 2.0]), p)


def test_penetration_is_the_true_distance_not_the_linearised_gap() -> None:
    found = solve(ring(), Exact(), Direct(), effort="quick")
    assert found.success
    radius = np.linalg.norm(found.data["x"].values[0, :, :2], axis=1)
    assert found.data["gap"].min() > -1e-9, "the linearised gap is kept"
    assert found.audit.penetration == pytest.approx(radius.max() - 1.0, rel=1e-9)
    assert found.audit.penetration > 1e-3, "and yet the point leaves the ring"
    assert found.audit.exact_penetration == pytest.approx(found.audit.penetration, rel=1e-6)
    np.testing.assert_allclose(found.data["phi"].values[0, :, 0], 1.0 - radius, atol=1e-12)


def test_signed_distance_of_discs() -> None:
    problem = get("push-disc", N=1)
    x = np.array([[[0.0, 0.0, -0.3, 0.4], [1.0, 0.0, 0.0, 0.0]]])
    phi = Evaluation(problem, defaults(problem)).signed_distances(x)
    assert phi is not None
    np.testing.assert_allclose(phi[0, :, 0], [0.5 - 0.6, 1.0 - 0.6], atol=1e-15)


def test_a_planted_overlap_is_penetration() -> None:
    found, plan, _ = planted("x", (0, 9, 1), 0.3)
    phi = plan.x[0, :, 0] - plan.x[0, :, 1] - 0.2
    assert phi.min() < -0.1
    assert found.penetration == pytest.approx(-phi.min())


# --- task gradient and the dead end ----------------------------------------------------------


def defaults(problem: Problem) -> dict[str, float]:
    return {parameter.name: parameter.value for parameter in problem.parameters}


def test_no_contact_no_task_gradient() -> None:
    problem = get("push-1d", N=6)
    still = roll_out(problem, np.full((1, 6, 1), -0.5), defaults(problem))
    assert task_gradient(Evaluation(problem, defaults(problem)), still) == 0.0


def test_task_gradient_equals_differences() -> None:
    """On push-1d in contact, differences of rollouts give the gradient of the state's part of the cost."""
    problem, N = get("push-1d", N=6), 6
    values = defaults(problem)
    inputs = np.linspace(-0.1, 0.4, N).reshape(1, N, 1)

    def task(u: np.ndarray) -> float:
        qu = roll_out(problem, u, values).x[0, :, 0]
        return float(((qu[:-1] - 1) ** 2).sum() + 100 * (qu[-1] - 1) ** 2)

    rolled = roll_out(problem, inputs, values)
    slopes = []
    for k in range(N):
        step = np.zeros_like(inputs)
        step[0, k] = 1e-6
        slopes.append((task(inputs + step) - task(inputs - step)) / 2e-6)
    size = 2 * np.abs(rolled.x[0, :-1, 0] - 1).sum() + 200 * abs(rolled.x[0, -1, 0] - 1)
    assert np.max(np.abs(slopes)) > 1
    expected = np.max(np.abs(slopes)) / size
    assert task_gradient(Evaluation(problem, values), rolled) == pytest.approx(expected, rel=1e-6)


@pytest.mark.one_case_in(4)
@pytest.mark.parametrize("method", [MultipleShooting(), SingleShooting()])
@pytest.mark.parametrize(("name", "cost"), [("push-1d", 120.0), ("push-disc", 12.75)])
def test_the_dead_end_of_the_exact_law_is_no_success(name: str, cost: float, method) -> None:
    found = solve(get(name), Exact(), method, settings={"homotopy": False})
    assert found.cost == pytest.approx(cost), "nothing has moved"
    assert found.status is Status.NO_PROGRESS
    assert not found.success
    assert (found.audit.active_steps, found.audit.task_gradient) == (0, 0.0)
    assert codes(found)[:3] == ["contacts-never-act", "status", "no-homotopy"]


@pytest.mark.one_case_in(2)
@pytest.mark.parametrize("method", [MultipleShooting(), SingleShooting()])
def test_the_homotopy_leads_out_of_the_dead_end(method) -> None:
    found = solve(get("push-1d"), Exact(), method, settings={"homotopy": True})
    assert found.audit.active_steps > 0 and np.isnan(found.audit.task_gradient)
    assert found.audit.exact_cost < 1.5


# --- what a solver says is judged ------------------------------------------------------------


def test_a_solver_that_lies_is_not_believed() -> None:
    session, outcome = solved()
    lie = replace(outcome.result, point=Point(np.zeros(outcome.nlp.n)))
    found = judge_outcome(session, replace(outcome, result=lie), seed=0)
    assert lie.ok
    assert found.status is Status.INEXACT
    assert not found.success
    assert found.verdict.startswith("Not solved")


@pytest.mark.costly
def test_an_infeasible_problem_says_what_cannot_be_met() -> None:
    problem = get("push-1d", N=6)
    end = Constraint("reach", problem.system.x[0], 50.0, 60.0)
    problem = replace(problem, terminal=(end,))
    for law in (Barrier(mu=1e-3), Exact()):
        found = solve(problem, law, Direct())
        assert found.status in (Status.INFEASIBLE, Status.ITERATION_LIMIT, Status.FAILED)
        assert not found.success
        assert found.verdict.startswith("Not converged")
        assert found.audit.worst
        amounts = [violation.amount for violation in found.audit.worst]
        assert amounts == sorted(amounts, reverse=True)
        assert amounts[0] > 1e-3


def test_infeasible_in_shooting_names_the_terminal_constraint() -> None:
    problem = get("push-1d", N=6)
    end = Constraint("reach", problem.system.x[0], 50.0, 60.0)
    found = solve(replace(problem, terminal=(end,)), Barrier(mu=1e-3), SingleShooting())
    assert not found.success
    worst = found.audit.worst[0]
    assert (worst.name, worst.component) == ("terminal", "reach")
    assert worst.amount == pytest.approx(50.0 - found.data["x"].values[0, -1, 0])
