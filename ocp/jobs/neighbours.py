"""Improvement of a sweep: points are solved again from neighbours' plans, and the better solution is taken."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from ocp.jobs.grid import Grid, dimension_name
from ocp.jobs.sweep_job import FAULT_STATUS, REJECTED_STATUS, JobResult, RollJob, SolveJob
from ocp.jobs.sweep_record import describe_point

OUTLIER_SHARE = 1e-3
"""Minimum gain of a neighbour's plan that counts, as a share of the cost that a plan can change."""


@dataclass
class Exchange:
    """Improvement of a grid's points by solves from neighbours' plans, in several passes.

    ``solve(jobs, first)`` yields the results of jobs, a mapping from indices of points, and saves them under numbers
    from ``first`` on; ``roll(jobs)`` yields the costs of other points' plans. Pairs are (point, neighbour):
    ``rolled_costs`` maps them to the cost of the neighbour's present plan at the point, and ``tried`` are the
    pairs whose point was solved from it.
    """

    study: Grid
    points: list[JobResult]
    solve: Callable[[Mapping[int, SolveJob], int], Iterable[tuple[int, JobResult]]]
    roll: Callable[[Mapping[int, RollJob]], Iterable[tuple[int, list[float]]]]
    rolled_costs: dict[tuple[int, int], float] = field(default_factory=dict)
    tried: set[tuple[int, int]] = field(default_factory=set)

    def run(self) -> list[JobResult]:
        """Improve points until no solve from a neighbour's plan is better; return all points.

        In each pass a point is solved from its cheapest neighbour if that costs less, and then from the plan that
        costs least at the point's own parameters if that costs less than the point's. Points at which a neighbour's
        plan is better in the end are marked as outliers.
        """
        study, count = self.study, len(self.points)
        passes, changed = sum(study.shape), set(range(count))
        for number in range(1, passes):
            improved = self._improve(cheaper_neighbours(study, self.points, changed), number * count)
            self._roll_plans()
            changed = improved | self._improve(self._better_plans(untried=True), (passes + number) * count)
            if not changed:
                break
        self._roll_plans()
        for index, neighbour in self._better_plans().items():
            if (point := self.points[index]).row["success"]:
                marks = {"outlier": 1, "neighbour_cost": self.rolled_costs[index, neighbour]}
                self.points[index] = replace(point, row={**point.row, **marks})
        return self.points

    def _improve(self, starts: Mapping[int, int], first: int) -> set[int]:
        """Solve points from neighbours' plans, ``starts`` from point to neighbour; return the improved points."""
        study, points, values = self.study, self.points, self.study.point_values
        jobs = {index: study.job(values[index], points[neighbour]) for index, neighbour in starts.items()}
        warm_started = dict(self.solve(jobs, first))
        self.tried.update(starts.items())
        improved = {index for index in warm_started if is_better(study, warm_started[index].row, points[index].row)}
        names = [dimension_name(axis.name) for axis in study.axes]
        for index in improved:
            neighbour = dict(zip(names, values[starts[index]].values(), strict=True))
            points[index] = outlier(warm_started[index], points[index], describe_point(neighbour, names))
        self.tried = {pair for pair in self.tried if pair[1] not in improved}
        self.rolled_costs = {pair: cost for pair, cost in self.rolled_costs.items() if pair[1] not in improved}
        return improved

    def _roll_plans(self) -> None:
        """Roll out all neighbours' plans at the points at which this has not been done."""
        jobs, study, neighbours = dict[int, RollJob](), self.study, dict[int, list[int]]()
        for index, values in enumerate(study.point_values):
            new = [k for k in study.neighbours(index) if self.points[k].row["success"]]
            neighbours[index] = [k for k in new if (index, k) not in self.rolled_costs]
            if neighbours[index] and self.points[index].row["status"] not in (REJECTED_STATUS, FAULT_STATUS):
                plans = tuple(self.points[k] for k in neighbours[index])
                jobs[index] = RollJob(study.case.at(values), study.rank, plans)
        for index, costs in self.roll(jobs):
            self.rolled_costs.update(((index, k), cost) for k, cost in zip(neighbours[index], costs, strict=True))

    def _better_plans(self, untried: bool = False) -> dict[int, int]:
        """Return a mapping from points to the neighbour whose plan costs least there, if it is better than theirs.

        With ``untried`` only neighbours count from whose plan the point has not been solved.
        """
        best: dict[int, int] = {}
        for (index, neighbour), cost in sorted(self.rolled_costs.items()):
            row = self.points[index].row
            if (untried and (index, neighbour) in self.tried) or not math.isfinite(cost):
                continue
            if not row["success"] or _gains(self.study, cost, row):
                best[index] = min(best.get(index, neighbour), neighbour, key=lambda k: self.rolled_costs[index, k])
        return best


def cheaper_neighbours(study: Grid, points: Sequence[JobResult], changed: Collection[int]) -> dict[int, int]:
    """Return a mapping from points to their cheapest neighbour, if the point costs more or is unsolved.

    Only neighbours in ``changed`` count, since points have been solved from the others before.
    """
    cheapest_neighbours = {}
    for index, point in enumerate(points):
        candidates = [k for k in study.neighbours(index) if k in changed and points[k].row["success"]]
        cheapest = min(candidates, key=lambda k: (_ranking_cost(study, points[k].row), k), default=None)
        if cheapest is None or point.row["status"] in (REJECTED_STATUS, FAULT_STATUS):
            continue
        if not point.row["success"] or _ranking_cost(study, points[cheapest].row) < _ranking_cost(study, point.row):
            cheapest_neighbours[index] = cheapest
    return cheapest_neighbours


def _ranking_cost(study: Grid, row: Mapping[str, Any]) -> float:
    """Return the cost by which the study ranks solutions: planned, exact, or the referee's."""
    return row[{"exact": "exact_cost", "referee": "referee_cost"}.get(study.rank, "cost")]


def is_better(study: Grid, new: Mapping[str, Any], old: Mapping[str, Any]) -> bool:
    """Return whether a point's solution ``new``, from a neighbour's plan, is better than its solution ``old``."""
    if not new["success"] or not old["success"]:
        return bool(new["success"])
    if new["survives"] < old["survives"]:
        return False
    return _gains(study, _ranking_cost(study, new), old)


def _gains(study: Grid, cost: float, old: Mapping[str, Any]) -> bool:
    """Return whether ``cost`` is below that of the solution ``old`` by enough to count (:data:`OUTLIER_SHARE`)."""
    span = abs(old["idle_cost"] - cost)
    min_gain = OUTLIER_SHARE * (span if math.isfinite(span) else abs(cost))
    return _ranking_cost(study, old) - cost > min_gain


def outlier(new: JobResult, old: JobResult, start: str) -> JobResult:
    """Return the better result ``new``, with its ``start``, the neighbour, and the cost of the point's own solve."""
    own_cost = old.row["own_cost"] if old.row["start"] else old.row["cost"]
    totals = {name: new.row[name] + old.row[name] for name in ("iterations", "seconds", "solve_s")}
    return JobResult({**new.row, **totals, "own_cost": own_cost, "start": start}, new.arrays)
