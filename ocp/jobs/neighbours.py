"""Points of a grid that are solved again from a neighbour's plan, and the choice of the better answer."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from ocp.jobs.grid import Grid
from ocp.jobs.sweep_job import FAULT_STATUS, REJECTED_STATUS, JobResult

OUTLIER_SHARE = 1e-3
"""Gain of a neighbour's plan that counts, as a share of the cost that a plan can change."""


def cheaper_neighbours(study: Grid, points: Sequence[JobResult], changed: Collection[int]) -> dict[int, int]:
    """Return the cheapest neighbour of each point that is dearer than it, or unsolved.

    Only neighbours in ``changed`` count: from the others it was solved before.
    """
    starts_by_place = {}
    for place, point in enumerate(points):
        candidates = [k for k in study.neighbours(place) if k in changed and points[k].row["success"]]
        cheapest = min(candidates, key=lambda k: (_ranking_cost(study, points[k].row), k), default=None)
        if cheapest is None or point.row["status"] in (REJECTED_STATUS, FAULT_STATUS):
            continue
        if not point.row["success"] or _ranking_cost(study, points[cheapest].row) < _ranking_cost(study, point.row):
            starts_by_place[place] = cheapest
    return starts_by_place


def _ranking_cost(study: Grid, row: Mapping[str, Any]) -> float:
    """Return the cost by which answers are ranked."""
    return row[{"exact": "exact_cost", "referee": "referee_cost"}.get(study.rank, "cost")]


def is_better(study: Grid, new: Mapping[str, Any], own: Mapping[str, Any]) -> bool:
    """Return whether a point's answer from a neighbour's plan is better than its own."""
    if not new["success"] or not own["success"]:
        return bool(new["success"])
    if new["survives"] < own["survives"]:
        return False
    cost = _ranking_cost(study, new)
    span = abs(own["idle_cost"] - cost)
    min_gain = OUTLIER_SHARE * (span if math.isfinite(span) else abs(cost))
    return _ranking_cost(study, own) - cost > min_gain


def outlier(new: JobResult, own: JobResult, start: str) -> JobResult:
    """Return the better answer, marked with its start and the cost of the point's own solve."""
    own_cost = own.row["own_cost"] if own.row["start"] else own.row["cost"]
    totals = {name: new.row[name] + own.row[name] for name in ("iterations", "seconds", "solve_s")}
    return JobResult({**new.row, **totals, "own_cost": own_cost, "start": start}, new.arrays)
