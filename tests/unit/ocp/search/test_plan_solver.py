"""Plans solved one after another: which of them are judged, by the cost that is to be beaten."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from ocp.judge.referee import RefereeReport
from ocp.problem.rollout import Rollout
from ocp.routes.homotopy import RouteResult
from ocp.routes.session import Session
from ocp.search.plan_solver import PlanSolver, exact_rollout
from ocp.search.search import cost_to_beat, replay_limit
from ocp.solution import Solution
from ocp.solve.judging import judge_outcome
from tests.golden.known import session_of


@pytest.mark.one_case_in(2)
@pytest.mark.parametrize("fails", [False, True])
def test_a_plan_through_a_body_hides_no_other_plan(fails: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two plans on one branch have one solution; it is judged again only if the first one is never chosen."""
    monkeypatch.setattr(Solution, "fails_at_its_step", property(lambda _: fails))
    session = session_of("wall-1d")
    roll_out = partial(exact_rollout, session)
    plans = [roll_out(np.full((session.problem.N, 1), force)) for force in (-0.2, -0.25)]
    solver = PlanSolver(session, roll_out, judge_outcome, "sampling")
    solutions = [solution for _, solution in solver.solve(plan for plan in plans if plan is not None)]
    costs = {f"{solution.cost:.6g}" for solution in solutions if solution.certificate.certified}
    assert len(costs) == 1
    certified = [solution for solution in solutions if solution.certificate.certified]
    assert len(certified) == (2 if fails else 1)
    limit = np.inf if fails else solutions[0].audit.exact_cost
    assert replay_limit(solutions[0]) == cost_to_beat(certified[0]) == limit


def test_a_plan_whose_solution_replays_at_a_higher_cost_is_judged_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """In unstable contact the replay of the solution's inputs leaves the plan; the sampled rollout does not."""
    monkeypatch.setattr(RefereeReport, "survives_at_h", property(lambda _: False))
    session = session_of("wall-1d")
    inputs = np.full((session.problem.N, 1), -0.2)
    plan, dearer = (exact_rollout(session, each) for each in (inputs, -inputs))
    assert plan is not None and dearer is not None and plan.cost < dearer.cost

    def roll_out(u: np.ndarray) -> Rollout:
        return plan if np.array_equal(u, inputs) else dearer

    def judge_as_unstable(session: Session, outcome: RouteResult, seed: int) -> Solution:
        solution = judge_outcome(session, outcome, seed)
        cost = roll_out(solution.arrays["u"][0]).cost
        return replace(solution, audit=replace(solution.audit, exact_cost=cost))

    solver = PlanSolver(session, roll_out, judge_as_unstable, "sampling")
    near, itself = (solution for _, solution in solver.solve([plan]))
    assert near.cost < plan.cost < near.audit.exact_cost
    np.testing.assert_array_equal(itself.arrays["u"][0], inputs)
    assert itself.audit.exact_cost == plan.cost
