"""Which points of a grid are solved again from a neighbour's plan, and which answer is better."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from ocp.jobs.grid import Grid
from ocp.jobs.sweep_job import FAULT, REFUSED, JobResult

OUTLIER = 1e-3
"""Share of what a plan changes of the cost, by which a neighbour's plan must be better."""


def starts(study: Grid, points: Sequence[JobResult], changed: Collection[int]) -> dict[int, int]:
    """Return the cheapest neighbour of each point that costs more, or has no answer.

    Only neighbours in ``changed`` count: from the others it was solved before.
    """
    found = {}
    for place, point in enumerate(points):
        near = [k for k in study.neighbours(place) if k in changed and points[k].row["success"]]
        best = min(near, key=lambda k: (_cost(study, points[k].row), k), default=None)
        if best is None or point.row["status"] in (REFUSED, FAULT):
            continue
        if not point.row["success"] or _cost(study, points[best].row) < _cost(study, point.row):
            found[place] = best
    return found


def _cost(study: Grid, row: Mapping[str, Any]) -> float:
    """The cost that ranks answers."""
    return row[{"exact": "exact_cost", "referee": "referee_cost"}.get(study.rank, "cost")]


def improves(study: Grid, new: Mapping[str, Any], own: Mapping[str, Any]) -> bool:
    """Whether a point's answer from a neighbour's plan is better than its own."""
    if not new["success"] or not own["success"]:
        return bool(new["success"])
    if new["survives"] < own["survives"]:
        return False
    cost = _cost(study, new)
    span = abs(own["idle_cost"] - cost)
    least = OUTLIER * (span if math.isfinite(span) else abs(cost))
    return _cost(study, own) - cost > least


def outlier(new: JobResult, own: JobResult, start: str) -> JobResult:
    """Return the better answer, marked with its start and the cost of the point's own solve."""
    alone = own.row["own_cost"] if own.row["start"] else own.row["cost"]
    spent = {name: new.row[name] + own.row[name] for name in ("iterations", "seconds", "solve_s")}
    return JobResult({**new.row, **spent, "own_cost": alone, "start": start}, new.arrays)
