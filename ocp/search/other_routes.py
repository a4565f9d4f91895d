"""Answers of other routes, and of a user's guess on its own contacts, beside that of the usual route."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from dynamics.contact import Barrier
from ocp.problem.rollout import InitialGuess, Rollout
from ocp.programs.solver import Point, Status
from ocp.routes.homotopy import RouteResult, translate
from ocp.routes.relaxations import MU_LAST
from ocp.search.plan_solver import PlanSolver, exact_rollout, is_less
from ocp.search.search import Search, can_roll_out
from ocp.search.shortfalls import idles
from ocp.solution import Solution
from ocp.transcription import Direct


@dataclass
class GuessSearch(Search):
    """A user's ``guess``, rolled out exactly and solved near itself: a wide relaxation forgets it."""

    guess: InitialGuess = field(kw_only=True)

    def wanted(self, solution: Solution) -> bool:
        """Return whether the guess's inputs alone make a plan of the complementarity problem."""
        return can_roll_out(self.session)

    def solutions(self, answer: Solution) -> Iterator[Solution]:
        """Yield the answers on the branch of the guess's rollout, and the rollout itself, that are better."""
        limits = self.session.evaluation.limits
        roll_out = partial(exact_rollout, self.session)
        plan = roll_out(np.clip(self.guess[1], limits.u_lower, limits.u_upper))
        yield from _near(self, "guess", answer, plan)


@dataclass
class RouteSearch(Search):
    """The relaxation of Scholtes, and the barrier law's plan as a start of the exact law."""

    thorough: bool = True

    def wanted(self, solution: Solution) -> bool:
        """Return whether other routes are followed: at thorough effort, or where the usual one led nowhere."""
        led_nowhere = not solution.certificate.certified or solution.status is Status.NO_PROGRESS or idles(solution)
        return self.session.complementary and (self.thorough or led_nowhere)

    def solutions(self, answer: Solution) -> Iterator[Solution]:
        """Yield the answers that are better."""
        session, best = self.session, answer
        barrier = session.sub_session(Barrier(mu=MU_LAST), Direct())
        smoothed = barrier.solve(progress=self.progress)
        nlp = session.nlp_of("product")
        x = translate(smoothed.result.point, smoothed.nlp, nlp).x
        scholtes = replace(session, strategy="scholtes")
        scholtes.values |= session.values
        ways = (
            ("scholtes", lambda: scholtes.solve(progress=self.progress)),
            ("barrier start", lambda: session.resume(Point(x), self.progress)),
        )
        for name, follow in ways:
            outcome = follow()
            if outcome.finished and self._is_better(outcome, best):
                solution = self.judge(session, replace(outcome, route=name), self.seed)
                best = min(best, solution, key=lambda each: each.audit.exact_cost)
                yield solution
        if smoothed.finished and can_roll_out(session):
            plan = exact_rollout(session, smoothed.nlp.variables.unpack(smoothed.result.point.x)["u"][0])
            yield from _near(self, "barrier contacts", best, plan)

    @staticmethod
    def _is_better(outcome: RouteResult, best: Solution) -> bool:
        p = outcome.nlp.parameter_vector(best.values)
        return not best.certificate.certified or is_less(outcome.result.f + outcome.nlp.constant(p), best.cost)


def _near(search: Search, name: str, best: Solution, plan: Rollout | None) -> Iterator[Solution]:
    """Yield what a plan and its branch give that is better than the best answer so far."""
    if plan is None:
        return
    limit = best.audit.exact_cost if best.certificate.certified else np.inf
    roll_out = partial(exact_rollout, search.session)
    solver = PlanSolver(search.session, roll_out, search.judge, name, search.seed, search.progress, limit)
    yield from (solution for _, solution in solver.solve([plan]))
