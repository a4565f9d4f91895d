"""Improvement of a sweep: points are solved again from the plans of neighbouring points."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from ocp.jobs.grid import Grid, dimension_name
from ocp.jobs.sweep_job import FAULT_STATUS, REJECTED_STATUS, JobResult, RollJob, SolveJob
from ocp.jobs.sweep_record import describe_point

OUTLIER_SHARE = 1e-3
"""Minimum decrease of the cost that counts as better, relative to the difference from the cost of doing nothing."""


@dataclass
class Exchange:
    """Improvement of a grid's points, in several passes, by solves from the plans of neighbours.

    ``solve(jobs, first)`` yields index and result of each job in a mapping from indices of points to jobs, and
    saves results under numbers that start at ``first``. ``roll(jobs)`` yields index and costs of each job that rolls
    out plans of other points. For pairs (point, neighbour), ``rolled_costs`` maps the pair to the cost of the
    neighbour's current plan when rolled out at the point, and ``tried`` contains the pairs for which the point
    was already solved from that plan.
    """

    study: Grid
    points: list[JobResult]
    solve: Callable[[Mapping[int, SolveJob], int], Iterable[tuple[int, JobResult]]]
    roll: Callable[[Mapping[int, RollJob]], Iterable[tuple[int, list[float]]]]
    rolled_costs: dict[tuple[int, int], float] = field(default_factory=dict)
    tried: set[tuple[int, int]] = field(default_factory=set)

    def run(self) -> list[JobResult]:
        """Improve points until no solve from a neighbour's plan is better; return all points.

        Each pass first solves a point from its cheapest neighbour if that neighbour costs less. Then the
        neighbours' plans are rolled out at the point's own parameters, and the point is solved from the
        cheapest of them if it costs less than the point's plan. If a neighbour's plan is still better at the
        end, the point is marked as an outlier.
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
        """Solve points from plans of neighbours (``starts`` maps point to neighbour); return the improved points."""
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
        """Roll out the plans of all neighbours at each point, except plans whose cost at the point is already known."""
        jobs, study, neighbours = dict[int, RollJob](), self.study, dict[int, list[int]]()
        for index, values in enumerate(study.point_values):
            new = [k for k in study.neighbours(index) if self.points[k].row["success"]]
            neighbours[index] = [k for k in new if (index, k) not in self.rolled_costs]
            if neighbours[index] and self.points[index].row["status"] not in (REJECTED_STATUS, FAULT_STATUS):
                plans = tuple(self.points[k] for k in neighbours[index])
                jobs[index] = RollJob(study.request.at(values), study.rank, plans)
        for index, costs in self.roll(jobs):
            self.rolled_costs.update(((index, k), cost) for k, cost in zip(neighbours[index], costs, strict=True))

    def _better_plans(self, untried: bool = False) -> dict[int, int]:
        """Return a mapping from each point where a neighbour's plan is better to the neighbour with the best plan.

        If ``untried``, neighbours whose plan the point has already been solved from are ignored.
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
    """Return a mapping from each point that is unsolved or costs more than a neighbour to its cheapest neighbour.

    Only neighbours in ``changed`` count, since the point has already been solved from all other neighbours.
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
    """Return the cost by which the sweep ranks solutions: the planned cost, the exact cost, or the referee's cost."""
    return row[{"exact": "exact_cost", "referee": "referee_cost"}.get(study.rank, "cost")]


def is_better(study: Grid, new: Mapping[str, Any], old: Mapping[str, Any]) -> bool:
    """Return whether a point's solution ``new``, from a neighbour's plan, is better than its solution ``old``."""
    if not new["success"] or not old["success"]:
        return bool(new["success"])
    if new["survives"] < old["survives"]:
        return False
    return _gains(study, _ranking_cost(study, new), old)


def _gains(study: Grid, cost: float, old: Mapping[str, Any]) -> bool:
    """Return whether ``cost`` is lower than the cost of ``old`` by at least the margin :data:`OUTLIER_SHARE`."""
    span = abs(old["idle_cost"] - cost)
    min_gain = OUTLIER_SHARE * (span if math.isfinite(span) else abs(cost))
    return _ranking_cost(study, old) - cost > min_gain


def outlier(new: JobResult, old: JobResult, start: str) -> JobResult:
    """Return the better result ``new``, with the neighbour ``start`` and the cost of the point's separate solve."""
    own_cost = old.row["own_cost"] if old.row["start"] else old.row["cost"]
    totals = {name: new.row[name] + old.row[name] for name in ("iterations", "seconds", "solve_s")}
    return JobResult({**new.row, **totals, "own_cost": own_cost, "start": start}, new.arrays)
