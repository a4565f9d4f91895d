"""The largest cost at which a remedy survives: its formula, and remedies on both sides of it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from ocp import Solution, solve
from ocp.programs.solver import Status
from ocp.solve.best_gains import plan_of
from ocp.solve.comparable_cost import DEARER_SHARE, USEFUL_SHARE, largest_surviving_cost
from tests.findings import numbers

QUICK: dict[str, Any] = {"effort": "quick"}
SIZE = 0.5
"""Characteristic size [m] of the states and inputs of push-1d."""


@cache
def pushed() -> Solution:
    """The exact plan of push-1d."""
    return solve("push-1d", "exact", **QUICK)


def cost_of_push(x: np.ndarray, u: np.ndarray, p: dict[str, float]) -> float:
    """Cost of push-1d, from its equations."""
    squares = (x[:, 0] - p["goal_x"]) ** 2
    du = np.diff(u, prepend=p["qa0"])
    return float(p["w_x"] * squares[:-1].sum() + p["w_du"] * (du**2).sum() + p["w_end"] * squares[-1])


def limit_of(first: Solution) -> float:
    return largest_surviving_cost(first, *plan_of(first, first.problem.exact_step))


@pytest.mark.costly
def test_half_of_what_a_plan_can_change_is_the_limit() -> None:
    first = pushed()
    x, u = first.data["x"].values[0], first.data["u"].values[0, :, 0]
    J = cost_of_push(x, u, first.values)
    assert first.cost == pytest.approx(J, rel=1e-9)
    # The object stays 1 m from its goal: 20 steps of weight 1, and the end of weight 100.
    assert first.idle_cost == pytest.approx(120.0, rel=1e-9)
    span = max(abs(cost_of_push(x + s, u + s, first.values) - J) for s in (-SIZE, SIZE))
    assert span < 120 - J and limit_of(first) == pytest.approx(J + USEFUL_SHARE * span, rel=1e-9)
    for idle, changeable in ((J + 0.8 * span, 0.8 * span), (np.nan, span), (np.inf, span)):
        assert limit_of(replace(first, idle_cost=idle)) == pytest.approx(J + USEFUL_SHARE * changeable, rel=1e-9)
    # A plan that gains nothing leaves room for rounding errors alone.
    for idle in (J, 0.5 * J):
        assert limit_of(replace(first, idle_cost=idle)) == pytest.approx((1 + DEARER_SHARE) * J, rel=1e-12)
    assert limit_of(replace(first, status=Status.NO_PROGRESS)) == np.inf


@pytest.mark.costly
@pytest.mark.parametrize(("u_max", "survives"), [(2.0, True), (0.5, False)])
def test_a_remedy_survives_on_one_side_of_the_limit_only(u_max: float, survives: bool) -> None:
    """A hand that pushes at a distance, mu = 0.3 N s m, is given contact at no distance; too short, it does little.

    Contact at no distance is a plan that survives relative to itself, however much it costs.
    """
    exact = solve("push-1d", "exact", u_max=u_max, **QUICK)
    assert exact.success and exact.referee.survives
    answer = solve("push-1d", "barrier", mu=0.3, u_max=u_max, until="survives", **QUICK)
    ladder = answer.route.ladder
    assert ladder is not None
    first, sharp = ladder.rungs[0], ladder.rungs[1]
    assert (first.survives, sharp.name) == (False, "the most exact contact model")
    assert sharp.cost == pytest.approx(exact.cost, rel=1e-6) and answer.success
    assert (sharp.cost <= ladder.largest_cost) is sharp.survives is answer.referee.survives is survives
    if survives:
        assert ladder.answer is sharp and len(ladder.rungs) == 2
        return
    # Gains and a controller are tried next; no rung is below the limit, and the cheapest is the answer.
    tried = [rung for rung in ladder.rungs[1:] if rung.survives is not None]
    names = {"the most exact contact model", "gains", "gains over scenarios", "a controller"}
    assert {rung.name for rung in tried} == names
    assert ladder.answer.cost == min(rung.cost for rung in tried) > ladder.largest_cost and not ladder.disturbed
    assert not any(rung.survives for rung in tried) and all("too much to survive" in rung.note for rung in tried)
    excess = {"cost": ladder.answer.cost, "planned": first.planned, "limit": ladder.largest_cost}
    assert numbers(answer, "remedy-costs-too-much") == excess
    share = ladder.answer.cost / first.planned - 1
    assert share > 1 and numbers(answer, "no-rung-survives")["difference"] == f"{round(100 * share, -1):.0f} % above"
    assert answer.headline.endswith("; does not survive.")
