"""A problem of millimetres is judged in millimetres, even if it states no characteristic sizes."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Barrier
from dynamics.systems import ParameterTable, quasi_dynamic, signals, time_stepping
from ocp import Constraint, Problem, solve
from ocp.judge.measures import measure
from ocp.judge.referee import Referee, survival_findings
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import Rollout
from tests.findings import numbers

SCALES = [1.0, 1e-3]


@pytest.mark.parametrize("length", SCALES)
def test_a_flight_through_a_body_does_not_survive_however_small_the_body(length: float) -> None:
    """One step leads from -0.5 to 0.5 across a disc of radius 0.2, which neither node touches."""
    p = ParameterTable([])
    system = time_stepping(
        "flight",
        states=signals("x [m]; y [m]; vx [m/s]; vy [m/s]"),
        inputs=signals("fx [N]; fy [N]"),
        contacts=signals("post [N s]"),
        mass=ca.SX.eye(2),
        impulse=lambda q, v, u: 0.1 * u,
        distance=lambda q: ca.norm_2(q) - 0.2 * length,
        h=0.1,
        parameters=p,
    )
    problem = Problem("flight", system, 2, ca.SX(0), ca.SX(0), ca.SX.zeros(4), p)
    x = length * np.array([[[-0.5, 0, 10, 0], [0.5, 0, 10, 0], [1.5, 0, 10, 0]]])
    u, one = np.zeros((1, 2, 2)), np.zeros((1, 2, 1))
    plan = Rollout(x, u, one, one, one, np.zeros(1))
    replay = Referee(plan, 0.0, None, "the model itself", np.nan, "")
    found = measure(Evaluation(problem, {}), problem.exact_step, plan)
    (reason,) = survival_findings(Evaluation(problem, {}), plan, replay, found, [])
    assert reason.sentence == f"post is penetrated by {0.2 * length:.2g} at step 0"


@pytest.mark.costly_cases("0.001")
@pytest.mark.parametrize("length", SCALES)
def test_a_hard_end_that_only_smoothing_meets_is_named_at_any_size(length: float) -> None:
    """At mu = 0.1 a force at a distance moves the body to 0.3; the exact replay ends elsewhere."""
    system = quasi_dynamic(
        "line",
        states=signals("x [m]; a [m]"),
        inputs=signals("u [m]"),
        contacts=signals("push [N s]"),
        h=0.1,
        mass=ca.SX.eye(1),
        stiffness=50.0 * ca.SX.eye(1),
        distance=lambda q: q[0] - q[1] - 0.1 * length,
        parameters=ParameterTable([]),
    )
    du = ca.SX.sym("du")
    problem = Problem(
        "line",
        system,
        10,
        0.1 * (du / length) ** 2,
        ca.SX(0),
        ca.SX([0, -0.5 * length]),
        ParameterTable([]),
        du=du,
        u_before=ca.SX([-0.5 * length]),
        terminal=[Constraint("at", system.x[0], 0.3 * length, 0.3 * length)],
    )
    found = solve(problem, Barrier(mu=0.1 * length**2))
    assert found.success and found.referee.survives is False
    assert numbers(found, "constraint-violated")["constraint"] == "terminal constraint at"
