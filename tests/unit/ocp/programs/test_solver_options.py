"""Options of solvers have types and ranges; values outside are rejected with a message of one sentence."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Any

import casadi as ca
import pytest

from dynamics.settings import Setting
from ocp.errors import InputError
from ocp.programs.options import LOOSEST, MAX_INTEGER, _ipopt, check_options, has_option

IPOPT = _ipopt()
NUMBERS = [name for name, option in IPOPT.items() if option.annotation is not str]
ENDS = ("max_iter", "print_level", "tol", "tau_min", "obj_scaling_factor")
"""One option for each kind of range: integer or real, closed or open, with one, two or no ends."""


def ipopt_takes(name: str, value: Any) -> bool:
    """Return whether IPOPT accepts the option ``name`` at ``value``."""
    x = ca.MX.sym("x")
    options = {"print_time": False, "ipopt": {name: value}}
    try:
        ca.nlpsol("probe", "ipopt", {"x": x, "f": x**2}, options)
    except RuntimeError:
        return False
    return True


def ends_of_range(option: Setting) -> list[float]:
    """Return the ends of an option's range, without the largest integer."""
    bounds = option.declaration.metadata
    ends = [getattr(bound, sign, None) for bound in bounds for sign in ("gt", "ge", "lt", "le")]
    return [end for end in ends if end is not None and end != MAX_INTEGER]


def values(option: Setting) -> list[float]:
    """Return numbers at and on both sides of the ends of an option's range."""
    step = 1 if option.annotation is int else 0.25
    numbers = [end + shift for end in ends_of_range(option) for shift in (-step, 0, step)] or [0, 7]
    return [option.annotation(number) for number in numbers]


def takes(option: Setting, value: Any) -> bool:
    """Return whether the declaration of an option accepts a value."""
    with suppress(InputError):
        option.read(value)
        return True
    return False


def test_every_option_of_ipopt_is_known_with_its_type() -> None:
    types = [option.annotation for option in IPOPT.values()]
    assert len(types) > 250
    assert {kind: types.count(kind) > 40 for kind in set(types)} == {int: True, float: True, str: True}
    assert sum(bool(ends_of_range(IPOPT[name])) for name in NUMBERS) > 0.85 * len(NUMBERS)
    assert IPOPT["max_iter"].annotation is int and IPOPT["linear_solver"].extra("words", [])[7] == "mumps"


@pytest.mark.parametrize(
    "name",
    [pytest.param(x, marks=() if x in ENDS else pytest.mark.slow) for x in NUMBERS],
)
def test_ipopt_takes_the_numbers_that_are_said_to_be_taken(name: str, capfd) -> None:
    option = IPOPT[name]
    for value in values(option):
        assert takes(option, value) == ipopt_takes(name, value), value


@pytest.mark.parametrize(
    ("solver", "option", "sentence"),
    [
        ("ipopt", {"max_iter": 1.5}, "max_iter must be a whole number >= 0 and <= 2147483647, got 1.5"),
        ("ipopt", {"max_iter": 2**31}, "max_iter must be a whole number"),
        ("ipopt", {"max_iter": True}, "max_iter must be a whole number"),
        ("ipopt", {"tol": math.inf}, "tol must be a finite number > 0"),
        ("ipopt", {"tol": 1e-3}, "tol must be at most 0.0001"),
        ("ipopt", {"linear_solver": "mump"}, "'ma27' or .*did you mean 'mumps'"),
        ("ipopt", {"max_itr": 3}, "did you mean 'max_iter'"),
        ("fatrop", {"max_iter": 1.5}, "max_iter must be a whole number"),
        ("fatrop", {"max_itr": 3}, "max_itr"),
        ("uno", {"max_iter": 3}, "did you mean 'max_iterations'"),
        ("uno", {"primal_tolerance": math.nan}, "must be a finite number"),
        ("sleqp", {"feas_tol": "x"}, "feas_tol must be a number"),
        ("sleqp", {"max_newton_iterations": 1.5}, "must be a whole number"),
    ],
)
def test_what_a_solver_cannot_take_is_refused(solver: str, option: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=f"{solver} rejected its options: .*{sentence}"):
        check_options(solver, option)


def test_what_a_solver_takes_is_passed_on() -> None:
    assert check_options("ipopt", {"max_iter": 7.0, "print_user_options": False}) == {
        "max_iter": 7,
        "print_user_options": "no",
    }
    assert check_options("fatrop", {"tol": 1e-6}) == {"tol": 1e-6}
    assert check_options("ipopt", LOOSEST_OF_IPOPT) == LOOSEST_OF_IPOPT
    assert has_option("ipopt", "mu_strategy") and not has_option("uno", "mu_strategy")


LOOSEST_OF_IPOPT = {name: most for name, most in LOOSEST.items() if name in IPOPT}
