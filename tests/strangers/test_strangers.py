"""Problems as users write them: each loads, its best known plan solves the task, and inactivity does not."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics.contact import Exact
from ocp.judge.referee import referee_plan
from ocp.problem.evaluation import Evaluation
from ocp.problem.policy import OpenLoop
from ocp.problem.rollout import roll_out
from ocp.routes.session import Session
from ocp.transcription import Direct
from problems import get
from tests.benchmarks.found.problems import best_plan, module_of, problem_files, problem_names, source_of
from tests.benchmarks.found.sampled import problem_of

ROOT = problem_files()["hammer"].parents[3]


@pytest.mark.cheap_cases("slack_tether", "two_blocks", "juggle_twice")
@pytest.mark.parametrize("name", problem_files())
def test_the_best_known_plan_does_the_task_and_holding_still_does_not(name: str) -> None:
    problem, module, plan = get(str(ROOT / source_of(name))), module_of(name), best_plan(name)
    assert plan is not None
    values = dict(zip(problem.parameters.names, map(float, problem.parameters.values), strict=True))
    evaluation = Evaluation(problem, values)
    inputs = np.stack([plan.inputs, np.broadcast_to(evaluation.limits.u_before, np.shape(plan.inputs))])
    start = np.tile(plan.start or evaluation.initial_states[0], (2, 1))
    rollout = roll_out(problem, inputs, values, x0=start)
    reached = [module.reached(module.Params(), states[-1]) for states in rollout.x]
    assert reached == [True, False]
    assert rollout.costs[0] == pytest.approx(plan.cost, rel=0.01)


@pytest.mark.cheap_cases("two_blocks", "push-box")
@pytest.mark.parametrize("name", problem_names())
def test_the_referee_accepts_the_best_known_plan(name: str) -> None:
    """No constraint is violated, in impulses and between nodes either, and no body passes through another."""
    problem, plan = problem_of(name), best_plan(name)
    assert plan is not None
    session = Session(problem, Exact(), Direct(), OpenLoop())
    start = None if plan.start is None else np.array([plan.start])
    rollout = roll_out(problem, np.array([plan.inputs]), session.values, x0=start)
    report, _ = referee_plan(session.evaluation, session.step, rollout, None)
    assert report.survives_at_h, report.findings
