"""Settings and solvers by name: which are read, passed on, or rejected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynamics.contact import Adaptive, Barrier, Exact
from ocp import Direct, Feedback, InputError, MultipleShooting, SingleShooting, Status, solve
from ocp.programs.solver import SOLVERS, Solver
from ocp.routes.relaxations import DEFAULT_STRATEGY, STRATEGIES
from ocp.solve.request import Settings, literal
from problems import get


def test_own_settings_are_read_and_the_rest_is_the_solvers() -> None:
    read = Settings.read(
        {
            "homotopy": "No",
            "factor": "0.3",
            "homotopy_start": "1e-2",
            "strategy": "l1",
            "jit": "false",
            "ipopt.max_iter": "7",
            "tol": "1e-6",
            "linear_solver": "mumps",
            "print_user_options": "true",
        }
    )
    assert read.homotopy is False
    assert (read.factor, read.homotopy_start, read.strategy, read.jit) == (0.3, 0.01, "l1", False)
    options = {"max_iter": 7, "tol": 1e-6, "linear_solver": "mumps", "print_user_options": True}
    assert read.options == options
    assert [type(value) for value in read.options.values()] == [int, float, str, bool]


def test_nothing_given_nothing_chosen() -> None:
    read = Settings.read({})
    assert read.homotopy is None
    assert read.strategy == DEFAULT_STRATEGY
    assert DEFAULT_STRATEGY in STRATEGIES
    assert read.options == {}


@pytest.mark.parametrize(
    ("word", "value"),
    [("3", 3), ("3.5", 3.5), ("1e-3", 1e-3), ("TRUE", True), ("false", False), ("mumps", "mumps"), (5, 5), ("-2", -2)],
)
def test_words_that_read_as_numbers_are_numbers(word: object, value: object) -> None:
    assert literal(word) == value
    assert type(literal(word)) is type(value)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"homotopy": "maybe"}, "homotopy must be true or false"),
        ({"jit": "2"}, "jit must be true or false"),
        ({"factor": "1.0"}, "factor must be a number > 0 and < 1, got 1"),
        ({"factor": "-0.5"}, "factor must be a number > 0 and < 1"),
        ({"factor": "small"}, "must be a number"),
        ({"factor": "nan"}, "must be a finite number > 0 and < 1, got 'nan'"),
        ({"homotopy_start": "inf"}, "must be a finite number > 0, got 'inf'"),
        ({"homotopy_start": "0"}, "must be a number > 0, got 0"),
        ({"strategy": "penalty"}, "strategy must be .*'scholtes'.*, got 'penalty'"),
    ],
)
def test_bad_settings_get_their_sentence(settings: dict[str, str], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        Settings.read(settings)


def test_options_reach_the_solver() -> None:
    found = solve(get("push-1d", N=6), Barrier(mu=1e-2), settings={"max_iter": 2})
    assert found.status is Status.ITERATION_LIMIT
    assert found.record["solver_options"] == {"max_iter": 2}
    assert not found.success


@pytest.mark.parametrize(
    ("solver", "settings"),
    [
        ("ipopt", {"tol": "tight"}),
        ("uno", {"logger": "nonsense"}),
    ],
)
def test_a_refused_option_is_wrong_usage(solver: str, settings: dict[str, object]) -> None:
    with pytest.raises(InputError, match=rf"{solver} rejected its options|the options of {solver}"):
        solve(get("push-1d", N=3), Barrier(mu=1e-2), solver=solver, settings=settings)


@pytest.mark.parametrize("solver", ["ipopt", "fatrop", "sleqp"])
def test_an_unknown_option_is_told_where_they_are_listed(solver: str) -> None:
    with pytest.raises(
        InputError,
        match=rf"'no_such_option'.*and ocp settings {solver}$",
    ):
        solve(get("push-1d", N=3), Barrier(mu=1e-2), solver=solver, settings={"no_such_option": 1})


def test_an_unknown_solver_is_told_which_there_are() -> None:
    with pytest.raises(InputError, match=r"unknown solver 'snopt'.*ipopt, fatrop, uno, sleqp"):
        Solver("snopt")


@pytest.mark.costly
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("law", [Barrier(mu=1e-2), Exact()], ids=["barrier", "exact"])
def test_every_solver_finds_the_same_optimum(solver: str, law, capfd) -> None:
    found = solve(get("push-1d"), law, Direct(), solver=solver)
    reference = solve(get("push-1d"), law, Direct())
    assert found.success
    assert found.cost == pytest.approx(reference.cost, rel=1e-6)
    assert found.record["solver"] == solver
    assert found.iterations > 0
    printed = capfd.readouterr()
    assert printed.out == "", "stdout belongs to --json"
    assert printed.err == "", "a solver's warnings are none of the user's"


@pytest.mark.costly
def test_uno_is_as_exact_as_the_audit_asks() -> None:
    found = solve(get("push-disc"), Barrier(mu=1e-3), solver="uno")
    assert found.success and max(one.amount for one in found.audit.worst) < 1e-8


def test_an_answer_that_another_solver_did_not_find_names_the_solver() -> None:
    given = {"settings": {"max_iterations": 2, "homotopy": False}}
    found = solve(get("push-disc"), Barrier(mu=1e-3), solver="uno", **given)
    assert not found.success
    assert found.findings[-1].numbers == {"solver": "uno"}


def test_bounds_that_cross_are_wrong_usage() -> None:
    problem = replace(get("push-1d", N=3), x_lower=1.0, x_upper=-1.0)
    with pytest.raises(InputError, match=r"lower bound of qu in x is 1, above its upper bound -1"):
        solve(problem, Barrier(mu=1e-2), Direct())


@pytest.mark.parametrize("starts", [0, -1, 10_001])
def test_a_number_of_starts_out_of_range_is_wrong_usage(starts: int) -> None:
    with pytest.raises(InputError, match="starts must be"):
        solve(get("push-1d", N=3), Barrier(mu=1e-2), n_starts=starts)


def test_a_frozen_gradient_is_not_for_direct() -> None:
    with pytest.raises(InputError, match="frozen"):
        solve(get("push-1d", N=3), Adaptive(gradient="frozen"), Direct())


@pytest.mark.parametrize("arguments", [{"penalty": -1.0}, {"penalty": float("inf")}, {"bound": 0.0}, {"bound": -1.0}])
def test_bad_feedback_is_wrong_usage(arguments: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(arguments))):
        Feedback(**arguments)


@pytest.mark.one_case_in(3)
@pytest.mark.parametrize("method", [Direct(), MultipleShooting(), SingleShooting()])
def test_feedback_under_a_bound_keeps_to_it(method) -> None:
    problem = get("push-disc", N=5, scenarios=3)
    policy = Feedback(bound=0.05)
    found = solve(problem, Barrier(mu=1e-2), method, policy, settings={"homotopy": False})
    assert found.success
    size = np.abs(found.data["K"]).max()
    assert 0.04 < size <= 0.05 + 1e-8, "the bound is felt, and kept"
