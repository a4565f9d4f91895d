"""Table of the routes that solve a session's problem; the first route that accepts the session is used."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

from dynamics.contact import Barrier, Exact
from ocp.errors import NotConverged, choose
from ocp.problem.policy import Feedback
from ocp.problem.rollout import Gains, InitialGuess, Rollout
from ocp.programs.solver import Point, Result
from ocp.routes.complementarity import (
    AFTER_FAILURE,
    ALTERNATIVES,
    FALLBACK,
    FALLBACK_SMALL,
    FURTHER_PATHS,
    QUICK_PATIENCE,
    RELAXATIONS,
    SMALL_ITERATIONS,
    SMALL_PAIRS,
    RelaxationPlan,
    solve_pairs,
)
from ocp.routes.homotopy import IPOPT_PRIMAL_WARM_START, Homotopy, HomotopyStage, RouteResult, better, lower, translate
from ocp.routes.pieces import polish
from ocp.routes.relaxations import DEFAULT_STRATEGY, MU_LAST, STAGE_ITERATIONS, STRATEGIES, from_exact, inexact, relaxed
from ocp.routes.rollouts import RolloutPolish, RolloutStarts, pack_rollout
from ocp.transcription import Direct
from ocp.transcription.nlp import NLP

if TYPE_CHECKING:
    from ocp.routes.session import Session

NEAR_RELAXATION = 1e-6
"""Relaxation of lam gap, in characteristic units, for a start that is near a solution."""
FAR_RELAXATIONS = (1e-3, 3e-5)
"""Relaxations of lam gap, in characteristic units, for other starts."""
_DIVERGED = 1e-3
"""Relative increase of the cost above which a rollout has diverged from its plan."""


@dataclass(frozen=True)
class Start:
    """Start of a solve: from a ``guess``, or warm from a ``point`` of the product NLP.

    ``number`` is the index among several guesses. A ``near`` point is a solution at slightly different
    parameters; other points are from another mesh, law or method.
    """

    guess: InitialGuess | None = None
    number: int = 0
    point: Point | None = None
    near: bool = True


class Route(ABC):
    """Route: reduction of a session's problem to another problem, and conversion of its result."""

    name: ClassVar[str]

    @abstractmethod
    def accepts(self, session: Session, start: Start) -> bool:
        """Return whether this route can solve the session's problem from a start."""

    @abstractmethod
    def apply(self, session: Session, start: Start, follower: Homotopy) -> RouteResult:
        """Solve the problem in one of the session's programs; ``follower`` records the work."""

    def invert(self, session: Session, outcome: RouteResult, plan: Rollout, gains: Gains | None) -> tuple[NLP, Point]:
        """Return the program in which the result is judged, and its point there, with multipliers if known."""
        nlp, point = session.judging_nlp(), outcome.result.point
        if nlp is outcome.nlp:
            return nlp, point
        if nlp.method == outcome.nlp.method:
            return nlp, Point(translate(point, outcome.nlp, nlp).x)
        return nlp, Point(pack_rollout(nlp, plan, gains))


class WarmStart(Route):
    """Route of a warm start: one stage from a point; under the exact law, a narrow relaxation and then a polish.

    From a point that is not near a solution, the stage is tried again with a high barrier parameter, and
    the exact law starts with a relaxation that is large enough to exchange contacts.
    """

    name = "warm start"

    def accepts(self, session: Session, start: Start) -> bool:
        """Return whether the start is a warm point."""
        return start.point is not None

    def apply(self, session: Session, start: Start, follower: Homotopy) -> RouteResult:
        """Solve the stage with the first options for which the solver converges."""
        nlp, point = session.nlp_of("product"), start.point
        assert point is not None
        attempts = self._pair_attempts(session, start) if session.complementary else self._attempts(session, start)
        result = _solved_stages(follower, nlp, *attempts[0])
        for stages, stage_point in attempts[1:]:
            result = result if result.ok else _solved_stages(follower, nlp, stages, stage_point)
        if not (session.complementary and result.ok):
            return RouteResult(result, nlp, result.ok, follower.trace)
        return polish(follower, nlp, result, improving=not start.near)

    @staticmethod
    def _attempts(session: Session, start: Start) -> list[tuple[list[HomotopyStage], Point]]:
        point = start.point
        assert point is not None
        warm_options: dict[str, Any] = {} if start.near or point.lam_g is not None else IPOPT_PRIMAL_WARM_START
        stage_options: list[dict[str, Any]] = [{"mu_init": 1e-7}]
        if not start.near:
            limited_options = {"max_iter": STAGE_ITERATIONS, **session.solver.options}
            stage_options = [{**warm_options, "mu_init": 1e-7, **limited_options}, {**warm_options, "mu_init": 1e-3}]
        name = session.step.law.name
        return [([HomotopyStage(name, 0.0, options=options)], point) for options in stage_options]

    @staticmethod
    def _pair_attempts(session: Session, start: Start) -> list[tuple[list[HomotopyStage], Point]]:
        """Return relaxations of the pairs, one from a near point, and two for a far one.

        The two are solved no more tightly than they are relaxed; the second identifies the branch.
        """
        point, mu = start.point, session.problem.natural_scales.mu
        assert point is not None
        if start.near:
            t = NEAR_RELAXATION * mu
            return [([relaxed(t, {"mu_init": max(t / 10, 1e-9)})], point)]
        wide, narrow = (share * mu for share in FAR_RELAXATIONS)
        last_stage = relaxed(narrow, inexact(narrow))
        primal_options = {**IPOPT_PRIMAL_WARM_START, **inexact(wide), "mu_init": wide}
        attempts = [([relaxed(wide, primal_options), last_stage], Point(point.x))]
        if point.lam_g is not None:
            limited_options = {"max_iter": STAGE_ITERATIONS, **session.solver.options}
            attempts.insert(0, ([relaxed(wide, {**inexact(wide), **limited_options}), last_stage], point))
        return attempts


class Complementarity(Route):
    """Route for the exact law in a direct transcription: relaxations, then branches."""

    name = "complementarity"

    def accepts(self, session: Session, start: Start) -> bool:
        """Return whether the NLP has complementarity constraints."""
        return session.complementary

    def apply(self, session: Session, start: Start, follower: Homotopy) -> RouteResult:
        """Relax the pairs by the chosen strategy, or by the default strategy for the number of pairs."""
        return solve_pairs(follower, self._relaxation_plan(session, start))

    def _relaxation_plan(self, session: Session, start: Start) -> RelaxationPlan:
        problem, guess = session.problem, start.guess
        strategy = choose("strategy", session.strategy, STRATEGIES)
        plan = RelaxationPlan(strategy, problem.natural_scales.mu, partial(session.first_point, guess=guess))
        plan = replace(plan, patience=QUICK_PATIENCE) if session.effort == "quick" else plan
        if session.strategy != DEFAULT_STRATEGY:
            return plan
        n_pairs = session.nlp_of("product").pairs.shape[1]
        n_further = 0 if start.number or not n_pairs else 1 if session.effort == "quick" else len(FURTHER_PATHS)
        plan = replace(plan, further_paths=FURTHER_PATHS[:n_further])
        evaluation = session.evaluation
        rollout_starts = RolloutStarts(evaluation, session.step, guess or evaluation.initial_guess)
        rollout_starts = None if isinstance(session.policy, Feedback) else rollout_starts
        if n_pairs > SMALL_PAIRS:
            return replace(plan, after_failure=AFTER_FAILURE, fallback=FALLBACK, rolls=rollout_starts)
        strategy = RELAXATIONS[-start.number % len(RELAXATIONS)]
        return replace(
            plan,
            strategy=replace(strategy, max_iterations=SMALL_ITERATIONS),
            fallback=FALLBACK_SMALL,
            alternatives=ALTERNATIVES,
            rolls=rollout_starts,
        )


class ExactShooting(Route):
    """Route for the exact law in shooting: a plan of another program, rolled out exactly and polished.

    At a kink of the exact law no gradient vanishes, so that a gradient method does not converge. The plan is
    the solution of the complementarity problem in direct transcription; with ``homotopy``, or if the relaxation
    was hard to follow or the rollout diverges, it is the solution along the path of the barrier law.
    The result is the cheapest plan whose rollout does not diverge.
    """

    name = "exact shooting"

    def accepts(self, session: Session, start: Start) -> bool:
        """Return whether the law is exact; False if ``homotopy`` is False, which selects the pure gradient method."""
        return session.step.exact and session.homotopy is not False

    def apply(self, session: Session, start: Start, follower: Homotopy) -> RouteResult:
        """Try plans in turn until one is finished, its rollout does not diverge, and its path was easy to follow."""
        nlp, direct, best = session.nlp_of("product"), session.judging_nlp(), None

        def direct_program(reformulation: str) -> NLP:
            return session.pieces if reformulation == "pieces" else direct

        within = Homotopy(direct_program, session.solver, session.values, follower.progress, follower.trace)
        polisher = RolloutPolish(nlp, direct, session.step, within)
        for plan in self._plans(session, start, follower, polisher):
            try:
                polished, solved = polisher.polish(plan.nlp, plan.result)
            except NotConverged:
                continue
            branch_result = solved or plan.result
            polished = replace(polished, status=branch_result.status, word=branch_result.word)
            stays_close = solved is not None and not lower(solved, polished, _DIVERGED)
            outcome = RouteResult(polished, nlp, stays_close, follower.trace, solved)
            best = better(best, outcome)
            was_hard = any(line.label == "t" and not line.accepted for line in follower.trace.records)
            if plan.finished and stays_close and not was_hard:
                break
        assert best is not None
        return best

    def _plans(
        self, session: Session, start: Start, follower: Homotopy, polisher: RolloutPolish
    ) -> Iterator[RouteResult]:
        if session.step.branches > 1 or not session.homotopy:
            yield _by_helper(session.sub_session(session.law, Direct()), follower, start.guess)
        if session.step.branches == 1:
            barrier = session.sub_session(Barrier(mu=MU_LAST), session.method)
            first = barrier.first_point(barrier.nlp_of("product"), start.guess)
            within = Homotopy(barrier.nlp_of, barrier.solver, barrier.values, follower.progress, follower.trace)
            yield polisher.follow(within, barrier.path()[1], first)

    def invert(self, session: Session, outcome: RouteResult, plan: Rollout, gains: Gains | None) -> tuple[NLP, Point]:
        """Return the judged program and the plan as a point of it, on its branch if that was solved."""
        if outcome.on_branch is None:
            return super().invert(session, outcome, plan, gains)
        return session.judging_nlp(), outcome.on_branch.point


class LawPath(Route):
    """Route along the homotopy path of a law's parameter, which also tries the exact law's solution as a start."""

    name = "law path"

    def accepts(self, session: Session, start: Start) -> bool:
        """Return True, since this route can solve every problem."""
        return True

    def apply(self, session: Session, start: Start, follower: Homotopy) -> RouteResult:
        """Follow the path, also solve its last stage from the exact law's solution, and return the better result."""
        nlp, (schedule, path) = session.nlp_of("product"), session.path()
        value = session.values[schedule.parameter] if schedule else 0.0
        outcome = follower.follow(path, session.first_point(nlp, start.guess))
        if len(path.values) > 1 and session.step.branches == 1:
            exact_outcome = _by_helper(session.sub_session(Exact(), Direct()), follower, start.guess)
            if exact_outcome.finished:
                x = translate(exact_outcome.result.point, exact_outcome.nlp, outcome.nlp).x
                from_exact_result = from_exact(follower, outcome.nlp, x, schedule, value)
                if from_exact_result is not None and (not outcome.finished or lower(from_exact_result, outcome.result)):
                    outcome = replace(outcome, result=from_exact_result, finished=True)
        return outcome


def _solved_stages(follower: Homotopy, nlp: NLP, stages: list[HomotopyStage], point: Point) -> Result:
    """Return the result of the last of the stages, or of the first that fails; each starts where the last one ended."""
    result = follower.solve_stage(stages[0], nlp, point, True)
    for stage in stages[1:]:
        result = follower.solve_stage(stage, nlp, result.point, True) if result.ok else result
    return result


def _by_helper(helper: Session, follower: Homotopy, guess: InitialGuess | None) -> RouteResult:
    """Return the result of the session ``helper``, and add its table and work to the table and work of ``follower``."""
    outcome = helper.solve(guess=guess, progress=follower.progress)
    follower.trace.absorb(outcome.trace)
    return outcome


ROUTES: tuple[Route, ...] = (WarmStart(), Complementarity(), ExactShooting(), LawPath())


def route_for(session: Session, start: Start = Start()) -> Route:
    """Return the first route of the table that accepts the session and the start."""
    return next(route for route in ROUTES if route.accepts(session, start))
