"""Verdict on a closed-loop simulation: a status, and findings on its cost and on failures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ocp.judge.constraints import CONSTRAINT_SHARE
from ocp.judge.findings import Finding, compose_lines, make_finding
from ocp.judge.referee import STATE_SHARE

if TYPE_CHECKING:
    from ocp.mpc.simulate import ClosedLoop

MIN_SOLVED_SHARE = 0.5
"""Minimum fraction of samples with a solved program; below it a simulation has failed."""
MAX_NAMED_CONSTRAINTS = 3
"""Maximum number of violated constraints that a verdict names."""


class LoopVerdict:
    """Verdict on a closed-loop simulation; ``str(verdict)`` returns its sentences.

    ``status`` is ``done``, ``warnings`` (the simulation reached its end, but the findings report a problem),
    ``stopped`` (by the user), ``diverged``, or ``failed`` (a cost was not finite, less than half of the
    programs were solved, or a constraint was violated by more than a tenth of its size). ``planned`` is the fraction
    of samples with a new plan, and ``diverged`` the number of diverged seeds.
    """

    def __init__(self, loop: ClosedLoop) -> None:
        self.loop, statuses = loop, loop.data["status"].values
        has_new_plan, answered = np.isin(statuses, ("solved", "not improved")), statuses != ""
        self.samples, self.n_new_plans = int(answered.sum()), int(has_new_plan.sum())
        self.planned = self.n_new_plans / max(1, self.samples)
        self.solved = (has_new_plan | (statuses == "late")).sum() >= max(1, MIN_SOLVED_SHARE * self.samples)
        self.infinite = np.argwhere(answered & ~np.isfinite(loop.data["cost"].values))
        self.violated = [constraint for constraint in loop.violations if constraint.share > CONSTRAINT_SHARE]
        stopped, ended_early = bool(loop.record.get("stopped")), np.flatnonzero(~loop.survived)
        self.diverged_seeds = ended_early[:-1] if stopped and not loop.survived[-1:].all() else ended_early
        self.diverged = len(self.diverged_seeds)
        strongly_violated = any(constraint.share > STATE_SHARE for constraint in self.violated)
        outcomes = {
            "stopped": stopped,
            "diverged": self.diverged,
            "failed": strongly_violated or len(self.infinite) or not self.solved,
            "warnings": self.violated or self.planned < 1,
        }
        self.status = next((status for status, holds in outcomes.items() if holds), "done")

    def __str__(self) -> str:
        return "\n".join(compose_lines(self.findings))

    @property
    def findings(self) -> list[Finding]:
        """Findings on the loop, each with its code, its sentence and its numbers."""
        return list(self._findings())

    def _findings(self) -> Iterator[Finding]:
        loop, data = self.loop, self.loop.data
        ended, steps = data["ended"].values.tolist(), data.sizes["sample"]
        seeds = f"{len(ended)} seed{'s' * (len(ended) > 1)}"
        if loop.survived.any():
            cost = self._cost(f"over {steps} sample{'s' * (steps > 1)}")
            yield make_finding("reached-the-end", cost=cost, survivors=int(loop.survived.sum()), seeds=seeds)
        if self.diverged:
            seed = int(self.diverged_seeds[0])
            yield make_finding("plant-diverged", count=self.diverged, seeds=seeds, seed=seed, sample=ended[seed])
        if self.status == "stopped":
            cost, seed = float(np.nansum(data["cost"].values[-1])), len(ended) - 1
            yield make_finding("stopped-by-the-user", seed=seed, sample=ended[-1], samples=steps, cost=cost)
        if self.planned < 1:
            yield make_finding("plans-missing", count=self.n_new_plans, samples=self.samples)
        if len(self.infinite):
            seed, sample = self.infinite[0].tolist()
            count = len(self.infinite)
            yield make_finding("stage-cost-not-finite", count=count, samples=self.samples, sample=sample, seed=seed)
        for broken in self.violated[:MAX_NAMED_CONSTRAINTS]:
            worst = broken.violation
            size, sample, seed = worst.amount, worst.step, worst.scenario
            yield make_finding("plant-violates", constraint=broken.name, amount=size, sample=sample, seed=seed)
        if (n_unlisted := len(self.violated) - MAX_NAMED_CONSTRAINTS) > 0:
            yield make_finding("more-constraints-violated", count=n_unlisted, plural="s" * (n_unlisted > 1))

    def _cost(self, over: str) -> str:
        """Return a phrase with the mean cost, its interval and its two terms; ``over`` is a phrase on the samples."""
        finite, (low, high) = np.isfinite(self.loop.costs), self.loop.cost_interval
        if not finite.any():
            return f"no finite cost {over}"
        interval = f" [{low:.5g}, {high:.5g}]" if np.isfinite(low) else ""
        terminal_costs = self.loop.data["end_cost"].values
        cost, stages, end = (v[finite].mean() for v in (self.loop.costs, self.loop.stage_costs, terminal_costs))
        shares = f"stage costs {stages:.6g}, terminal cost {end:.6g}"
        return f"cost {cost:.7g}{interval} ({shares}) {over}"
