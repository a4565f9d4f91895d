"""Which stages of a solve are shown: those of its path, and the exchanges that it took."""

from __future__ import annotations

from collections.abc import Sequence

from ocp.routes.branches import NEIGHBOUR
from ocp.solution import StageRecord


def shown(stages: Sequence[StageRecord]) -> list[tuple[int, StageRecord]]:
    """Stages with their numbers, without neighbouring schedules that did not lower the cost."""
    found, lowest = [], float("inf")
    for number, stage in enumerate(stages, start=1):
        taken = stage.accepted and stage.cost < lowest
        if stage.knob != NEIGHBOUR or taken:
            found.append((number, stage))
        if taken and stage.knob in ("active set", NEIGHBOUR):
            lowest = stage.cost
    return found


def left_out(stages: Sequence[StageRecord]) -> str:
    """How many neighbours were tried in vain, in a sentence; empty for none."""
    count = len(stages) - len(shown(stages))
    many = f"{count} neighbouring contact schedules were" if count > 1 else "1 neighbour was"
    return f"{many} tried and cost no less." if count else ""
