"""Which stages of a solve are shown: those of its path, and the exchanges that it took."""

from __future__ import annotations

from collections.abc import Sequence

from ocp.routes.branches import NEIGHBOUR
from ocp.solution import StageRecord


class Shown:
    """Tells stage after stage whether it is shown: not a neighbour that did not lower the cost."""

    def __init__(self) -> None:
        self.lowest, self.number = float("inf"), 0

    def take(self, stage: StageRecord) -> bool:
        """Whether the next stage is shown; ``number`` is then its own."""
        self.number += 1
        taken = stage.accepted and stage.cost < self.lowest
        if taken and stage.label in ("active set", NEIGHBOUR):
            self.lowest = stage.cost
        return stage.label != NEIGHBOUR or taken


def shown(stages: Sequence[StageRecord]) -> list[tuple[int, StageRecord]]:
    """Stages with their numbers, without neighbouring schedules that did not lower the cost."""
    told = Shown()
    return [(told.number, stage) for stage in stages if told.take(stage)]


def left_out(stages: Sequence[StageRecord]) -> str:
    """How many neighbours were tried in vain, in a sentence; empty for none."""
    count = len(stages) - len(shown(stages))
    many = f"{count} neighbouring contact schedules were" if count > 1 else "1 neighbour was"
    return f"{many} tried and cost no less." if count else ""
