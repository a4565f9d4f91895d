"""Remedies for a plan that does not survive the referee, tried one after another until one succeeds.

The rungs are: the problem under the referee's contact model, from the plan; finer steps; gains along the plans; gains
shared by scenarios of friction, masses and step sizes; and a controller that plans again at every step. Gains over
scenarios are also tried if the answer survives fewer than 18 of 20 draws of friction or masses, and are the answer if
they survive more.

A rung survives if it does so relative to its own plan, and is not much more expensive than the first plan:

- the referee's replay of its inputs or its policy, at h and (where h only discretises) at h/4, costs at most 10 % more
  than its own plan, and keeps constraints and bodies apart to a tenth of their sizes (:mod:`ocp.judge.policy_referee`;
  inputs without a policy also keep the plan's states at h, :func:`ocp.judge.referee.survival_findings`);
- this cost, at h/4 where there is one, exceeds that of the first plan at its own h by at most half of what a plan can
  change (:func:`ocp.solve.comparable_cost.largest_surviving_cost`).
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from dynamics.contact import Exact
from ocp.errors import InputError, NotConverged, abbreviated, interruptible
from ocp.judge.disturbances import ROBUST_DRAWS, disturbed_survival, parameter_draws
from ocp.judge.findings import make_finding
from ocp.judge.policy_referee import policy_report
from ocp.judge.referee import Referee, referee_replay
from ocp.judge.route_report import DisturbedSurvival, Ladder, Rung, StageRecord
from ocp.judge.step_size import step_size_kind
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import Rollout
from ocp.programs.solver import Status
from ocp.routes.relaxations import DEFAULT_STRATEGY
from ocp.routes.session import Session
from ocp.solution import Interrupted, Solution
from ocp.solve.best_gains import best_gains, plan_of, replayed_data, with_gains
from ocp.solve.comparable_cost import largest_surviving_cost, rung_of
from ocp.solve.refinement import HALVINGS, divided_step
from ocp.solve.scenario_gains import gains_over_scenarios
from ocp.transcription import Direct

logger = logging.getLogger(__name__)

WORK = 20
"""Limit of the iterations of all rungs, as a multiple of the plan's iterations; those at h/2 count twice."""
FINER_SHARE = 0.25
"""Fraction of these iterations that finer steps may use before gains are tried."""
LEAST_WORK = 2000
"""Lower limit of the number of iterations that all rungs may use."""
PAYING_SHARE = 0.75
"""Maximum ratio of a replay's excess cost to that before halving the step, for which halving continues."""
FINEST_REPLAY = 16
"""Divisor of the step size in the replay that is listed with the disturbances."""

SCENARIOS = "gains over scenarios"
"""Name of the rung that is also tried if the answer survives too few draws of friction and masses."""

Build = Callable[[Problem, dict[str, Any]], Problem]
SolveFrom = Callable[[Session, Solution, int, "Callable[[StageRecord], None] | None"], Solution]


class WorkSpentError(NotConverged):
    """Error raised when the iterations of all rungs are used up."""


class SurvivalLadder:
    """The rungs of one solution; :meth:`climb` returns the first solution that survives, or else the best.

    ``build`` rebuilds a problem with other parameter values, a dict from name to value; ``solve_from`` solves a session
    from a solution. If no rung survives, the best rung is certified and costs least under the most exact contact model.
    """

    def __init__(
        self,
        session: Session,
        solution: Solution,
        build: Build,
        solve_from: SolveFrom,
        seed: int = 0,
        progress: Callable[[StageRecord], None] | None = None,
    ) -> None:
        self.session, self.build, self.solve_from = session, build, solve_from
        self.seed, self.progress = seed, progress
        self.first, self.plans = solution, [solution]
        self.rungs: list[Rung] = []
        self.answers: list[Solution] = []
        self.disturbed: dict[int, list[DisturbedSurvival]] = {}
        self.work, self.work_factor = 0.0, 1
        self.improves_model = _has_more_exact_model(session.problem)
        self.work_limit = self.all_work = max(LEAST_WORK, WORK * solution.iterations)
        self.iterations = solution.iterations
        self.largest_cost = largest_surviving_cost(solution, *self._plan(solution))
        self._add("the plan", solution)

    def climb(self) -> Solution:
        """Try the rungs in order; after Ctrl-C raise :class:`~ocp.solution.Interrupted` with the best rung so far."""
        rungs = {
            "the most exact contact model": self._solve_most_exact,
            "finer steps": self._finer,
            "gains": self._gains,
            SCENARIOS: self._gains_over_scenarios,
            "a controller": self._controller,
        }
        name = ""
        try:
            with interruptible():
                for name, climb in rungs.items():
                    best = self._best()
                    if not self.rungs[best].survives or (name == SCENARIOS and not self._is_robust(best)):
                        logger.info("the plan does not survive, or too few draws; next rung: %s", name)
                        self._try(name, climb)
                return self._best_solution()
        except KeyboardInterrupt as stop:
            raise Interrupted(self._best_solution(f"Ctrl-C ended the rung {name or 'of the plan'}")) from stop

    def _try(self, name: str, climb: Callable[[], None]) -> None:
        """Try one rung; a rung that cannot be tried is listed with the reason."""
        try:
            with interruptible():
                climb()
        except (InputError, NotConverged, np.linalg.LinAlgError) as reason:
            self._skip(name, str(reason))
        except Exception as error:
            logger.exception("a rung ended in an error")
            self._skip(name, f"ended in an error of the program: {abbreviated(str(error))}")

    def _skip(self, name: str, reason: str) -> None:
        self.rungs.append(Rung(name, note=reason))
        self.answers.append(self.first)

    def _solve_most_exact(self) -> None:
        """Solve the problem under the referee's contact model."""
        if not self.improves_model and isinstance(self.session.law, Exact):
            raise InputError("the plan already uses the referee's contact model")
        solution = self._solve(self._exact_session(self.session.problem.most_exact), self.first)
        solution = self._add("the most exact contact model", solution)
        if solution.success:
            self.plans = [solution]

    def _finer(self) -> None:
        """Halve the step repeatedly, starting from the last plan, until a plan survives or halving no longer helps."""
        self.work_limit = FINER_SHARE * self.all_work
        excess = self.rungs[self._index_of(self.plans[0])].excess
        for level in range(1, HALVINGS + 1):
            self._finer_plan(level)
            if self.rungs[-1].survives:
                return
            coarser_excess, excess = excess, self.rungs[-1].excess
            if level < HALVINGS and not excess <= PAYING_SHARE * coarser_excess:
                raise NotConverged("half the step hardly reduces the excess cost of the replay at h/4")

    def _finer_plan(self, level: int) -> Solution:
        """Return the plan with the step halved ``level`` times; if missing, it is solved from the previous level.

        Raises :class:`~ocp.errors.NotConverged` if it is not solved.
        """
        if level < len(self.plans):
            return self.plans[level]
        base, uses_most_exact, self.work_factor = self.plans[0], self.plans[0].route.most_exact, 2**level
        step_size = step_size_kind(base.problem.system)
        if step_size.kind == "fixed":
            raise InputError(step_size.reason)
        changed_values = divided_step(base.problem, base.values, 2**level)
        rebuilt = self.build(self.session.problem, changed_values)
        session = self._exact_session(rebuilt.most_exact if uses_most_exact else rebuilt, changed_values)
        solution = self._solve(session, self.plans[-1])
        if not solution.success:
            raise NotConverged(f"the plan of {solution.problem.N} steps is {solution.status.label}")
        self.plans.append(self._add(f"steps of h/{2**level}", solution))
        return self.plans[-1]

    def _gains(self) -> None:
        """Try gains along plans of decreasing step size until a policy survives; solve missing finer plans first."""
        self._require_single_plan()
        self.work_limit = self.all_work
        if isinstance(self.session.law, Exact) and self.first is not self.plans[0]:
            self._gains_along(self.first, "gains")
        for level in range(HALVINGS + 1):
            if self.rungs[-1].survives:
                return
            solution = self._finer_plan(level)
            if self.rungs[-1].survives:
                return
            self._require_exact(solution)
            suffix = " along the plan of the most exact contact model" if solution.route.most_exact else ""
            self._gains_along(solution, f"gains at {solution.problem.N} steps" if level else f"gains{suffix}")

    def _gains_along(self, solution: Solution, name: str) -> None:
        """Add the best gains along a plan to the list, by the larger of their costs at h and h/4."""
        evaluation, plan = self._plan(solution)
        gains, outcome = best_gains(evaluation, plan)
        self._add(name, with_gains(solution, gains, outcome), iterations=0)

    def _gains_over_scenarios(self) -> None:
        """Try gains over scenarios along the plan that survives, or else along the coarsest plan and the finest."""
        self._require_single_plan()
        best = self._best()
        solutions = [self.answers[best]] if self.rungs[best].survives else self.plans[:1] + self.plans[1:][-1:]
        for solution in solutions:
            self._require_exact(solution)
            gains, outcome = gains_over_scenarios(*self._plan(solution), solution.gains)
            N = solution.problem.N
            name = SCENARIOS if N == self.first.problem.N else f"{SCENARIOS} at {N} steps"
            self._add(name, with_gains(solution, gains, outcome), iterations=0)
            if self.rungs[-1].survives:
                return

    def _require_single_plan(self) -> None:
        if self.first.problem.scenarios.n > 1 or self.first.gains is not None:
            raise InputError("gains follow a single plan of open-loop inputs")

    def _require_exact(self, solution: Solution) -> None:
        if solution is self.first and not isinstance(self.session.law, Exact):
            raise InputError("gains follow a plan under the exact law")

    def _controller(self) -> None:
        """Try a controller that plans again at every step, on the referee's plant."""
        from ocp.mpc.plan_policies import ControllerPolicy

        solution = self.plans[0]
        if solution.problem.scenarios.n > 1:
            raise InputError("a controller starts from one state")
        evaluation, plan = self._plan(solution)
        policy = ControllerPolicy(evaluation)
        outcome = referee_replay(evaluation, policy, plan.x[:, 0])
        if policy.samples == policy.n_unplanned:
            raise NotConverged(f"the controller made no plan of its own: {policy.note or 'no sample was answered'}")
        report = policy_report(evaluation, plan, outcome, solution.referee)
        data = replayed_data(solution, policy, outcome)
        refereed = replace(solution.with_data(data), referee=report, controller=policy)
        self._add("a controller", refereed.with_route(controller=True), outcome, iterations=0)

    def _exact_session(self, problem: Problem, changed_values: dict[str, Any] | None = None) -> Session:
        """Return a session of another problem under the exact law, without searches, at the same values."""
        same_law = isinstance(self.session.law, Exact)
        return self.session.with_changes(
            changed_values,
            problem=problem,
            law=self.session.law if same_law else Exact(),
            method=Direct(),
            strategy=self.session.strategy if same_law else DEFAULT_STRATEGY,
            search=False,
            effort="quick",
            user_guess=None,
            windows={},
        )

    def _solve(self, session: Session, start: Solution) -> Solution:
        solution = self.solve_from(session, start, self.seed, self._count)
        if solution.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        self.iterations += solution.iterations
        is_most_exact = session.problem.system is session.problem.system.most_exact
        return solution.with_route(most_exact=self.improves_model and is_most_exact)

    def _count(self, stage: StageRecord) -> None:
        """Count the work of a stage; raise :class:`WorkSpentError` if the work of all rungs exceeds its limit."""
        if self.progress is not None:
            self.progress(stage)
        self.work += stage.iterations * self.work_factor
        if self.work > self.work_limit:
            plain_solves = round(WORK * self.work_limit / self.all_work)
            raise WorkSpentError(f"stopped after iterations of {plain_solves} plain solves")

    def _add(
        self, name: str, solution: Solution, outcome: Referee | None = None, iterations: int | None = None
    ) -> Solution:
        """Add a rung, with costs that are comparable with those of the first plan, and return its solution.

        If the rung is too expensive to survive, the referee's report in this solution says so.
        """
        evaluation, plan = self._plan(solution)
        outcome = outcome or referee_replay(evaluation, solution.inputs, plan.x[:, 0])
        rung = rung_of(name, self.first, solution, plan, outcome)
        rung = rung if iterations is None else replace(rung, iterations=iterations)
        if self.rungs and rung.survives and rung.most_exact_cost > self.largest_cost:
            cost, planned = rung.most_exact_cost, self.first.cost
            finding = make_finding("remedy-costs-too-much", cost=cost, planned=planned, limit=self.largest_cost)
            report = solution.referee
            solution = replace(solution, referee=replace(report, findings=[*report.findings, finding]))
            rung = replace(rung, survives=False, note=f"costs more than {self.largest_cost:.6g}: too much to survive")
        self.rungs.append(rung)
        self.answers.append(solution)
        return solution

    def _plan(self, solution: Solution) -> tuple[Evaluation, Rollout]:
        """Return a rung's problem at its values, and its plan."""
        return plan_of(solution, self.session.step if solution is self.first else solution.problem.exact_step)

    def _index_of(self, solution: Solution) -> int:
        return next(i for i, refereed in enumerate(self.answers) if refereed is solution)

    def _best(self) -> int:
        """Return the index of the best rung: of those that survive, the one with most draws of friction and masses."""
        survivors = [i for i, rung in enumerate(self.rungs) if rung.survives]
        if survivors:
            return survivors[0] if len(survivors) == 1 else max(survivors, key=lambda i: sum(self._draws(i)))

        def order(i: int) -> tuple[bool, bool, float]:
            rung, cost = self.rungs[i], self.rungs[i].most_exact_cost
            return rung.survives is None, rung.status != Status.SOLVED.label, cost if math.isfinite(cost) else math.inf

        return min(range(len(self.rungs)), key=order)

    def _best_solution(self, stopped: str = "") -> Solution:
        """Return the best rung's solution with the report on all rungs; if it survives, disturbances are also tried."""
        best = self._best()
        solution = self.answers[best]
        rows = self._disturbed(best) if self.rungs[best].survives and not stopped else []
        ladder = Ladder(self.rungs, best, stopped, rows, self.largest_cost)
        return replace(solution, iterations=self.iterations).with_route(ladder=ladder)

    def _is_robust(self, i: int) -> bool:
        return all(survived >= ROBUST_DRAWS for survived in self._draws(i))

    def _draws(self, i: int) -> list[int]:
        """Return the numbers of draws of friction and of masses that a rung survives."""
        return parameter_draws(self._disturbed(i))

    def _disturbed(self, i: int) -> list[DisturbedSurvival]:
        """Return the disturbances that a rung survives, each tried once."""
        if i not in self.disturbed:
            solution = self.answers[i]
            evaluation, plan = self._plan(solution)
            delay, factors = solution.problem.N // self.first.problem.N, (FINEST_REPLAY,)
            self.disturbed[i] = disturbed_survival(evaluation, plan, solution.inputs, self.seed, factors, delay)
        return self.disturbed[i]


def _has_more_exact_model(problem: Problem) -> bool:
    try:
        return problem.most_exact is not problem
    except InputError:
        return False
