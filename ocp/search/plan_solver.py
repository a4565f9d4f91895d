"""From a rollout to an answer: the branch of its own contacts is solved, then neighbouring ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from ocp.problem.rollout import Rollout
from ocp.programs.solver import Point, Result
from ocp.routes.branches import Branches
from ocp.routes.homotopy import Homotopy, Progress, RouteResult, Trace
from ocp.routes.rollouts import pack_rollout
from ocp.routes.session import Session
from ocp.solution import Solution

ITERATIONS = 100
"""Iterations of the solver on a plan's branch, after which it is given up."""
REPLAYS = 3
"""Branches solved one from the replay of another."""
SAME_STATES = 1e-3
"""Difference of states, in characteristic sizes, up to which a replay is the plan."""


@dataclass(frozen=True)
class PlanSolver:
    """Solves a session near given rollouts.

    ``roll_out`` maps inputs (N, nu) to their rollout, or to None where a step is not solved.
    ``judge`` makes a solution of a session's outcome and ``seed``; ``route`` names the outcomes.
    """

    session: Session
    roll_out: Callable[[np.ndarray], Rollout | None]
    judge: Callable[[Session, RouteResult, int], Solution]
    route: str
    seed: int = 0
    progress: Progress | None = None

    def solve(self, plans: Iterable[Rollout]) -> Iterator[tuple[Rollout, Solution]]:
        """Yield plans with what their branches give, the cheapest first, each improved in its turn.

        The unimproved answer follows where the improved one does not survive. Under another law than the exact
        one, or another method, plans are guesses of the law's own route.
        """
        session = self.session
        if not session.complementary:
            for plan in plans:
                outcome = session.solve(guess=(plan.x[0], plan.u[0]), progress=self.progress)
                yield plan, self.judge(session, outcome, self.seed)
            return
        branches = Branches(Homotopy(session.nlp_of, session.solver, session.values, self.progress))
        answers = [(plan, *answer) for plan in plans if (answer := self._settle(branches, plan)) is not None]
        for plan, answer, _ in sorted(answers, key=lambda each: (each[2] > SAME_STATES, each[1].f)):
            improved = branches.improve(answer)
            solution = self._judge(branches, improved)
            yield plan, solution
            if solution.referee.survives is False and improved is not answer:
                yield plan, self._judge(branches, answer)

    def _settle(self, branches: Branches, plan: Rollout) -> tuple[Result, float] | None:
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
        return settled

    def _judge(self, branches: Branches, answer: Result) -> Solution:
        """Judge an answer; the work so far counts as its own."""
        trace, branches.follower.trace = branches.follower.trace, Trace()
        outcome = RouteResult(answer, branches.program, True, trace, route=self.route)
        return self.judge(self.session, outcome, self.seed)
