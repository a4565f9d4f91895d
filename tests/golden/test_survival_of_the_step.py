"""Survival of a plan at a quarter of its step size: the three grades, and the reasons for them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynamics.contact import Exact
from ocp import Solution, solve
from ocp.judge.findings import make_finding
from ocp.judge.referee import COST_SHARE, quarter_step_findings, referee_plan
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import Rollout, roll_out
from problems import get
from tests.findings import numbers


def at_a_quarter(found: Solution) -> float:
    """Return the cost, at the plan's nodes, of its inputs held over four steps of h/4.

    Steps are those of the problem at h/4, here one by one; cart-walls has a linear model.
    """
    problem, values = found.problem, found.values
    fine = get(problem.name, N=4 * problem.N)
    u = found.data["u"].values
    rolled = roll_out(
        fine,
        np.repeat(u, 4, axis=1),
        values | {"h": values["h"] / 4},
        fine.referee_step,
        found.data["x"].values[:, 0],
    )
    p, x, du = problem.parameters.pack(values), rolled.x[0, ::4], 0 * u[0, 0]
    stages = sum(float(problem.cost_terms(x[k], u[0, k], du, 0, p)[0]) for k in range(problem.N))
    return stages + float(problem.cost_terms(x[-1], u[0, -1], du, 0, p)[1])


@pytest.mark.costly
def test_a_plan_that_only_its_step_holds_up_is_amber() -> None:
    """In cart-walls the pole is caught by walls whose force at h = 0.04 differs from that at 0.01."""
    found = solve(get("cart-walls"), Exact())
    finer = at_a_quarter(found)
    assert finer > 10 * found.cost and found.referee.refined_cost == pytest.approx(finer, rel=1e-6)
    assert (found.referee.survives, found.referee.survives_at_h) == (False, True)
    assert found.referee.word == "survives at this step only"
    assert found.headline.endswith(f"; survives at this step only: at h/4 it costs {finer:.6g}.")
    assert found.success and found.grade == "certified"


@pytest.mark.costly_cases("ball-bounce")
@pytest.mark.parametrize("name", ["ball-bounce", "box-slide"])
def test_a_plan_that_holds_at_a_quarter_survives(name: str) -> None:
    found = solve(get(name), Exact())
    finer = at_a_quarter(found)
    assert abs(finer - found.cost) <= COST_SHARE * abs(found.cost)
    assert found.referee.refined_cost == pytest.approx(finer, rel=1e-9)
    assert (found.referee.word, found.grade) == ("survives", "survives")
    assert found.headline.endswith("; survives.")


@pytest.mark.costly_cases("wall-1d")
@pytest.mark.parametrize("name", ["push-1d", "wall-1d"])
def test_a_step_that_is_part_of_the_model_is_judged_alone(name: str) -> None:
    found = solve(get(name), Exact())
    assert np.isnan(found.referee.refined_cost) and found.referee.refined_note
    assert (found.referee.survives, found.referee.survives_at_h) == (True, True)


@pytest.mark.costly
def test_each_bound_of_the_finer_replay_is_a_reason_alone() -> None:
    """The replay at h/4 is changed to exceed its cost, a bound or the floor, or to be NaN."""
    found = solve(get("ball-bounce"), Exact())
    problem, values, data = found.problem, found.values, found.data
    x, u, lam, gap = (data[name].values for name in ("x", "u", "lam", "gap"))
    plan = Rollout(x, u, lam, gap, lam, np.array([found.cost]))
    report, sharp = referee_plan(Evaluation(problem, values), problem.exact_step, plan)
    assert report.refined_reasons == [] and sharp.refined is not None
    own = sharp.refined

    def reasons(cost: float = found.cost, note: str = "", low: float = 0.0, at: int = 4) -> list[str]:
        moved = own.x.copy()
        moved[0, at, 1] -= low
        there = replace(own, x=moved, costs=np.array([cost]))
        seen = replace(sharp, refined=there, refined_note=note)
        return [finding.code for finding in quarter_step_findings(Evaluation(problem, values), plan, seen)]

    assert reasons() == reasons((1 + 0.99 * COST_SHARE) * found.cost) == []
    dear = (1 + 1.01 * COST_SHARE) * found.cost
    assert reasons(dear) == ["costs-more-at-quarter-step"]
    assert reasons(np.nan) == ["quarter-step-cost-not-finite"]
    assert reasons(note="step 3") == ["replay-stops"]
    assert "bodies-penetrate" in reasons(low=own.x[0, 4, 1] + 0.2)


def test_what_is_at_fault_at_the_step_itself_is_told_first() -> None:
    found = solve(get("box-slide"), Exact(), effort="quick")
    of = replace(
        found.referee,
        findings=[make_finding("bodies-penetrate", amount=0.1)],
        refined_findings=[make_finding("costs-more-at-quarter-step", cost=9.0)],
        refined_cost=9.0,
    )
    bad = replace(found, referee=of)
    assert bad.headline.endswith("; does not survive.") and bad.grade == "certified"
    assert numbers(bad, "bodies-penetrate") == {"amount": 0.1} and numbers(bad, "quarter-step-cost") == {"cost": 9.0}
    assert "does not survive: bodies penetrate by 0.1; at a quarter of the step size it costs 9" in bad.verdict


@pytest.mark.costly
def test_a_cut_between_nodes_is_told_with_its_tolerance() -> None:
    """The verdict on a plan that survives says how far its straight motion enters a body, and how far it may."""
    found = solve(get("planar-push", friction=0.0, gap="true"), Exact())
    cut = found.referee.replay_between
    assert found.referee.survives and cut is not None and cut.amount > 1e-3
    told = numbers(found, "cuts-through")
    tolerance = told["tolerance"]
    assert told == {"contact": cut.contact, "amount": cut.amount, "step": cut.step, "tolerance": tolerance}
    assert cut.amount < tolerance <= 0.1 * found.problem.scales.gap
