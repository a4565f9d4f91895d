"""Searches for plans better than the plan of the usual route: along other routes, and near a user's guess."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from dynamics.contact import Barrier
from ocp.errors import NotConverged
from ocp.problem.sketch import UserGuess
from ocp.programs.solver import Point
from ocp.routes.homotopy import Homotopy, RouteResult, translate
from ocp.routes.pieces import polish
from ocp.routes.relaxations import MU_LAST
from ocp.search.plan_solver import PlanSolver, exact_rollout, is_less
from ocp.search.search import (
    FEW_PAIRS,
    OTHER_ROUTES,
    SAMPLED,
    Search,
    can_roll_out,
    cost_to_beat,
    is_doubtful,
    is_poor,
    replay_cost,
)
from ocp.solution import Solution
from ocp.transcription import Direct

SEARCHED = ("guess", SAMPLED)
"""Names of routes whose solutions are from a search."""


@dataclass
class GuessSearch(Search):
    """Search near a user's ``guess``: its rollout is solved on its branch, since a large relaxation would leave it.

    For a sketch, Scholtes's relaxation finds inputs within its windows, and so does the barrier law unless the sketch
    has contacts: each finds plans that the other does not. On the nail of
    ``tests/golden/cases/test_plans_worth_having.py`` one keyframe of the hammer drawn back, two keyframes, or the steps
    of the blow reduce the cost from 1.208 to 0.027, 0.029 and 0.030 in two seconds.
    """

    guess: UserGuess = field(kw_only=True)

    def is_needed(self, solution: Solution) -> bool:
        """Return whether the guess has windows in a complementarity problem, or inputs that determine a plan alone."""
        return self.session.complementary if self.guess.windows else can_roll_out(self.session)

    def solutions(self, answer: Solution) -> Iterator[Solution]:
        """Yield solutions better than ``answer`` on the branches of the guess's rollouts, and the rollouts."""
        if not self.guess.windows:
            yield from _solutions_near_rollouts(self, "guess", answer, [self.guess.trajectories[1]])
            return
        outcomes = [outcome for outcome in self.within_windows() if outcome.finished]
        if not outcomes:
            raise NotConverged("no plan was found that passes the keyframes of the guess with its contacts")
        if can_roll_out(self.session):
            inputs = [outcome.nlp.variables.unpack(outcome.result.point.x)["u"][0] for outcome in outcomes]
            yield from _solutions_near_rollouts(self, "guess", answer, inputs)
            return
        session = self.session
        for outcome in outcomes:
            follower = Homotopy(session.nlp_of, session.solver, session.values, self.progress)
            released = polish(follower, outcome.nlp, outcome.result)
            if released.finished:
                yield self.judge(session, replace(released, route="guess"), self.seed)

    def within_windows(self) -> Iterator[RouteResult]:
        """Yield outcomes within the windows of the guess, by Scholtes's relaxation and by the barrier law."""
        session, windows = self.session, self.guess.windows
        changes: list[dict[str, Any]] = [{"strategy": "scholtes"}]
        changes += [] if "gap" in windows else [{"law": Barrier(mu=MU_LAST)}]
        for change in changes:
            narrowed = session.with_changes(windows=windows, **change)
            yield narrowed.solve(guess=self.guess.trajectories, progress=self.progress)


@dataclass
class RouteSearch(Search):
    """Search by Scholtes's relaxation, by solving the exact law from the barrier law's plan, and near its rollout."""

    thorough: bool = True

    def is_needed(self, solution: Solution) -> bool:
        """Return whether to follow other routes.

        Other routes are followed at thorough effort, if a solution cheaper than that of the usual route is likely, or
        if samples gave a better solution and the problem has few contact pairs.
        """
        if solution.route.name in SEARCHED:
            led_nowhere = solution.route.name == SAMPLED and self.session.problem.system.nlam <= FEW_PAIRS
        else:
            led_nowhere = is_doubtful(solution)
        return self.session.complementary and (self.thorough or led_nowhere)

    def solutions(self, answer: Solution) -> Iterator[Solution]:
        """Yield solutions of other routes that cost less than ``answer``, or all solutions if it has no certificate.

        Beside sampled plans, Scholtes's relaxation is followed alone, except at thorough effort.
        """
        session, best = self.session, answer
        scholtes, barrier_start, near_rollout = OTHER_ROUTES
        # Followed to its end, unlike the further paths of every solve: a dearer plan may be cheaper in its replay.
        outcome = session.with_changes(strategy="scholtes").solve(progress=self.progress)
        best = yield from self._judged_if_better(outcome, scholtes, best)
        if answer.route.name == SAMPLED and not self.thorough:
            return
        smoothed = session.sub_session(Barrier(mu=MU_LAST), Direct()).solve(progress=self.progress)
        nlp = session.nlp_of("product")
        x = translate(smoothed.result.point, smoothed.nlp, nlp).x
        best = yield from self._judged_if_better(session.resume(Point(x), self.progress), barrier_start, best)
        if smoothed.finished and can_roll_out(session):
            inputs = smoothed.nlp.variables.unpack(smoothed.result.point.x)["u"][0]
            yield from _solutions_near_rollouts(self, near_rollout, best, [inputs])

    def _judged_if_better(self, outcome: RouteResult, name: str, best: Solution) -> Generator[Solution, None, Solution]:
        """Yield the solution of an outcome that is better than ``best``, and return the better one by its replay."""
        if not (outcome.finished and self._is_better(outcome, best)):
            return best
        solution = self.judge(self.session, replace(outcome, route=name), self.seed)
        yield solution
        return min(best, solution, key=replay_cost)

    @staticmethod
    def _is_better(outcome: RouteResult, best: Solution) -> bool:
        p = outcome.nlp.parameter_vector(best.values)
        return is_poor(best) or is_less(outcome.result.f + outcome.nlp.constant(p), best.cost)


def _solutions_near_rollouts(
    search: Search, name: str, best: Solution, inputs: Sequence[np.ndarray]
) -> Iterator[Solution]:
    """Yield solutions cheaper than ``best``: rollouts of inputs (N, nu), and solutions on the rollouts' branches."""
    limits = search.session.evaluation.limits
    roll_out = partial(exact_rollout, search.session)
    rollouts = (roll_out(np.clip(plan_inputs, limits.u_lower, limits.u_upper)) for plan_inputs in inputs)
    plans = [plan for plan in rollouts if plan is not None]
    limit = cost_to_beat(best)
    solver = PlanSolver(search.session, roll_out, search.judge, name, search.seed, search.progress, limit)
    yield from (solution for _, solution in solver.solve(plans))
