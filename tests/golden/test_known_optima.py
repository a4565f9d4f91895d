"""Solves reach the best known costs that the problem files state, and none is cheaper."""

from __future__ import annotations

from dataclasses import replace

import pytest

import problems
from dynamics.contact import Exact
from ocp.routes.relaxations import DEFAULT_STRATEGY
from ocp.solve.solve import solve
from tests.golden.known import BETTER, STATED, better, fault, reached, session_of, solved

SPACE = ("quadruped", "ant", "push-cube", "reorient")
"""Cases that take more than half a minute."""
LONG = {
    *((name, key) for name, key in STATED if name in SPACE),
    ("hopper", "exact"),
    ("hopper", "barrier mu=1e-3"),
    ("half-cheetah", "barrier mu=1e-3"),
}
"""Cases that take a quarter to half a minute each."""
MACHINES = ("hopper", "half-cheetah", *SPACE)
QUICK = [name for name in problems.names() if name not in (*MACHINES, "planar-hand")]
HALF_A_MINUTE = ("ball-throw", "planar-hand", *MACHINES)
"""Cases for which three strategies take half a minute."""
STRATEGIES = (DEFAULT_STRATEGY, "scholtes-adaptive", "scholtes")


def stated() -> list:
    """Return a test case for every stated value, the long ones marked as slow."""
    marks = {key: (pytest.mark.slow,) if key in LONG else () for key in STATED}
    return [pytest.param(*key, marks=marks[key]) for key in STATED]


def test_every_problem_states_its_exact_value() -> None:
    assert {name for name, key in STATED if key == "exact"} == set(problems.names())


@pytest.mark.costly_cases("push-box-exact")
@pytest.mark.one_case_in(11)
@pytest.mark.parametrize(("name", "key"), stated())
def test_the_stated_value_is_reached_as_stated(name: str, key: str) -> None:
    golden = problems.spec(name).golden[key]
    assert (golden.law, golden.method) == (key.partition(" ")[0], "direct")
    assert fault(golden, reached(name, key)) == ""


DRAWN = {
    "mc": 2.2205,
    "mp": 0.0932,
    "l": 0.4108,
    "wall": 0.3335,
    "k": 106.0,
    "h": 0.033,
    "w_end": 90.53,
    "u_max": 2.3294,
}
"""Parameters of walls between which all relaxations on the central path end at the cost 1915.75."""


@pytest.mark.costly
@pytest.mark.parametrize("starts", [1, pytest.param(20, marks=pytest.mark.slow)])
def test_a_hard_path_is_left_for_one_beside_it(starts: int) -> None:
    found = solve(problems.get("cart-walls", **DRAWN), Exact(), n_starts=starts)
    assert found.success and found.cost <= 289.1509191


def undercut(name: str, key: str, strategies: tuple[str, ...], guesses: range) -> list[str]:
    """Return the strategies and guesses whose certified solution is better than the stated one."""
    golden = problems.spec(name).golden[key]
    found = []
    for strategy in strategies:
        session = session_of(name, key, strategy=strategy)
        for guess in guesses:
            one = solved(session, guess)
            found += [f"{strategy}, {guess}: {one.cost:.10g}"] if better(golden, one) else []
    return found


@pytest.mark.costly
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] if name in HALF_A_MINUTE else []) for name in problems.names()],
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
    """It is caught if a better solution is certified, and if the stated cost is not reached."""
    golden, found = problems.spec("wall-1d").golden["exact"], reached("wall-1d", "exact")
    assert fault(golden, found) == ""
    assert "state that" in fault(replace(golden, cost=golden.cost * (1 + 3 * BETTER)), found)
    assert "only" in fault(replace(golden, cost=golden.cost * (1 - 3 * BETTER)), found)
    assert "certificate" in fault(replace(golden, stationarity="not", kind=""), found)
    wide = replace(golden, cost=golden.cost * (1 + 3 * BETTER), tolerance=1e-4)
    assert "state that" in fault(wide, found), "however wide the tolerance"
