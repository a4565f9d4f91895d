"""From a rollout to an answer: the branch of its own contacts is solved, then neighbouring ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from ocp.errors import NotConverged
from ocp.judge.constraints import broken_constraints
from ocp.judge.route_report import NOT_BETTER, SearchedPlan
from ocp.problem.rollout import Rollout, roll_out
from ocp.programs.solver import Point, Result, Status
from ocp.routes.branches import Branches
from ocp.routes.homotopy import COST_GAIN, Homotopy, Progress, RouteResult, Trace
from ocp.routes.rollouts import pack_rollout
from ocp.routes.session import Session
from ocp.search.search import Judge
from ocp.solution import Solution

ITERATIONS = 100
"""Iterations of the solver on a plan's branch, after which it is given up."""
REPLAYS = 3
"""Branches solved one from the replay of another."""
SAME_STATES = 1e-3
"""Difference of states, in characteristic sizes, up to which a replay is the plan."""


def exact_rollout(session: Session, inputs: np.ndarray) -> Rollout | None:
    """Return the exact rollout of inputs (N, nu), or None where a step is not solved."""
    try:
        return roll_out(session.problem, inputs[None], session.values)
    except NotConverged:
        return None


@dataclass(frozen=True)
class PlanSolver:
    """Solves a session near given rollouts.

    ``roll_out`` maps inputs (N, nu) to their rollout, or to None where a step is not solved.
    ``route`` names the outcomes. Under the exact law no plan is judged that costs as much as ``cost_limit``;
    ``tried`` lists all of them.
    """

    session: Session
    roll_out: Callable[[np.ndarray], Rollout | None]
    judge: Judge
    route: str
    seed: int = 0
    progress: Progress | None = None
    cost_limit: float = np.inf
    tried: list[SearchedPlan] = field(default_factory=list)

    def solve(self, plans: Iterable[Rollout]) -> Iterator[tuple[Rollout, Solution]]:
        """Yield plans with what their branches give, the cheapest first, each improved in its turn.

        The unimproved answer follows where the improved one does not survive, and the plan itself where its branch
        has no answer that its replay keeps. Under another law than the exact one, or another method, plans are
        guesses of the law's own route.
        """
        session = self.session
        if not session.complementary:
            for plan in plans:
                outcome = session.solve(guess=(plan.x[0], plan.u[0]), progress=self.progress)
                yield plan, self._listed(plan, self.judge(session, outcome, self.seed))
            return
        branches = Branches(Homotopy(session.nlp_of, session.solver, session.values, self.progress))
        settled = [(plan, *self._settle(branches, plan)) for plan in plans]
        limit = self.cost_limit
        for plan, answer, difference in sorted(settled, key=lambda each: _order(*each)):
            follows = False
            if answer is not None:
                improved = branches.improve(answer)
                cost = improved.f + branches.program.constant(branches.p)
                follows = difference <= SAME_STATES
                if is_less(cost, limit):
                    solution = self._judge(branches, improved)
                    yield plan, self._listed(plan, solution)
                    if solution.referee.survives is False and improved is not answer:
                        yield plan, self._listed(plan, self._judge(branches, answer))
                    limit = min(limit, solution.audit.exact_cost)
                else:
                    self.tried.append(SearchedPlan(plan.cost, cost, NOT_BETTER, None))
            if not follows and is_less(plan.cost, limit) and not broken_constraints(session.evaluation, plan):
                yield plan, self._listed(plan, self._judge(branches, self._rolled_out(branches, plan)))
                limit = plan.cost

    def _listed(self, plan: Rollout, solution: Solution) -> Solution:
        survives = solution.referee.survives
        self.tried.append(SearchedPlan(plan.cost, solution.cost, solution.status.label, survives))
        return solution

    def _settle(self, branches: Branches, plan: Rollout) -> tuple[Result | None, float]:
        """Return the answer on a plan's branch, or on that of its replay where contacts differ there.

        With it comes by how much the states of its replay differ, in characteristic sizes.
        """
        settled, program = None, branches.program
        for _ in range(REPLAYS):
            answer = branches.solve_branch(Point(pack_rollout(program, plan, None)), ITERATIONS)
            if answer is None:
                break
            blocks = program.variables.unpack(answer.point.x)
            replay = self.roll_out(blocks["u"][0])
            if replay is None:
                settled = settled or (answer, np.inf)
                break
            difference = np.abs(replay.x[0, 1:] - blocks["x"][0]) / self.session.problem.scales.x
            settled, plan = (answer, float(difference.max())), replay
            if difference.max() < SAME_STATES:
                break
        return settled or (None, np.inf)

    @staticmethod
    def _rolled_out(branches: Branches, plan: Rollout) -> Result:
        """Return a plan's rollout as it is; the certificate says what it is worth."""
        point = Point(pack_rollout(branches.program, plan, None))
        return Result.at(branches.program, point, branches.p, Status.SOLVED, "rolled out")

    def _judge(self, branches: Branches, answer: Result) -> Solution:
        """Judge an answer; the work so far counts as its own."""
        trace, branches.follower.trace = branches.follower.trace, Trace()
        outcome = RouteResult(answer, branches.program, True, trace, route=self.route)
        return self.judge(self.session, outcome, self.seed)


def _order(plan: Rollout, answer: Result | None, difference: float) -> tuple[bool, float]:
    """Order answers that their replay keeps by their cost, then the others."""
    return difference > SAME_STATES, plan.cost if answer is None else answer.f


def is_less(cost: float, limit: float) -> bool:
    """Return whether a cost is less than another by more than rounding."""
    return cost < limit and (np.isinf(limit) or limit - cost > COST_GAIN * abs(limit))
