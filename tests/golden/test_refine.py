"""Refinement: plans are solved again at half the step size until it makes no difference."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Exact
from dynamics.systems import lcs
from ocp import InputError, Problem, Scaling, Solution, Status, solve
from ocp.problem.rollout import roll_out
from ocp.solve.refinement import AGREED, HALVINGS, divided_step, perturbation_growth, refine_step_size, replay_level
from problems import get
from tests.findings import numbers

COARSE = {"h": 0.2, "N": 10}
"""Parameters of ball-bounce at four times its step size, which is too large for the bounce."""


def replayed_at_half(found: Solution) -> float:
    """Return the cost of a plan's inputs, each held over two steps of h/2, by the problem at 2 N."""
    problem, values, u = found.problem, found.values, found.data["u"].values
    fine = get(problem.name, N=2 * problem.N)
    at = values | {"h": values["h"] / 2}
    rolled = roll_out(fine, np.repeat(u, 2, axis=1), at, x0=found.data["x"].values[:, 0])
    p, x = problem.parameters.pack(values), rolled.x[0, ::2]
    stages = (problem.cost_terms(x[k], u[0, k], 0, 0, p)[0] for k in range(problem.N))
    return sum(map(float, stages)) + float(problem.cost_terms(x[-1], u[0, -1], 0, 0, p)[1])


@pytest.mark.costly
def test_a_plan_is_refined_until_its_replay_at_half_the_step_agrees() -> None:
    found = solve("ball-bounce", "exact", refine=True, **COARSE)
    levels = found.route.refinement.levels
    assert len(levels) > 1 and not found.route.refinement.stopped
    assert [one.N for one in levels] == [10 * 2**k for k in range(len(levels))]
    assert [one.h for one in levels] == pytest.approx([0.2 / 2**k for k in range(len(levels))])
    off = [abs(one.replayed - one.cost) / abs(one.cost) for one in levels]
    assert min(off[:-1]) > AGREED >= off[-1]
    last = levels[-1]
    assert found.success and (found.cost, found.problem.N) == (last.cost, last.N)
    assert last.replayed == pytest.approx(replayed_at_half(found), rel=1e-9)
    assert found.record["params"]["h"] == pytest.approx(last.h)
    cold = solve("ball-bounce", "exact", h=last.h, N=last.N)
    assert found.cost <= cold.cost * (1 + 1e-3), "as good as a solve that begins there"
    told = {"h": last.h, "cost": found.cost, "replayed": last.replayed, "ending": "they agree"}
    assert numbers(found, "step-refined") == told


@pytest.mark.costly
def test_a_problem_object_is_refined_as_it_stands() -> None:
    problem = get("ball-bounce", **COARSE)
    lighter = replace(problem, stage_cost=0.5 * problem.stage_cost)
    found = solve(lighter, Exact(), refine=True)
    first, last = (found.route.refinement.levels[k] for k in (0, -1))
    assert first.cost == pytest.approx(solve(lighter, Exact()).cost)
    fine = get("ball-bounce", h=last.h, N=last.N)
    again = solve(replace(fine, stage_cost=0.5 * fine.stage_cost), Exact())
    assert found.cost <= again.cost * (1 + 1e-3)


@pytest.mark.parametrize("name", ["push-1d", "wall-1d"])
def test_a_step_that_is_part_of_the_model_is_not_refined(name: str) -> None:
    with pytest.raises(InputError, match=r"halves the step of .*; leave it out"):
        solve(name, "exact", refine=True)


def test_refining_ends_and_says_why() -> None:
    """It ends at a plan that is not solved, or without agreement; the last solved plan is returned."""
    coarse = solve("ball-bounce", "exact", **COARSE)
    assert not replay_level(coarse).agreed

    def never(turned: dict[str, Any], start: Solution) -> Solution:
        return replace(coarse, iterations=1)

    def lost(turned: dict[str, Any], start: Solution) -> Solution:
        return replace(coarse, status=Status.INFEASIBLE, cost=replay_level(coarse).replayed)

    found = refine_step_size(coarse, lost)
    assert found.success and found.cost == coarse.cost
    assert found.route.refinement.stopped.endswith("is infeasible")
    assert numbers(found, "step-refined")["ending"] == "the plan at h = 0.2 is infeasible"
    unsolved = refine_step_size(replace(coarse, status=Status.NOT_OPTIMAL), never)
    assert len(unsolved.route.refinement.levels) == 1 and not unsolved.success
    stubborn = refine_step_size(coarse, never)
    assert len(stubborn.route.refinement.levels) == HALVINGS + 1
    assert stubborn.route.refinement.stopped.startswith(f"h was halved {HALVINGS} times; ")
    assert stubborn.iterations == coarse.iterations + HALVINGS


def test_a_step_size_that_is_chosen_is_halved_by_its_bounds() -> None:
    """Otherwise its lower bound would keep it large, and more steps would only extend the horizon."""
    problem = get("half-cheetah")
    values = dict(zip(problem.parameters.names, problem.parameters.values, strict=True))
    low, high = values["h_min"], values["h_max"]
    assert divided_step(problem, values, 4) == {"N": 4 * problem.N, "h_min": low / 4, "h_max": high / 4}


def test_growth_is_that_of_a_linear_system() -> None:
    """For an unstable cart with a distant wall, growth is the largest entry of powers of A."""
    A = np.array([[1.1, 0.1], [0.2, 1.0]])
    system = lcs("fall", A=A, B=[[0.0], [0.1]], C=[[0.0], [0.0]], D=[[0.0, 0.0]], E=[[0.0]], F=[[1.0]], d=[1.0])
    problem = Problem(
        "fall",
        system,
        20,
        stage_cost=ca.sumsqr(system.u),
        terminal_cost=ca.sumsqr(system.x),
        x0=ca.DM([0.1, 0.0]),
        parameters=system.parameters,
        scaling=Scaling(x=0.5),
    )
    found = solve(problem, Exact())
    powers = [np.linalg.matrix_power(A, k) for k in range(21)]
    assert perturbation_growth(found) == pytest.approx(np.abs(powers).max(), rel=1e-5)
