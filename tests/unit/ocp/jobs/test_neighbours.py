"""Points of a sweep that a neighbour's plan improves: which are tried, when it is better, and outliers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ocp.jobs import neighbours
from ocp.jobs.grid import Grid, parse_axes
from ocp.jobs.sweep import sweep
from ocp.jobs.sweep_job import JobResult, SolveJob, failed_result, solve_job
from ocp.jobs.sweep_record import grid_rows, summarise_points
from ocp.solve.solve_request import SolveRequest
from tests.unit.ocp.jobs.same import same

GRID = Grid(SolveRequest("push-1d"), parse_axes({"problem.M": [1.0, 2.0, 3.0], "problem.K": [1.0, 2.0]}))
ROW = {"success": 1, "survives": 1, "idle_cost": 10.0, "exact_cost": 1.0, "referee_cost": 1.0}


def row(cost: float, **other: Any) -> dict[str, Any]:
    return {**failed_result("", "").row, **ROW, "cost": cost, "status": "solved", **other}


def point(cost: float, **other: Any) -> neighbours.JobResult:
    return neighbours.JobResult(row(cost, **other), {})


def test_neighbours_are_one_step_away_along_an_axis() -> None:
    assert [sorted(GRID.neighbours(k)) for k in range(6)] == [
        [1, 2],
        [0, 3],
        [0, 3, 4],
        [1, 2, 5],
        [2, 5],
        [3, 4],
    ]


def test_a_point_starts_at_its_cheapest_neighbour_where_that_costs_less() -> None:
    points = [point(cost) for cost in (1.0, 2.0, 3.0, 0.5, 4.0, 5.0)]
    assert neighbours.cheaper_neighbours(GRID, points, range(6)) == {1: 3, 2: 3, 4: 2, 5: 3}
    assert neighbours.cheaper_neighbours(GRID, points, {2}) == {4: 2}, "from the others it was solved before"
    points[3] = failed_result("fault", "died")
    points[0] = point(math.nan, success=0, status="not converged")
    # A point whose worker died has no plan and is not tried again.
    assert neighbours.cheaper_neighbours(GRID, points, range(6)) == {0: 1, 4: 2, 5: 4}


@pytest.mark.parametrize("offset", [0.0, 1e6, -1e6])
def test_better_is_a_share_of_what_a_plan_changes(offset: float) -> None:
    """A constant in the cost makes no difference."""
    base = {"idle_cost": 10.0 + offset}
    own = row(2.0 + offset, **base)
    assert neighbours.is_better(GRID, row(1.9 + offset, **base), own)
    assert not neighbours.is_better(GRID, row(1.999 + offset, **base), own)
    assert not neighbours.is_better(GRID, row(1.0 + offset, survives=0, **base), own)
    assert not neighbours.is_better(GRID, row(1.0 + offset, success=0, **base), own)
    assert neighbours.is_better(GRID, row(3.0 + offset, **base), row(math.nan, success=0))


def test_an_outlier_keeps_the_cost_of_its_own_solve() -> None:
    first = neighbours.outlier(point(3.0, iterations=2), point(5.0, iterations=7), "M = 1")
    again = neighbours.outlier(point(2.0), first, "M = 2")
    assert (first.row["own_cost"], first.row["start"], first.row["iterations"]) == (5.0, "M = 1", 9)
    assert (again.row["own_cost"], again.row["start"], again.row["cost"]) == (5.0, "M = 2", 2.0)


@pytest.mark.costly
@pytest.mark.parametrize("is_solved_again", [True, False])
def test_a_point_above_what_a_dearer_neighbours_plan_gives_there_is_repaired_or_marked(
    is_solved_again: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The cost grows with the weight, so that a poor solution at the smallest weight is cheaper than its neighbours."""
    request: dict[str, Any] = {"problem": "wall-1d", "over": {"w_x": [1.0, 1.1, 1.2]}, "params": {"N": 5}}
    costs = sweep(**request)["cost"].values
    poor_cost = costs[:2].mean()

    def solve_poorly(job: SolveJob, report: Callable[[Any], None]) -> JobResult:
        point = solve_job(job, report)
        if job.start is not None and not is_solved_again:
            return failed_result("not converged", "")
        is_poor = job.start is None and job.request.params["w_x"] == 1.0
        return replace(point, row={**point.row, "cost": poor_cost}) if is_poor else point

    monkeypatch.setattr("ocp.jobs.sweep.solve_job", solve_poorly)
    found = sweep(**request)
    assert found["outlier"].values.tolist() == [int(not is_solved_again), 0, 0]
    lines = summarise_points(grid_rows(found), ["w_x"]).split("\n")[1:]
    if is_solved_again:
        np.testing.assert_allclose(found["cost"].values, costs, rtol=1e-9)
        assert (found["start"].values.tolist(), found["own_cost"].values[0]) == (["w_x = 1.1", "", ""], poor_cost)
        assert lines == [f"outlier w_x = 1: {poor_cost:.6g} alone, {costs[0]:.6g} from the plan at w_x = 1.1"]
        return
    offered = found["neighbour_cost"].values
    assert found["cost"].values[0] == poor_cost and costs[0] <= offered[0] < poor_cost
    assert np.isnan(offered[1:]).all() and not any(found["start"].values)
    assert lines == [f"outlier w_x = 1: {poor_cost:.6g}, although a neighbour's plan costs {offered[0]:.6g} there"]


@pytest.mark.costly
def test_a_plan_left_in_a_poor_minimum_is_found_from_the_side_alike_by_any_number_of_workers() -> None:
    """Solved alone, the push over 5 cm costs 7.4 instead of 0.49."""
    found = sweep("push-box", {"distance": [0.05, 0.1]}, params={"N": 12})
    assert np.isfinite(found["own_cost"].values).tolist() == [True, False]
    assert float(found["own_cost"][0]) > 5 and float(found["cost"][0]) < 0.6
    assert found["start"].values.tolist() == ["distance = 0.1", ""]
    assert found["success"].values.tolist() == [1, 1]
    assert same(found, sweep("push-box", {"distance": [0.05, 0.1]}, params={"N": 12}, jobs=2))
