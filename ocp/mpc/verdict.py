"""The verdict on a closed loop: its status, and in sentences what was wrong."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from ocp.judges.referee import STATE_SHARE
from ocp.physics.constraints import CONSTRAINT_SHARE

if TYPE_CHECKING:
    from ocp.mpc.simulate import ClosedLoop

LEAST_SOLVED = 0.5
"""Share of the samples with a solved program, below which a loop has failed."""
_NAMED = 3
"""Violated constraints that a verdict names."""


@dataclass(frozen=True)
class PlantViolation:
    """A constraint that the plant violated, at its worst sample; ``share`` is of its size."""

    name: str
    amount: float
    share: float
    seed: int
    sample: int

    def __str__(self) -> str:
        return (f"The plant violates {self.name} by up to {self.amount:.3g}, at sample"
                f" {self.sample} of seed {self.seed}.")  # fmt: skip


class LoopVerdict:
    """The verdict on a loop; ``str`` gives its sentences.

    ``status`` is ``done``, ``warnings`` (it reached the end, and the sentences say what was wrong
    on the way), ``stopped``, ``diverged`` or ``failed``: numbers that are not finite, programs
    solved in less than half of the samples, or a constraint violated by a tenth of its size.
    ``planned`` is the share of the samples with a new plan, ``diverged`` counts seeds.
    """

    def __init__(self, loop: ClosedLoop) -> None:
        self.loop, data = loop, loop.data
        statuses, self.ended = data["status"].values, data["ended"].values
        self.answered = statuses != ""
        self.fresh = np.isin(statuses, ("solved", "plan before"))
        self.infinite = np.argwhere(self.answered & ~np.isfinite(data["cost"].values))
        self.solved = float((self.fresh | (statuses == "late")).sum() / self.answered.sum())
        self.planned = float(self.fresh.sum() / self.answered.sum())
        stopped, short = bool(loop.record.get("stopped")), np.flatnonzero(~loop.survived)
        self.short = short[:-1] if stopped and not loop.survived[-1] else short
        self.diverged = len(self.short)
        self.violated = [one for one in loop.violations if one.share > CONSTRAINT_SHARE]
        self.status = self._status(stopped)

    def _status(
        self, stopped: bool
    ) -> Literal["done", "warnings", "stopped", "diverged", "failed"]:
        if stopped:
            return "stopped"
        if self.diverged:
            return "diverged"
        far = any(one.share > STATE_SHARE for one in self.violated)
        if far or len(self.infinite) or self.solved < LEAST_SOLVED:
            return "failed"
        return "warnings" if self.violated or self.planned < 1 else "done"

    def __str__(self) -> str:
        return "\n".join(self._sentences())

    def _sentences(self) -> Iterator[str]:
        loop, ended, steps = self.loop, self.ended, self.loop.data.sizes["sample"]
        many, samples = f"{len(ended)} seed{'s' * (len(ended) > 1)}", int(self.answered.sum())
        if loop.survived.any():
            yield f"{self._cost(steps)}; {int(loop.survived.sum())} of {many} reached the end."
        if self.diverged:
            yield (f"The plant diverged in {self.diverged} of {many}, seed {self.short[0]} at"
                   f" sample {ended[self.short[0]]}.")  # fmt: skip
        if self.status == "stopped":
            paid = float(np.nansum(loop.data["cost"].values[-1]))
            yield (f"Stopped by the user at seed {len(ended) - 1}, sample {ended[-1]} of"
                   f" {steps}, cost so far {paid:.5g}.")  # fmt: skip
        if not self.solved:
            yield f"No program was solved in any of {samples} samples."
        elif self.planned < 1:
            yield (f"A new plan was made in {int(self.fresh.sum())} of {samples} samples"
                   f" ({100 * self.planned:.3g} %).")  # fmt: skip
        if many_infinite := len(self.infinite):
            seed, sample = self.infinite[0]
            yield (f"The stage cost is NaN or infinite in {many_infinite} of {samples} samples,"
                   f" first at sample {sample} of seed {seed}.")  # fmt: skip
        yield from map(str, self.violated[:_NAMED])
        if (rest := len(self.violated) - _NAMED) > 0:
            yield f"It violates {rest} more constraint{'s' * (rest > 1)}."

    def _cost(self, steps: int) -> str:
        """The mean cost, and what it is the sum of."""
        loop, over = self.loop, f"over {steps} sample{'s' * (steps > 1)}"
        whole = np.isfinite(loop.costs)
        if not whole.any():
            return f"No finite cost {over}"
        low, high = loop.cost_interval
        wide = f" [{low:.5g}, {high:.5g}]" if np.isfinite(low) else ""
        cost, stages, end = (
            v[whole].mean() for v in (loop.costs, loop.stage_costs, loop.end_costs)
        )
        parts = f"stage costs {stages:.6g}, terminal cost {end:.6g}"
        return f"Cost {cost:.7g}{wide} {over} ({parts})"
