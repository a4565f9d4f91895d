"""Solutions near rollouts: a plan is solved on its branch, with its contacts fixed, then on neighbouring branches."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ocp.errors import NotConverged
from ocp.judge.constraints import broken_constraints
from ocp.judge.route_report import NOT_BETTER, SearchedPlan
from ocp.problem.rollout import Rollout, roll_out
from ocp.programs.solver import Point, Result, Status
from ocp.routes.branches import Branches
from ocp.routes.homotopy import Homotopy, Progress, Trace
from ocp.routes.pieces import NearbySolvers
from ocp.routes.rollouts import pack_rollout
from ocp.routes.session import Session
from ocp.search.search import Judge, can_roll_out, replay_limit
from ocp.solution import Solution

ITERATIONS = 100
"""Maximum number of solver iterations on the branch of a plan."""
REPLAYS = 3
"""Maximum number of branches solved for a plan; after the first, each is the branch of the previous replay."""
REPLAY = "replay"
"""Route of a solution that is the replay of another one."""
REPEATED_SHARE = 1e-4
"""Relative gain up to which a plan repeats another one: replays cost up to so much more or less than their plans."""
SAME_STATES = 1e-3
"""Largest difference of states, in characteristic sizes, for which a replay agrees with its plan."""


def exact_rollout(session: Session, inputs: np.ndarray) -> Rollout | None:
    """Return the exact rollout of inputs (N, nu), or None if a step is not solved."""
    try:
        return roll_out(session.problem, inputs[None], session.values)
    except NotConverged:
        return None


class Settled(NamedTuple):
    """Rollout, the solution near it or None, the largest difference of its replay's states, and its solver."""

    plan: Rollout
    answer: Result | None
    difference: float
    solver: Branches


def replay_of_inputs(session: Session, solution: Solution, judge: Judge, seed: int) -> list[Solution]:
    """Return the exact rollout of a solution's inputs as a judged solution, if the solution fails at its own step.

    A plan in unstable contact differs from its replay, which costs the same and replays as it is. The list is empty if
    inputs do not determine a plan, or the rollout violates a constraint.
    """
    if not (solution.fails_at_its_step and can_roll_out(session)):
        return []
    rollout = exact_rollout(session, solution.arrays["u"][0])
    if rollout is None or broken_constraints(session.evaluation, rollout):
        return []
    branches = Branches(Homotopy(session.nlp_of, session.solver, session.values))
    outcome = branches.result_of_problem(rolled_out(branches, rollout))
    return [judge(session, replace(outcome, route=REPLAY), seed)]


def rolled_out(branches: Branches, plan: Rollout) -> Result:
    """Return a plan's rollout as a result, unsolved and without multipliers."""
    point = Point(pack_rollout(branches.program, plan, None))
    return Result.at(branches.program, point, branches.p, Status.SOLVED, "rolled out")


@dataclass(frozen=True)
class PlanSolver:
    """Solver of a session's problem near given rollouts.

    ``roll_out`` maps inputs (N, nu) to their rollout, or to None if a step is not solved.
    ``route`` is the name of the route in reports. Under the exact law only plans that cost less than ``cost_limit``
    are judged; ``tried`` lists all plans, with the positions of pushers, which are the last ``n_pushers`` states.
    """

    session: Session
    roll_out: Callable[[np.ndarray], Rollout | None]
    judge: Judge
    route: str
    seed: int = 0
    progress: Progress | None = None
    cost_limit: float = np.inf
    tried: list[SearchedPlan] = field(default_factory=list)
    n_pushers: int = 0

    def solve(self, plans: Iterable[Rollout]) -> Iterator[tuple[Rollout, Solution]]:
        """Yield each plan with its judged solution, improved on neighbouring branches, the cheapest first.

        If the improved solution does not survive the referee, the unimproved solution is yielded too. The plan's
        rollout is yielded as well if it costs less than all solutions so far, and so is the rollout of a
        solution that fails the referee at its own step. Under a law other than the exact one, or
        another method, plans are guesses of the law's own route.
        """
        session = self.session
        if not session.complementary:
            for plan in plans:
                outcome = session.solve(guess=(plan.x[0], plan.u[0]), progress=self.progress)
                yield plan, self._listed(plan, self.judge(session, outcome, self.seed))
            return
        nearby = NearbySolvers(Homotopy(session.nlp_of, session.solver, session.values, self.progress))
        branches = nearby.branches
        settled = [self._settle(nearby, plan) for plan in plans]
        limit = self.cost_limit
        for plan, answer, _, solver in sorted(settled, key=_order):
            rollouts = [plan]
            if answer is not None:
                improved = solver.improve(answer)
                cost = improved.f + branches.program.constant(branches.p)
                if is_less(cost, limit):
                    solution = self._judge(solver, improved)
                    yield plan, self._listed(plan, solution)
                    if solution.referee.survives is False and improved is not answer:
                        yield plan, self._listed(plan, self._judge(solver, answer))
                    limit = min(limit, replay_limit(solution))
                    if solution.referee.survives_at_h is False:
                        # The replay of its inputs is another plan, which replays as it is.
                        replay = self.roll_out(solution.arrays["u"][0])
                        rollouts += [] if replay is None else [replay]
                else:
                    self._list(plan, cost, NOT_BETTER)
            for rollout in sorted(rollouts, key=lambda rollout: rollout.cost):
                if is_less(rollout.cost, limit) and not broken_constraints(session.evaluation, rollout):
                    solution = self._judge(branches, rolled_out(branches, rollout))
                    yield rollout, self._listed(rollout, solution)
                    limit = min(limit, replay_limit(solution))

    def _listed(self, plan: Rollout, solution: Solution) -> Solution:
        self._list(plan, solution.cost, solution.status.label, solution.referee.survives)
        return solution

    def _list(self, plan: Rollout, cost: float, status: str, survives: bool | None = None) -> None:
        x = plan.x[0]
        pushers = x[:, x.shape[1] - self.n_pushers :].tolist() if self.n_pushers else []
        self.tried.append(SearchedPlan(plan.cost, cost, status, survives, pushers))

    def _settle(self, nearby: NearbySolvers, plan: Rollout) -> Settled:
        """Return the solution on a plan's branch and the largest difference of its replay's states, in their sizes.

        If states differ, the branch of the replay is solved next. The solution is None if the first branch has none.
        """
        settled, rollout = None, plan
        for _ in range(REPLAYS):
            point = Point(pack_rollout(nearby.branches.program, rollout, None))
            solver, answer = nearby.solve(point, ITERATIONS)
            if answer is None:
                break
            blocks = solver.program.variables.unpack(answer.point.x)
            replay = self.roll_out(blocks["u"][0])
            if replay is None:
                settled = settled or Settled(plan, answer, np.inf, solver)
                break
            difference = float((np.abs(replay.x[0, 1:] - blocks["x"][0]) / self.session.problem.scales.x).max())
            settled, rollout = Settled(plan, answer, difference, solver), replay
            if difference < SAME_STATES:
                break
        return settled or Settled(plan, None, np.inf, nearby.branches)

    def _judge(self, solver: Branches, answer: Result) -> Solution:
        """Return the judged solution of an outcome; it counts all solver work since the previous one."""
        outcome = replace(solver.result_of_problem(answer), route=self.route)
        solver.follower.trace = Trace()
        return self.judge(self.session, outcome, self.seed)


def _order(settled: Settled) -> tuple[bool, float]:
    """Return the sort key of a solution: solutions that agree with their replay come first, then lower costs."""
    cost = settled.plan.cost if settled.answer is None else settled.answer.f
    return settled.difference > SAME_STATES, cost


def is_less(cost: float, limit: float) -> bool:
    """Return whether a cost is below ``limit`` by more than the relative amount :data:`REPEATED_SHARE`."""
    return cost < limit and (np.isinf(limit) or limit - cost > REPEATED_SHARE * abs(limit))
