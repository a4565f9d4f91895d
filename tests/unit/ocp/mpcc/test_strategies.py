"""Strategies of complementarity problems: branches improved once, values of a relaxation skipped, second solves."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from ocp.mpcc import DEFAULTS, MPCC, solve, solving
from ocp.programs.program import PENALTY, RELAXATION
from ocp.programs.solver import Point, Result, Status
from ocp.routes.branches import Branches
from ocp.routes.relaxations import STRATEGIES
from ocp.routes.schedules import improve
from tests.unit.ocp.mpcc.mpcc_cases import follower_of, symbols


def test_the_cheaper_of_two_minima_that_strategies_find() -> None:
    """``(x - 1)² + (y - 1.1)²`` has the minima (1, 0) and (0, 1.1); all strategies together find the cheaper."""
    v, (x, y) = symbols(2)
    mpcc = MPCC(v, (x - 1) ** 2 + (y - 1.1) ** 2, x, y)
    alone = [solve(mpcc, x0=[0.6, 0.1], strategies=[name]).f for name in DEFAULTS]
    assert solve(mpcc, x0=[0.6, 0.1]).f == pytest.approx(min(alone))


def test_a_branch_to_which_two_strategies_lead_is_improved_once(monkeypatch: pytest.MonkeyPatch) -> None:
    v, (x, y) = symbols(2)
    improved: list[float] = []

    def counted(branches: Branches, result: Result, max_failures: int) -> Result:
        improved.append(result.f)
        return improve(branches, result, max_failures)

    monkeypatch.setattr(solving, "improve", counted)
    assert solve(MPCC(v, (x - 1) ** 2 + (y - 1.1) ** 2, x, y), x0=[0.6, 0.1]).success
    assert improved == pytest.approx([1.0])


@pytest.mark.parametrize(("point", "solved"), [([1, 0], True), ([2, 0], True), ([0.9, 0], False), ([0, 2], False)])
def test_a_result_needs_no_improvement_beside_one_on_its_branch_that_costs_no_more(
    point: list[float], solved: bool
) -> None:
    """The cost ``x + y`` of (1, 0) is 1; (0, 2) is on the other branch."""
    v, (x, y) = symbols(2)
    branches = Branches(follower_of(MPCC(v, x + y, x, y)))

    def result_at(values: list[float]) -> Result:
        return Result.at(branches.program, Point(np.array(values, dtype=float)), branches.p, Status.SOLVED, "")

    assert solving._is_solved(branches, result_at(point), [result_at([1, 0])]) is solved


@pytest.mark.parametrize(("name", "stages"), [("scholtes-exact", 1), ("scholtes-cold", 9)])
def test_a_relaxation_ends_once_its_solution_is_that_of_the_last(name: str, stages: int) -> None:
    """``(x - 1)² + (y + 1)²`` has its minimum (1, 0) for every bound on the product."""
    v, (x, y) = symbols(2)
    follower = follower_of(MPCC(v, (x - 1) ** 2 + (y + 1) ** 2, x, y))
    (path,) = STRATEGIES[name].paths(1.0)
    program = follower.nlp_of(path.reformulation)
    outcome = follower.follow(path, Point(np.array([0.5, 0.5])), source=program)
    assert outcome.finished and len(follower.trace.records) == stages
    assert outcome.result.point.x == pytest.approx([1, 0], abs=1e-6)


def test_values_of_a_relaxation_that_a_solution_satisfies_are_skipped() -> None:
    """At (1, 0.25), the minimum of ``(x - 1)² + (y - 0.25)²``, the product is 0.25: t = 100, 10, 1 are one stage."""
    v, (x, y) = symbols(2)
    follower = follower_of(MPCC(v, (x - 1) ** 2 + (y - 0.25) ** 2, x, y))
    (path,) = STRATEGIES["scholtes-exact"].paths(100.0)
    start = Point(np.array([1.0, 0.1]))
    outcome = follower.follow(path, start, source=follower.nlp_of(path.reformulation))
    assert outcome.finished
    assert [record.value for record in follower.trace.records[:2]] == pytest.approx([100, 0.1])
    assert outcome.result.point.x == pytest.approx([1, 0], abs=1e-6)


@pytest.mark.one_case_in(2)
@pytest.mark.parametrize(("gain", "replaced"), [(1e-11, False), (1e-3, True)])
def test_a_second_solve_in_finer_units_must_lower_the_cost(
    monkeypatch: pytest.MonkeyPatch, gain: float, replaced: bool
) -> None:
    """From a large start a problem is solved twice; here the second solution moves by 1 and costs less by a gain."""
    v, (x, y) = symbols(2)
    follow, solutions = solving._followed, []

    def moved(*arguments: Any) -> Any:
        solution, follower = follow(*arguments)
        changes = {"f": 1.0 - gain, "x": solution.x + 1} if solutions else {"f": 1.0, "status": Status.SOLVED}
        solution = dataclasses.replace(solution, infeasibility=0.0, **changes)
        solutions.append(solution)
        return solution, follower

    monkeypatch.setattr(solving, "_followed", moved)
    solution = solve(MPCC(v, (x - 1) ** 2 + (y - 1.1) ** 2, x, y), x0=[1e3, 1e3])
    assert len(solutions) == 2
    assert solution.x == pytest.approx(solutions[replaced].x)


@pytest.mark.parametrize(("name", "products"), [("l1", 1e-7), ("l1-quick", 1e-6)])
def test_a_penalty_grows_until_products_are_below_the_tolerance_of_its_stages(name: str, products: float) -> None:
    v, (x, y) = symbols(2)
    program = follower_of(MPCC(v, x + y, x, y)).nlp_of("none")
    (path,) = STRATEGIES[name].paths(1.0)
    assert path.complete is not None
    for share, complete in ((0.5, True), (2.0, False)):
        point = Point(np.array([1.0, share * products]))
        result = Result.at(program, point, program.parameter_vector({PENALTY: 0.0, RELAXATION: 0.0}), Status.SOLVED, "")
        assert path.complete(program, result) is complete
