"""Search for any system: sampled input sequences, the best of each kind of contact solved on its own branch."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ocp.errors import NotConverged
from ocp.judge.route_report import SearchedPlan, SearchReport
from ocp.problem.rollout import Rollout, roll_out
from ocp.routes.homotopy import Progress, RouteResult, StageRecord
from ocp.routes.schedules import is_apart
from ocp.routes.session import Session
from ocp.search.plan_solver import PlanSolver
from ocp.search.sampling import InputSampler
from ocp.solution import Solution

CANDIDATES = 6
"""Sampled plans that are solved locally, each of another contact schedule."""


@dataclass
class SampleSearch:
    """Plans of a session's problem from sampled inputs, see :class:`~ocp.search.sampling.InputSampler`.

    ``judge`` makes a solution of a session's outcome and ``seed``; ``report`` tells what was rolled out
    and what became of it, None before.
    """

    session: Session
    judge: Callable[[Session, RouteResult, int], Solution]
    seed: int = 0
    progress: Progress | None = None
    report: SearchReport | None = None

    first: ClassVar[bool] = False
    """Sampled plans come beside those of the usual route, not in their place."""

    def wanted(self, solution: Solution) -> bool:
        """Return whether samples are searched after the usual route's ``solution``: where chosen."""
        return self.session.search is True

    def solutions(self, solution: Solution | None = None) -> Iterator[Solution]:
        """Yield answers from the cheapest sampled plans, one of each contact schedule."""
        sampler = InputSampler(self.session.evaluation, self.seed)
        plans = self._distinct(self._rollouts(sampler))
        self.report = SearchReport(self.seed, sampler.rolled_steps // self.session.problem.N, sampler.rolled_steps)
        solver = PlanSolver(self.session, self._roll_out, self.judge, "sampling", self.seed, self.progress)
        for plan, answer in solver.solve(plans):
            survives = answer.referee.survives
            self.report.plans.append(SearchedPlan(plan.cost, answer.cost, answer.status.label, survives))
            yield answer

    def _rollouts(self, sampler: InputSampler) -> list[Rollout]:
        """Return the exact rollouts of the sampled plans, the cheapest first, by cost and violated constraints."""
        rollouts: list[tuple[float, Rollout]] = []
        for number, plan in enumerate(sampler.plans(), 1):
            rollout = self._roll_out(plan.inputs)
            if rollout is not None:
                rollouts.append((sampler.exact_cost(plan.inputs), rollout))
            if self.progress is not None:
                self.progress(
                    StageRecord("samples", number, plan.cost, np.nan, np.nan, sampler.rolled_steps, np.nan, plan.run)
                )
        return [rollout for _, rollout in sorted(rollouts, key=lambda pair: pair[0])]

    def _distinct(self, rollouts: list[Rollout]) -> list[Rollout]:
        """Return the first rollouts of different contact schedules, at most :data:`CANDIDATES`."""
        sizes, chosen = self.session.problem.scales, list[Rollout]()
        schedules: list[np.ndarray] = []
        for rollout in rollouts:
            schedule = (rollout.lam[0] / sizes.impulse > rollout.gap[0] / sizes.gap).T
            if len(chosen) < CANDIDATES and all(is_apart(schedule, other) for other in schedules):
                chosen.append(rollout)
                schedules.append(schedule)
        return chosen

    def _roll_out(self, inputs: np.ndarray) -> Rollout | None:
        """Return the exact rollout of inputs (N, nu), or None where a step is not solved."""
        try:
            return roll_out(self.session.problem, inputs[None], self.session.values)
        except NotConverged:
            return None
