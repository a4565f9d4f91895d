"""Axes of a sweep: spacing of values, names of parameters, and error messages."""

from __future__ import annotations

import numpy as np
import pytest

from ocp.errors import InputError
from ocp.jobs.grid import dimension_name, parse_axes, parse_axis
from ocp.jobs.sweep import make_grid
from ocp.solve.solve_request import SolveRequest
from ocp.validation import Axis


def test_values_stand_in_equal_steps_or_ratios_and_are_found_by_their_decimals() -> None:
    assert parse_axis("M=0:1:11").values == tuple(k / 10 for k in range(11))
    assert parse_axis(" M = 2:0.5:4 ") == Axis("M", (2.0, 1.5, 1.0, 0.5))
    ratios = parse_axis("contact.mu=1e-4:1e-1:4:log")
    assert ratios == Axis("contact.mu", (1e-4, 1e-3, 1e-2, 1e-1), log=True)


def test_arrays_are_taken_as_they_are() -> None:
    found = parse_axes({"M": np.array([1.0, 2.0, 4.0]), "N": [10, 20, 30], "mu": "1e-3:1e-2:2:log"})
    assert found == (
        Axis("M", (1.0, 2.0, 4.0), log=True),
        Axis("N", (10.0, 20.0, 30.0)),
        Axis("mu", (1e-3, 1e-2), log=True),
    )


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("M", "expected NAME=A:B:n, or NAME=A:B:n:log in equal ratios, got 'M'"),
        ("M=1:2", "--over M: expected NAME=A:B:n.*got '1:2'"),
        ("M=1:2:3:4:5", "got '1:2:3:4:5'"),
        ("M=1:2:3:lin", "got '1:2:3:lin'"),
        ("M=a:2:3", "got 'a' for a number"),
        ("M=1:inf:3", "got 'inf' for a number"),
        ("M=1:2:1", "n must be a whole number from 2 to 100000, got 1; a single value goes with"),
        ("M=1:2:2.5", "n must be a whole number from 2 to 100000, got 2.5"),
        ("M=2:2:3", "both ends are 2; give two that differ"),
        ("M=0:1:3:log", "equal ratios need ends above zero, got 0 and 1; leave out :log"),
        ("M=1:1.0000000000001:99", "99 values between 1 and 1 are equal to 12 digits"),
    ],
)
def test_what_does_not_read_is_told(text: str, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        parse_axis(text)


def test_grids_that_cannot_be() -> None:
    with pytest.raises(InputError, match="needs a parameter; give --over NAME=A:B:n"):
        parse_axes([])
    with pytest.raises(InputError, match="M is given twice"):
        parse_axes(["M=1:2:3", "M=1:2:4"])
    with pytest.raises(InputError, match="a grid of 1000000 points is more than 100000"):
        parse_axes(["M=1:2:1000", "N=1:1000:1000"])
    with pytest.raises(InputError, match="expected finite numbers in a row"):
        parse_axes({"M": [1.0, np.nan]})
    with pytest.raises(InputError, match="a value is given twice"):
        parse_axes({"M": [1.0, 1.0]})


def test_names_are_those_of_the_problem_the_law_the_settings_and_the_policy() -> None:
    case = SolveRequest("push-1d", contact="barrier")
    source = case.source()
    for name, full in {
        "M": "problem.M",
        "problem.N": "problem.N",
        "mu": "contact.mu",
        "contact.mu": "contact.mu",
        "setting.tol": "setting.tol",
        "policy.bound": "policy.bound",
    }.items():
        assert case.full_name(name, source) == full
    moved = case.at({"problem.M": 2.5, "contact.mu": 1e-2, "setting.tol": 1e-8, "policy.bound": 3})
    assert moved.params == {"M": 2.5} and moved.contact_settings == {"mu": 1e-2}
    assert moved.settings == {"tol": 1e-8, "policy.bound": 3}
    assert case.params == {}


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("mss", r"no parameter 'mss'.*push-1d and the barrier law have M, K, .*contact.mu"),
        ("contact.sigma", r"no parameter 'contact.sigma'"),
        ("setting.strategy", "setting.strategy is not a number; a sweep needs numbers"),
    ],
)
def test_names_that_there_are_not(name: str, sentence: str) -> None:
    case = SolveRequest("push-1d", contact="barrier")
    with pytest.raises(InputError, match=sentence):
        case.full_name(name, case.source())


def test_a_value_of_its_own_and_a_name_in_two_ways_exclude_each_other() -> None:
    with pytest.raises(InputError, match="M is swept by --over; drop its own value"):
        make_grid(SolveRequest("push-1d", {"M": 1.0}), parse_axes(["M=1:2:2"]))
    with pytest.raises(InputError, match=r"contact\.mu is given twice"):
        make_grid(SolveRequest("push-1d", contact="barrier"), parse_axes(["mu=1:2:2", "contact.mu=1:2:3"]))


def test_a_value_that_no_point_can_have_is_refused_with_its_sentence() -> None:
    for text, sentence in {
        "M=-1:2:4": r"parameter M \(mass of the object\) must be a number > 0 \[kg\], got -1",
        "N=1:2:3": "parameter N .* must be a whole number",
        "contact.mu=-1:1:3": "mu must be a number > 0",
        "qa0=-0.5:0.5:3": "the pusher starts inside the object",
    }.items():
        with pytest.raises(InputError, match=sentence):
            make_grid(SolveRequest("push-1d", contact="barrier"), parse_axes([text])).check()


def test_a_dimension_is_called_as_its_parameter_but_where_the_dataset_has_that_name() -> None:
    assert dimension_name("problem.M") == "M"
    assert dimension_name("contact.mu") == "contact.mu"
    assert dimension_name("problem.K") == "K"
    assert dimension_name("problem.cost") == "problem.cost"
