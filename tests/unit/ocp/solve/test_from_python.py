"""Python arguments and representations: typed parameters and settings, guesses, short printed forms."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import problems
from dynamics.contact import Barrier, Exact, Randomized
from ocp import InputError, Settings, Solution, solve
from problems.library import push_1d
from tests.named import named


@pytest.fixture(scope="module")
def solved() -> Solution:
    return solve(push_1d.Params(M=2.0, N=8), Barrier(mu=1e-2))


def test_typed_parameters_are_those_by_name(solved: Solution) -> None:
    named = solve("push-1d", Barrier(mu=1e-2), M=2.0, N=8)
    assert named.cost == solved.cost
    np.testing.assert_array_equal(named.data["x"].values, solved.data["x"].values)
    assert problems.get(push_1d.Params(M=2.0)).parameters.defaults["M"] == 2.0


def test_typed_settings_are_those_by_name() -> None:
    settings = Settings(strategy="scholtes", options={"tol": 1e-7})
    typed = solve(push_1d.Params(N=4), settings=settings, effort="quick")
    words = solve("push-1d", N=4, settings={"strategy": "scholtes", "tol": 1e-7}, effort="quick")
    assert typed.cost == words.cost
    assert typed.iterations == words.iterations


GUESSES: dict[str, Callable[[Solution], Any]] = {
    "solution": lambda found: found,
    "dataset": lambda found: found.data,
    "arrays": lambda found: (found.data["x"].values[0], found.data["u"].values[0]),
}


@pytest.mark.one_case_in(3)
@pytest.mark.parametrize("kind", GUESSES)
def test_a_solution_as_guess_is_where_a_solve_begins_and_ends(kind: str, solved: Solution) -> None:
    guess = GUESSES[kind](solved)
    problem = problems.get(push_1d.Params(M=2.0, N=8))
    again = solve(problem, Barrier(mu=1e-2), guess=guess, settings={"homotopy": False})
    assert again.cost == pytest.approx(solved.cost, rel=1e-7)
    cold = solve(problem, Barrier(mu=1e-2), settings={"homotopy": False})
    assert again.iterations < cold.iterations


def test_a_solution_on_another_horizon_is_resampled(solved: Solution) -> None:
    assert solve("push-1d", Barrier(mu=1e-2), M=2.0, N=12, guess=solved).certificate.certified


@pytest.mark.parametrize(
    ("guess", "said"),
    [
        ((np.zeros((3, 2)), np.zeros((8, 1))), "expected (9, 2) and (8, 1)"),
        ((np.full((9, 2), np.nan), np.zeros((8, 1))), "must be finite"),
        (3, "must be two arrays"),
    ],
    ids=["shape", "nan", "kind"],
)
def test_a_guess_that_does_not_fit_is_refused(guess: Any, said: str) -> None:
    with pytest.raises(InputError) as told:
        solve("push-1d", N=8, guess=guess)
    assert said in str(told.value)


def test_a_start_and_a_guess_are_one_too_many(solved: Solution) -> None:
    with pytest.raises(InputError, match="give one of them"):
        solve("push-1d", N=8, warm_start=solved, guess=solved)


@pytest.mark.one_case_in(4)
@pytest.mark.parametrize("name", problems.names())
def test_a_problem_prints_in_ten_lines_with_units(name: str) -> None:
    problem = named(name)
    lines = repr(problem).splitlines()
    assert len(lines) == 10 and max(map(len, lines)) < 100
    state = problem.system.states[0]
    assert f"{state.name} [{state.unit}]" in lines[2]


def test_a_law_prints_as_it_is_made() -> None:
    for law in (Exact(), Barrier(mu=1e-3), Randomized(sigma=0.2, base=Barrier(mu=1e-2))):
        assert repr(eval(repr(law))) == repr(law)
