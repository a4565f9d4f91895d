"""Points of a continuation that a neighbouring point's plan shows to be poor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynamics.contact import Barrier
from ocp import solve
from ocp.continuation.curve import CurvePoint, with_neighbour_costs
from ocp.problem.rollout import roll_out
from ocp.solve.solve import new_session
from problems import get

MASSES = (1.0, 1.05, 1.1)


@pytest.fixture(scope="module")
def points() -> list[CurvePoint]:
    return [CurvePoint(m, solve(get("wall-1d", N=10, m=m), contact="exact", effort="quick")) for m in MASSES]


def dearer(point: CurvePoint) -> CurvePoint:
    """Return a point whose plan is said to cost twice as much."""
    audit = point.solution.audit
    return replace(point, solution=replace(point.solution, audit=replace(audit, exact_cost=2 * audit.exact_cost)))


def test_a_point_is_an_outlier_where_a_neighbours_plan_costs_less(points: list[CurvePoint]) -> None:
    problem = get("wall-1d", N=10)
    session = new_session(problem, "exact")
    assert all(point.neighbour_cost is None for point in with_neighbour_costs(session, "m", points))
    first, middle, last = with_neighbour_costs(session, "m", [points[0], dearer(points[1]), points[2]])
    assert first.neighbour_cost is None
    assert last.neighbour_cost is None
    values = {**problem.parameters.defaults, "m": MASSES[1]}
    inputs = [point.solution.data["u"].values for point in (points[0], points[2])]
    assert middle.neighbour_cost == pytest.approx(min(roll_out(problem, u, values).cost for u in inputs))
    assert middle.row()["outlier"] is True


def test_a_neighbours_plan_that_breaks_a_bound_does_not_count(points: list[CurvePoint]) -> None:
    fastest = max(np.abs(point.solution.data["x"].values[..., 1]).max() for point in points)
    problem = replace(
        get("wall-1d", N=10), x_upper=np.array([np.inf, 0.5 * fastest]), x_lower=np.array([-np.inf, -0.5 * fastest])
    )
    session = new_session(problem, "exact")
    compared = with_neighbour_costs(session, "m", [points[0], dearer(points[1]), points[2]])
    assert all(point.neighbour_cost is None for point in compared)


def test_points_of_a_smoothed_law_are_not_compared(points: list[CurvePoint]) -> None:
    session = new_session(get("wall-1d", N=10), Barrier(mu=1e-3))
    compared = with_neighbour_costs(session, "m", [dearer(point) for point in points])
    assert all(point.neighbour_cost is None for point in compared)
