"""Plans solved one after another: which of them are judged, by the cost that is to be beaten."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from ocp.search.plan_solver import PlanSolver, exact_rollout
from ocp.search.search import cost_to_beat, replay_limit
from ocp.solution import Solution
from ocp.solve.judging import judge_outcome
from tests.golden.known import session_of


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
