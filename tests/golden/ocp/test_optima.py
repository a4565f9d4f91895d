"""Optima of the five named problems: methods and laws agree, and exact solutions are exact."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from dynamics.contact import Barrier, Exact
from ocp import Direct, MultipleShooting, SingleShooting, Solution, Status, solve
from ocp.routes.relaxations import STRATEGIES
from problems import get, spec

FIVE = ("wall-1d", "push-1d", "push-disc", "ball-bounce", "cart-walls")
# An unstable pole over two seconds makes rolled-out iterates wild: many iterations from rest.
SLOW = pytest.mark.slow


@functools.cache
def barrier(name: str) -> Solution:
    return solve(get(name), Barrier(mu=1e-3), Direct())


@functools.cache
def exact(name: str, strategy: str | None = None) -> Solution:
    settings = {} if strategy is None else {"strategy": strategy}
    return solve(get(name), Exact(), Direct(), settings=settings)


@pytest.mark.cheap_cases("cart-walls-method10")
@pytest.mark.parametrize(
    ("name", "method"),
    [(name, MultipleShooting()) for name in (*FIVE, "ball-throw")]
    + [pytest.param(name, SingleShooting(), marks=SLOW if name == "cart-walls" else ()) for name in FIVE],
)
def test_methods_agree_on_the_barrier_optimum(name: str, method) -> None:
    reference, found = barrier(name), solve(get(name), Barrier(mu=1e-3), method)
    assert reference.success
    assert found.success
    assert found.cost == pytest.approx(reference.cost, rel=1e-6)
    assert found.audit.exact_cost == pytest.approx(reference.audit.exact_cost, rel=1e-4)
    np.testing.assert_allclose(found.data["lam"] * found.data["gap"], 1e-3, atol=1e-9)


@pytest.mark.costly
@pytest.mark.parametrize("name", FIVE)
def test_a_thin_barrier_meets_the_exact_optimum(name: str) -> None:
    thin = solve(get(name), Barrier(mu=1e-9), Direct())
    assert thin.success
    assert thin.cost == pytest.approx(exact(name).cost, rel=1e-4)


@pytest.mark.cheap_cases("wall-1d")
@pytest.mark.parametrize("name", FIVE)
def test_next_to_the_exact_optimum_lies_a_thin_barriers(name: str) -> None:
    found = exact(name)
    plan = found.data["x"].values[0], found.data["u"].values[0]
    problem = replace(get(name), guess=lambda problem, p: plan)
    thin = solve(problem, Barrier(mu=1e-9), Direct(), settings={"homotopy": False, "mu_init": 1e-6})
    assert thin.success
    assert thin.cost == pytest.approx(found.cost, rel=1e-4)


@pytest.mark.cheap_cases("wall-1d", "push-1d")
@pytest.mark.parametrize("name", FIVE)
def test_the_exact_answer_is_exact(name: str) -> None:
    found = exact(name)
    assert found.status is Status.SOLVED
    lam, gap = found.data["lam"].values, found.data["gap"].values
    assert np.abs(lam * gap).max() <= 1e-8
    assert np.abs(np.minimum(lam, gap)).max() <= 1e-8
    assert found.audit.complementarity == np.abs(lam * gap).max()
    assert found.audit.dynamics_residual <= 1e-8
    assert found.audit.exact_cost == pytest.approx(found.cost, rel=1e-5)
    assert (lam > 1e-6).sum() == found.audit.active_steps > 0
    bound = found.values["u_max"] + 1e-8
    assert np.abs(found.data["u"]).max() <= bound


@pytest.mark.cheap_cases("wall-1d", "push-1d")
@pytest.mark.parametrize("name", FIVE)
def test_polish_makes_complementarity_hold_to_rounding(name: str) -> None:
    found = exact(name)
    before = [line for line in found.stages if line.label == "t"]
    after = [line for line in found.stages if line.label == "active set" and line.accepted]
    assert before and after
    assert before[-1].complementarity > 1e-12, "there was something left to polish away"
    assert found.audit.complementarity < 1e-12
    assert np.minimum(found.data["lam"], found.data["gap"]).max() < 1e-11


@pytest.mark.cheap_cases("push-1d-l1-quick")
@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("name", ["push-1d", "cart-walls"])
def test_every_strategy_ends_complementary_at_the_same_cost(name: str, strategy: str) -> None:
    found = exact(name, strategy)
    assert found.success
    assert found.audit.complementarity <= 1e-8
    assert found.audit.dynamics_residual <= 1e-8
    assert found.record["strategy"] == strategy
    assert found.cost == pytest.approx(exact(name).cost, rel=5e-3)


# A disc that is never touched has no contact schedule to exchange.
IDLE = {("push-disc", "l1")}


@pytest.mark.slow
@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("name", ["wall-1d", "push-disc", "ball-bounce"])
def test_every_strategy_ends_complementary_where_it_is_known_to(name: str, strategy: str) -> None:
    found, idle = exact(name, strategy), (name, strategy) in IDLE
    assert found.cost == pytest.approx(12.75 if idle else spec(name).golden["exact"].cost, rel=1e-6)
    assert (found.status is Status.SOLVED) != idle
    assert (found.audit.active_steps > 0) != idle
    assert found.audit.complementarity <= 1e-8
    assert found.audit.dynamics_residual <= 1e-8
    assert found.audit.exact_cost == pytest.approx(found.cost, rel=1e-5)


@pytest.mark.cheap_cases("method0-None")
@pytest.mark.parametrize("homotopy", [None, True])
@pytest.mark.parametrize("method", [MultipleShooting(), SingleShooting()])
def test_at_a_kink_shooting_takes_a_plan_made_otherwise(method, homotopy: bool | None) -> None:
    """wall-1d ends at rest at the wall, where the exact law has a kink instead of a zero gradient.

    The plan is that of the complementarity problem or, with homotopy, the limit of the barrier law's.
    """
    settings = {} if homotopy is None else {"homotopy": homotopy}
    found = solve(get("wall-1d"), Exact(), method, settings=settings)
    assert found.success
    assert ("mu" in {line.label for line in found.stages}) == bool(homotopy)
    assert found.cost == pytest.approx(exact("wall-1d").cost, rel=1e-6)
    assert found.audit.state_gap == 0.0
