"""The best known values that the problem files state are reached, and by nothing undercut."""

from __future__ import annotations

from dataclasses import replace

import pytest

import problems
from ocp.routes.relaxations import DEFAULT_STRATEGY
from tests.golden.known import BETTER, STATED, better, fault, reached, session_of, solved

LONG = {("hopper", "exact"), ("hopper", "barrier mu=1e-3"), ("half-cheetah", "barrier mu=1e-3")}
"""A quarter to half a minute each."""
MACHINES = ("hopper", "half-cheetah")
QUICK = [name for name in problems.names() if name not in (*MACHINES, "planar-hand")]
STRATEGIES = (DEFAULT_STRATEGY, "scholtes-adaptive", "scholtes")


def stated() -> list:
    """Every stated value, the long ones marked."""
    marks = {key: (pytest.mark.slow,) if key in LONG else () for key in STATED}
    return [pytest.param(*key, marks=marks[key]) for key in STATED]


def test_every_problem_states_its_exact_value() -> None:
    assert {name for name, key in STATED if key == "exact"} == set(problems.names())


@pytest.mark.parametrize(("name", "key"), stated())
def test_the_stated_value_is_reached_as_stated(name: str, key: str) -> None:
    golden = problems.spec(name).golden[key]
    assert (golden.law, golden.method) == (key.partition(" ")[0], "direct")
    assert fault(golden, reached(name, key)) == ""


def undercut(name: str, key: str, strategies: tuple[str, ...], guesses: range) -> list[str]:
    """Strategies and guesses whose certified answer is better than the stated one."""
    golden = problems.spec(name).golden[key]
    found = []
    for strategy in strategies:
        session = session_of(name, key, strategy=strategy)
        for guess in guesses:
            one = solved(session, guess)
            found += [f"{strategy}, {guess}: {one.cost:.10g}"] if better(golden, one) else []
    return found


@pytest.mark.parametrize(
    "name",
    [*QUICK, "planar-hand", *(pytest.param(name, marks=pytest.mark.slow) for name in MACHINES)],
)
def test_no_strategy_undercuts_the_stated_value(name: str) -> None:
    assert undercut(name, "exact", STRATEGIES, range(1)) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", [*QUICK, "planar-hand"])
def test_no_perturbed_guess_undercuts_the_stated_value(name: str) -> None:
    assert undercut(name, "exact", STRATEGIES, range(1, 6)) == []
    if "barrier mu=1e-3" in problems.spec(name).golden:
        assert undercut(name, "barrier mu=1e-3", (DEFAULT_STRATEGY,), range(1, 6)) == []


def test_a_stated_value_that_is_no_optimum_is_caught() -> None:
    """Both ways: a better answer is certified, and the stated one is out of reach."""
    golden, found = problems.spec("wall-1d").golden["exact"], reached("wall-1d", "exact")
    assert fault(golden, found) == ""
    assert "state that" in fault(replace(golden, cost=golden.cost * (1 + 3 * BETTER)), found)
    assert "only" in fault(replace(golden, cost=golden.cost * (1 - 3 * BETTER)), found)
    assert "certificate" in fault(replace(golden, stationarity="not", kind=""), found)
    wide = replace(golden, cost=golden.cost * (1 + 3 * BETTER), tolerance=1e-4)
    assert "state that" in fault(wide, found), "however wide the tolerance"
