"""The verdict on a closed loop: its status, and in sentences what was wrong."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ocp.judge.constraints import CONSTRAINT_SHARE
from ocp.judge.referee import STATE_SHARE

if TYPE_CHECKING:
    from ocp.mpc.simulate import ClosedLoop

LEAST_SOLVED = 0.5
"""Share of the samples with a solved program, below which a loop has failed."""
_NAMED = 3
"""Violated constraints that a verdict names."""


class LoopVerdict:
    """The verdict on a loop; ``str`` gives its sentences.

    ``status`` is ``done``, ``warnings`` (it reached the end, and the sentences say what was wrong
    on the way), ``stopped``, ``diverged`` or ``failed``: numbers that are not finite, programs
    solved in less than half of the samples, or a constraint violated by a tenth of its size.
    ``planned`` is the share of the samples with a new plan, ``diverged`` counts seeds.
    """

    def __init__(self, loop: ClosedLoop) -> None:
        self.loop, statuses = loop, loop.data["status"].values
        fresh, answered = np.isin(statuses, ("solved", "plan before")), statuses != ""
        self.samples, self.fresh = int(answered.sum()), int(fresh.sum())
        self.planned = self.fresh / max(1, self.samples)
        self.solved = (fresh | (statuses == "late")).sum() >= max(1, LEAST_SOLVED * self.samples)
        self.infinite = np.argwhere(answered & ~np.isfinite(loop.data["cost"].values))
        self.violated = [one for one in loop.violations if one.share > CONSTRAINT_SHARE]
        stopped, short = bool(loop.record.get("stopped")), np.flatnonzero(~loop.survived)
        self.short = short[:-1] if stopped and not loop.survived[-1:].all() else short
        self.diverged = len(self.short)
        far = any(one.share > STATE_SHARE for one in self.violated)
        outcomes = {
            "stopped": stopped,
            "diverged": self.diverged,
            "failed": far or len(self.infinite) or not self.solved,
            "warnings": self.violated or self.planned < 1,
        }
        self.status = next((status for status, holds in outcomes.items() if holds), "done")

    def __str__(self) -> str:
        return "\n".join(self._sentences())

    def _sentences(self) -> Iterator[str]:
        loop, data = self.loop, self.loop.data
        ended, steps = data["ended"].values, data.sizes["sample"]
        many = f"{len(ended)} seed{'s' * (len(ended) > 1)}"
        if loop.survived.any():
            over = f"over {steps} sample{'s' * (steps > 1)}"
            yield f"{self._cost(over)}; {int(loop.survived.sum())} of {many} reached the end."
        if self.diverged:
            yield (
                f"The plant diverged in {self.diverged} of {many}, seed {self.short[0]} at"
                f" sample {ended[self.short[0]]}."
            )
        if self.status == "stopped":
            paid = float(np.nansum(data["cost"].values[-1]))
            yield (
                f"Stopped by the user at seed {len(ended) - 1}, sample {ended[-1]} of {steps}, cost so far {paid:.5g}."
            )
        if self.planned < 1:
            yield f"A new plan was made in {self.fresh} of {self.samples} samples."
        if many_infinite := len(self.infinite):
            seed, sample = self.infinite[0]
            yield (
                f"The stage cost is NaN or infinite in {many_infinite} of {self.samples}"
                f" samples, first at sample {sample} of seed {seed}."
            )
        for one in self.violated[:_NAMED]:
            v = one.violation
            yield (f"The plant violates {one.name} by up to {v.amount:.3g}, at sample {v.step} of seed {v.scenario}.")
        if (rest := len(self.violated) - _NAMED) > 0:
            yield f"It violates {rest} more constraint{'s' * (rest > 1)}."

    def _cost(self, over: str) -> str:
        """The mean cost, and what it is the sum of."""
        whole, (low, high) = np.isfinite(self.loop.costs), self.loop.cost_interval
        if not whole.any():
            return f"No finite cost {over}"
        wide = f" [{low:.5g}, {high:.5g}]" if np.isfinite(low) else ""
        ends = self.loop.data["end_cost"].values
        cost, stages, end = (v[whole].mean() for v in (self.loop.costs, self.loop.stage_costs, ends))
        parts = f"stage costs {stages:.6g}, terminal cost {end:.6g}"
        return f"Cost {cost:.7g}{wide} ({parts}) {over}"
